"""Which effects are missing at one stage: forward, exchange, backward, then every rival once more.

Forward selection is liberal (prediction of unseen recordings), since evidence on drifting residuals stops too early; what
stays is judged strictly (whitened evidence *and* block bootstrap *and* a size worth a name). Smaller models are refitted
from the larger one's optimum as well as from nominal, so that nothing is kept only because the smaller fit had not converged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.evidence import Comparison, confidence_set
from sysid.gap.finding import Finding, Kept, Trial
from sysid.gap.fit import Fit, fit_candidates, spread_of
from sysid.gap.makeshift import makeshift
from sysid.gap.problem import Problem, Split
from sysid.gap.scores import Scores
from sysid.gap.screen import likely_gains
from sysid.gap.strictness import Strictness

Array = npt.NDArray[np.float64]

#: An addition that leaves more than this of the unseen RMSE hardly lowers it.
SLIGHT = 0.98
#: An effect of which a curve of the speed over the command does more than this share is one.
MOSTLY = 0.5


@dataclass
class Search:
    """State of the search at one stage: the fits with their scores, and the table of trials.

    Args:
        candidates: what may get a name; ``nuisances``: what is free in every fit.
        gated: what the recordings cannot show well enough for a name. It may still be the reason of what is seen: where one
            of these explains it as well as what was found, that gets no name either.
    """

    problem: Problem
    theta: Array
    split: Split
    sigma: Array
    candidates: Sequence[Candidate]
    nuisances: Sequence[Candidate]
    gated: Sequence[Candidate] = ()
    strict: Strictness = field(default_factory=Strictness)
    seed: int = 0
    on_fit: Callable[[str], None] = lambda text: None
    scores: Scores = field(init=False)
    _gains: dict[frozenset[str], dict[str, float]] = field(default_factory=dict)
    _trials: list[Trial] = field(default_factory=list)

    def __post_init__(self) -> None:
        fit, select = self._data(self.split.fit), self._data(self.split.select)
        crossed = sum(len(r) / r.rate_hz for r in self.split.select) < self.strict.crossed
        before, after = (spread_of(data.residuals(self.theta[None])) for data in (fit, select))
        if before > max(self.strict.unshown * after, self.strict.gap):
            fit, select = self._dealt()
            crossed = True
        folds = ((fit, select), (select, fit)) if crossed else ((fit, select),)
        self.scores = Scores(self.theta, folds, self.strict.whitened, self.seed, self.on_fit)

    def _data(self, recordings: Sequence[Recording]) -> Data:
        return Data(self.problem, recordings, self.sigma, self.strict.whitened)

    def _dealt(self) -> tuple[Data, Data]:
        """What may be seen, in halves that show as much of the gap: by turns, from the recording that shows most of it."""
        shown = [spread_of(self._data((r,)).residuals(self.theta[None])) for r in self.split.seen]
        order = [self.split.seen[k] for k in np.argsort(shown, kind="stable")[::-1]]
        return self._data(order[0::2]), self._data(order[1::2])

    def run(self) -> Finding:
        """Name what is missing, or nothing."""
        nominal = self.scores.fit((), ())
        nominal_rmse = self.scores.rmse(nominal)
        if nominal_rmse <= self.strict.gap:
            return Finding(self.problem, (), (), nominal, nominal_rmse, nominal_rmse)
        model = self.scores.fit(tuple(self.nuisances), ())
        if self.scores.rmse(model) > self.strict.short * nominal_rmse:  # a sensor that reads in steps favours what stands still
            model = nominal
        for _ in range(3):
            model, _ = self._backward(self._forward(model), keep_nuisances=True)
            better = self._plainer(self._exchange(model))
            if better is model or set(better.labels) == set(model.labels):
                break
            model = better
        while crumbs := [c for c in self._crumbs(model) if not c.nuisance]:
            model = self._cleared(model, crumbs)
        misshapen = self._misshapen(model)
        if any(not c.nuisance for c in misshapen):
            model = self._cleared(model, misshapen)
        doubtful = [c for c in model.candidates if not c.nuisance or self._matters(c, model)]
        rivals = {c.key: self._rivals(model, c) for c in doubtful}  # while nuisances are free: they imitate much
        model, kept = self._backward(model)
        seen = self._data(self.split.seen)
        final = fit_candidates(seen, self.theta, model.candidates, [model.values])
        unnamed = (*self._crumbs(model), *misshapen)
        instead = makeshift(model, self._doubtful(model) >= self.strict.strange)
        ordinary = [
            c
            for c in model.candidates
            if c not in instead
            and (not c.nuisance or (c not in unnamed and self._matters(c, model, final) and self._lasts(kept[c.label], model)))
        ]
        named = tuple(Kept(c, kept[c.label], *rivals.get(c.key, ((), ()))) for c in ordinary)
        adjusted = tuple(c for c in model.candidates if c not in ordinary)
        final_rmse, leeway = self.scores.rmse(final), self._leeway(model)
        return Finding(self.problem, named, adjusted, final, nominal_rmse, final_rmse, tuple(self._trials), leeway)

    # -- steps ---------------------------------------------------------------------------------------------------

    def _forward(self, model: Fit) -> Fit:
        """Add what has most evidence, until nothing helps or the stage is explained."""
        passed = {frozenset(model.labels)}
        while len(self._ordinary(model)) < self.strict.most and self.scores.rmse(model) > self.strict.gap:
            trials = [self.scores.fit(_joined(model.candidates, c), (model,)) for c in self._likely(model, model.candidates)]
            if not trials:
                break
            for trial in trials:
                self._note(trial, model, "tried")
            limit = self.strict.worse * self.scores.rmse(model)
            trials = [trial for trial in trials if self.scores.rmse(trial) <= limit] or [model]
            best = max(trials, key=self.scores.merit)
            slight = self.scores.rmse(best) > SLIGHT * self.scores.rmse(model)
            if self.scores.merit(best) < self.scores.merit(model) + (self.strict.slight if slight else self.strict.forward):
                break
            plainer = self._plainer(best)
            if frozenset(plainer.labels) in passed:  # the addition was no more than a richer form of what is there
                break
            passed.add(frozenset(plainer.labels))
            model = plainer
        return model

    def _exchange(self, model: Fit) -> Fit:
        """The model with another effect in the place of one, where that has more evidence."""
        best = model
        for old in self._ordinary(model):
            rest = tuple(c for c in model.candidates if c is not old)
            for new in self._likely(model, rest, old):
                trial = self.scores.fit(_joined(rest, new), (model,))
                better = self.scores.merit(trial) > self.scores.merit(best) + self.strict.forward
                if better and self.scores.rmse(trial) <= self.strict.worse * self.scores.rmse(best):
                    best = trial
        return best

    def _backward(self, model: Fit, keep_nuisances: bool = False) -> tuple[Fit, dict[str, Comparison]]:
        """Drop what fails the strict test, the weakest first."""
        while True:
            kept: dict[str, Comparison] = {}
            weakest: tuple[float, Fit, str] | None = None
            shares = self.scores.own_shares(model)
            for candidate in self._ordinary(model) if keep_nuisances else model.candidates:
                smaller = self._without(candidate, model)
                simpler = self._simpler(model, candidate)
                if simpler is not None and self.scores.merit(simpler) > self.scores.merit(smaller):
                    smaller = simpler
                comparison = self.scores.compare(smaller, model)
                kept[candidate.label] = comparison
                if candidate.nuisance:  # stays as an adjustment as long as it predicts better; a name needs more
                    lasting = self.scores.merit(model) > self.scores.merit(smaller) + self.strict.forward
                else:
                    lasting = self._lasts(comparison, model) and self._matters(candidate, model)
                lasting &= shares[candidate.label] >= self.strict.sensitivity
                if not lasting and (weakest is None or comparison.gain < weakest[0]):
                    weakest = (comparison.gain, smaller, candidate.label)
            if weakest is None:
                return model, kept
            self._note(weakest[1], model, f"drops {weakest[2]}")
            model = weakest[1]

    def _crumbs(self, model: Fit) -> list[Candidate]:
        """What explains little beside the strongest effect of a stage that stays far from explained.

        No formula is quite what a machine does: what is left there may be what the strongest one's is off by, and a second name
        what makes up for it. A spool that is slow to follow is a rate limit and, a little, another lag.
        """
        if self._doubtful(model) < self.strict.strange:
            return []
        shares = np.zeros(len(model.candidates))
        for figure in (self.scores.rmse, self.scores.fitted_rmse):
            left = np.array([figure(self._without(c, model)) for c in model.candidates])
            own = np.sqrt(np.maximum(left**2 - figure(model) ** 2, 0.0))
            shares = np.maximum(shares, own / max(own.max(initial=0.0), 1e-12))
        return [c for c, share in zip(model.candidates, shares, strict=True) if share < self.strict.crumb]

    def _misshapen(self, model: Fit) -> list[Candidate]:
        """Gains, curves and limits beside which a speed of no known form over the command tells nearly as much as they do.

        A clutch that slips looks like a gain and its curve, since these are the nearest that have a name.
        """
        if self._doubtful(model) < self.strict.strange or not self.strict.whitened:
            return []
        static = [c for c in model.candidates if c.effect.memory(1.0) == 0]
        shares = self.scores.curved(model, [self._without(c, model) for c in static])
        kind = [c for c, share in zip(static, shares, strict=True) if share > MOSTLY]
        if not kind:
            return []
        shapes = [c for c in kind if not c.nuisance] or kind  # a gain beside them is free with or without them
        smaller = self.scores.fit(tuple(c for c in model.candidates if c not in shapes), (model,))
        own = model.log_likelihood - smaller.log_likelihood, self.scores.density(model) - self.scores.density(smaller)
        more = zip(self.scores.beyond(model), own, strict=True)
        return kind if all(gain > max(self.strict.shapeless * named, self.strict.delta_bic) for gain, named in more) else []

    def _cleared(self, model: Fit, of: Sequence[Candidate]) -> Fit:
        """The model without the ordinary ones of some effects, and without what only they had needed."""
        rest = tuple(c for c in model.candidates if c.nuisance or c not in of)
        return self._backward(self.scores.fit(rest, (model,)), keep_nuisances=True)[0]

    def _plainer(self, model: Fit) -> Fit:
        """The model with simpler effects in the place of those that contain them and hardly predict better."""
        for old in self._ordinary(model):
            rest = tuple(c for c in model.candidates if c is not old)
            taken = {c.key for c in rest}
            for new in self.candidates:
                if old.contains(new) and new.key not in taken:
                    trial = self.scores.fit((*rest, new), (model,))
                    self._note(trial, model, f"instead of {old.label}")
                    if self.scores.rmse(trial) <= self.strict.richer * self.scores.rmse(model):
                        return trial
        return model

    def _rivals(self, model: Fit, candidate: Candidate) -> tuple[tuple[tuple[Candidate, str], ...], tuple[Candidate, ...]]:
        """Every other effect in the place of this one: (those that lost and why, those that predict unseen data as well)."""
        rest = tuple(c for c in model.candidates if c is not candidate)
        rivals = self._likely(model, rest, candidate) + self._likely(model, rest, candidate, self.gated)
        fits = [self.scores.fit(_joined(rest, rival), (model,)) for rival in rivals]
        for fit in fits:
            self._note(fit, model, f"in the place of {candidate.label}")
        # A rival ties only if neither the fitted nor the unseen recordings tell the two apart.
        near = [
            k
            for k, fit in enumerate(fits)
            if self.scores.delta_bic(fit, model) < self.strict.delta_bic
            and not self._needlessly_rich(fit, model)
            and not self._hardly_better(rivals[k], fit, candidate, model)
            and not self._falls_short(fit, model)
        ]
        surviving = confidence_set(
            [-series for series in self.scores.log_densities(model, *(fits[k] for k in near))], self.seed
        )
        tied = {near[k - 1] for k in surviving if k > 0}
        if self._doubtful(model) >= self.strict.strange:
            # What is left is no noise. Where it speaks for one name here and for another there, it is neither.
            tied |= {k for k in near if self._contradicts(fits[k], model)}
        # What contains the effect as a special case leaves as much by itself. What tells less than nothing is none.
        nothing = self._without(candidate, model)
        tied |= {
            k
            for k, fit in enumerate(fits)
            if not rivals[k].contains(candidate) and self._as_far(fit, model) and self.scores.delta_bic(nothing, fit) > 0.0
        }
        ties = tuple(rivals[k] for k in sorted(tied) if not self._elsewhere(fits[k], candidate, model))
        rejected = tuple(
            (
                rival,
                f"evidence: ΔBIC {self.scores.delta_bic(fit, model):.0f} on fitted recordings, "
                f"{self.scores.density(model) - self.scores.density(fit):.0f} nats on unseen ones",
            )
            for rival, fit in zip(rivals, fits, strict=True)
            if rival not in ties
        )
        return rejected, ties

    def _likely(
        self,
        model: Fit,
        rest: tuple[Candidate, ...],
        old: Candidate | None = None,
        pool: Sequence[Candidate] | None = None,
    ) -> list[Candidate]:
        """Of what may be added to ``model`` the candidates that promise most beside ``rest``, the model without ``old``."""
        free = [c for c in self._open(model, pool) if old is None or c.key != old.key]
        if len(free) <= self.strict.tried:
            return free
        base = self.scores.fit(rest, (model,))
        key = frozenset(base.labels)
        known = self._gains.setdefault(key, {})
        new = [c for c in free if c.label not in known]
        if new:
            gains = likely_gains(self.scores.fitted, self.theta, base, new)
            known.update(zip((c.label for c in new), map(float, gains), strict=True))
        return sorted(free, key=lambda c: -known[c.label])[: self.strict.tried]

    def _needlessly_rich(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival needs more numbers than ``model`` and tells no more with them, neither of fitted nor of unseen runs.

        A load and a friction that differs by direction are one thing while a carriage moves: the simpler of two such names.
        """
        if len(rival.unknowns) <= len(model.unknowns):
            return False
        gains = rival.log_likelihood - model.log_likelihood, self.scores.density(rival) - self.scores.density(model)
        return max(gains) < self.strict.forward

    def _hardly_better(self, rival: Candidate, fit: Fit, candidate: Candidate, model: Fit) -> bool:
        """Whether a rival contains the effect as a special case and predicts hardly better: it is what it is there."""
        return rival.contains(candidate) and self.scores.rmse(model) <= self.strict.richer * self.scores.rmse(fit)

    def _falls_short(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival leaves a multiple of what ``model`` leaves, however well it predicts from one moment to the next."""
        pairs = zip(self.scores.least(rival), self.scores.least(model), strict=True)
        return all(left > self.strict.short * best for left, best in pairs)

    def _elsewhere(self, rival: Fit, candidate: Candidate, model: Fit) -> bool:
        """Whether an effect tells beside a rival most of what it tells without it: the rival explains something else.

        Oil that rings after every stop does not make a boom sink at rest, though the one may be as clear as the other.
        """
        if any(candidate.contains(c) or c.contains(candidate) for c in rival.candidates):
            return False
        nothing, both = self._without(candidate, model), self.scores.fit((*rival.candidates, candidate), (rival, model))
        pairs = ((one.log_likelihood, self.scores.density(one)) for one in (nothing, model, rival, both))
        without, alone, other, beside = (np.array(pair) for pair in pairs)
        least = np.maximum(MOSTLY * (alone - without), self.strict.delta_bic)
        return bool(np.all(beside - other > least))

    def _contradicts(self, rival: Fit, model: Fit) -> bool:
        """Whether fitted recordings prefer a rival clearly, and it leaves hardly more of them."""
        clear = self.scores.delta_bic(rival, model) < -self.strict.delta_bic
        return clear and self.scores.fitted_rmse(rival) < self.strict.clearer * self.scores.fitted_rmse(model)

    def _as_far(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival leaves about as much as ``model`` of a stage that stays far from explained.

        What is left is then much larger than noise and of unknown kind, so that it may decide between the two by chance,
        however clear the evidence looks. Both the likeliest values have to say so and those that leave least: the former are
        off by little that adds up, the latter follow what wanders. Of short logs one of them is enough.
        """
        if self._doubtful(model) < self.strict.strange or any(rival.at_bound(c) for c in rival.candidates):
            return False
        said = (
            all(left < self.strict.clearer * best for left, best in zip(view(rival), view(model), strict=True))
            for view in (self.scores.left, self.scores.least)
        )
        return any(said) if self.scores.short else all(said)

    # -- parts ---------------------------------------------------------------------------------------------------

    def _lasts(self, c: Comparison, model: Fit) -> bool:
        """Whether evidence for an effect of ``model`` is enough to keep it."""
        if not self.strict.whitened:
            return c.delta_bic > self.strict.delta_bic
        strangeness = self._strangeness(model)
        if strangeness > 0.0 and c.ratio < 1.0 + (self.strict.clearer - 1.0) * strangeness:
            return False
        sure = c.p_value < self.strict.p_value
        likely = c.gain > self.strict.delta_bic and (c.p_value < self.strict.likely or c.ratio > self.strict.ratio)
        halved = c.gain > self.strict.forward and c.ratio > self.strict.halves
        return c.delta_bic > self.strict.delta_bic and (sure or likely or halved)

    def _matters(self, candidate: Candidate, model: Fit, final: Fit | None = None) -> bool:
        """Whether a departure is large enough for a name: in itself (in a final fit too), or since everything depends on it.

        What ends at the bound of its range is no value of that effect: something else is passed off as it. A plant that errs
        in ways of its own moves the values of what it has by little, and much may depend on that: of these, more is asked.
        Where it leaves nothing of what was fitted, so that it does not err, the less is asked the further the departure is.
        """
        if model.at_bound(candidate):
            return False
        had = candidate.nuisance or candidate.known
        negligible = min(self._leeway(model), np.inf if had else self.strict.lacking)
        departure = min(fit.departure(candidate) for fit in (model, final or model))
        if departure > negligible:
            return True
        without = self._without(candidate, model)
        most = np.inf if had else self.strict.doubt
        asked = self.strict.decides * float(np.clip(self.scores.rmse(model) / self.strict.explained, 1.0, most))
        if self.scores.fitted_rmse(model) <= self.strict.explained:
            asked *= (self.strict.clearer / asked) ** (departure / negligible)
        return all(figure(without) > asked * figure(model) for figure in (self.scores.rmse, self.scores.fitted_rmse))

    def _without(self, candidate: Candidate, model: Fit) -> Fit:
        return self.scores.fit(tuple(c for c in model.candidates if c is not candidate), (model,))

    def _leeway(self, model: Fit) -> float:
        """So many times what is negligible still is."""
        return float(np.clip(self._doubtful(model), 1.0, self.strict.doubt))

    def _doubtful(self, model: Fit) -> float:
        """Noise floors that are left where errors add up over a run, so that they say less than they seem to; else none."""
        return self.scores.rmse(model) if self.problem.integrates else 0.0

    def _strangeness(self, model: Fit) -> float:
        """0 where a stage counts as explained, 1 where it stays far from that."""
        span = self.strict.strange - self.strict.explained
        return float(np.clip((self._doubtful(model) - self.strict.explained) / span, 0.0, 1.0))

    def _ordinary(self, model: Fit) -> list[Candidate]:
        return [c for c in model.candidates if not c.nuisance]

    def _open(self, model: Fit, pool: Sequence[Candidate] | None = None) -> list[Candidate]:
        """Candidates that may be added: not in the model yet; another form only if it is richer than the one in use."""
        used = {c.key: c for c in model.candidates}
        free = []
        for candidate in self.candidates if pool is None else pool:
            if any(other.contains(candidate) for other in model.candidates):
                continue
            present = used.get(candidate.key)
            first = candidate.form is candidate.effect.forms[0]
            if present is None or present.nuisance:
                wider = present is None or present.unknowns != candidate.unknowns
                if (first or candidate.known) and wider:
                    free.append(candidate)
            elif len(candidate.unknowns) > len(present.unknowns):
                free.append(candidate)
        return free

    def _simpler(self, model: Fit, candidate: Candidate) -> Fit | None:
        """The model with the simplest form of an effect that is there in a richer one."""
        first = candidate.effect.forms[0]
        if candidate.form is first:
            return None
        simple = next((c for c in self.candidates if c.key == candidate.key and c.form is first), None)
        if simple is None:
            return None
        rest = tuple(c for c in model.candidates if c is not candidate)
        return self.scores.fit((*rest, simple), (model,))

    def _note(self, fit: Fit, against: Fit, verdict: str) -> None:
        names = (f"{c.label}.{u.key}" for c in fit.candidates for u in c.unknowns)
        self._trials.append(
            Trial(
                tuple(sorted(fit.labels)),
                dict(zip(names, map(float, fit.values), strict=True)),
                self.scores.fitted_rmse(fit),
                self.scores.rmse(fit),
                self.scores.delta_bic(against, fit),
                verdict,
            )
        )


def _joined(model: Iterable[Candidate], new: Candidate) -> tuple[Candidate, ...]:
    """The model with ``new``, in the place of another form of it, of the nuisance of its name, and of what it contains."""
    return (*(c for c in model if c.key != new.key and not new.contains(c)), new)
