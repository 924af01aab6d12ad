"""How sure the search has to be, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Strictness:
    """Thresholds of the search.

    Args:
        gap: a stage whose error is below this multiple of its noise floor is explained.
        forward: least gain in log evidence that adds an effect for the time being.
        delta_bic, p_value: what an effect needs to stay, and what a rival needs to be beaten.
        likely, ratio: on short logs a few strokes decide and no block bootstrap can be sure; where the unseen recordings gain
            more than ``delta_bic`` nats this p-value is enough, or this ratio of unseen RMSE without to with the effect.
        halves: where that ratio is as large as this, ``forward`` nats are enough.
        worse: no step may raise the unseen RMSE by more than this factor, whatever short-term evidence says.
        richer: an effect that contains a simpler one has to predict unseen recordings better than that by this factor.
        decides, explained: a departure that is small enough to be negligible gets a name where the stage is this many times
            further off without it; as many times more as what is left exceeds ``explained`` noise floors, up to ``doubt`` times
            for an effect that the plant lacks. Where the fitted recordings are explained it shrinks to ``clearer`` as the
            departure grows to one that is worth a name by itself.
        doubt, lacking: where errors add up over a run, what is negligible grows with what stays unexplained (unseen RMSE in
            noise floors), up to ``doubt`` times: a model that is wrong in ways of its own moves its parameters a little
            wherever the machine is used otherwise. Of an effect that the plant lacks it grows up to ``lacking`` times.
        clearer: where such a stage stays above ``strange`` noise floors, an effect has to be missed by this ratio of unseen
            RMSE, and a rival has to leave so many times more. Below, the former shrinks to nothing at ``explained``.
        short: a rival that leaves more than so many times as much of fitted and of unseen recordings is none, nor are a gain
            and a dead time that leave so many times more than the plant as it is.
        crumb: least share, of what the strongest effect of such a stage explains, that a second one has to explain.
        shapeless: where a speed of no known form over the command, beside what is named, gains so many times what the names of
            that kind gain, these are not what is there.
        sensitivity: least share of an effect's influence that no other fitted parameter can imitate.
        most: largest number of effects at one stage.
        tried: so many of the candidates that promise most are fitted at a time.
        slight: an addition that hardly lowers the unseen RMSE needs as many nats.
        crossed: with less than this much to select on [s], fitting and selecting recordings change places as well.
        unshown: where what is to be selected by shows so many times less of the gap than what is to be fitted, nothing could be
            selected: what may be seen is dealt anew, and the halves change places.
        whitened, gate, free: evidence is taken on whitened residuals and on unseen recordings; what is not excited gets no
            name; gain and dead time are free in every fit. Off only to measure their worth (``pipelines/ablation.py``).
    """

    gap: float = 1.15
    forward: float = 3.0
    delta_bic: float = 10.0
    p_value: float = 0.01
    likely: float = 0.15
    ratio: float = 1.3
    halves: float = 2.0
    worse: float = 1.1
    richer: float = 1.05
    decides: float = 2.0
    explained: float = 1.5
    doubt: float = 2.5
    lacking: float = 1.5
    clearer: float = 1.25
    strange: float = 3.0
    short: float = 3.0
    crumb: float = 0.2
    shapeless: float = 0.5
    sensitivity: float = 0.02
    most: int = 6
    tried: int = 6
    slight: float = 30.0
    crossed: float = 90.0
    unshown: float = 3.0
    whitened: bool = True
    gate: bool = True
    free: bool = True
