"""Effects that are compared in the place of others, after a search without them.

A richer formula of friction fits a little better on every machine, since no friction is as its formula says, and beside the
plain one it compensates for whatever is missing. It therefore takes the place of the plain ones only where it divides the
variance that they leave above the noise floor by the price of an effect.

One cause may look like several effects: a wrong force constant changes inertia, friction and load by one ratio. It takes their
place where it predicts as well with fewer effects. Where it needs as many, no recording distinguishes the two, and it is an
alias of the effect in whose place it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.comparison import clearly_worse, divides
from sysid.gap.data import Data
from sysid.gap.fit import ROUGH, Fit, fit_candidates, spread_of
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.stage_model import StageFit
from sysid.gap.thresholds import LEAST, as_little

Array = npt.NDArray[np.float64]
#: Difference in log-likelihood of two sets that make the same prediction, by the tolerance of fits [nats].
ALIAS = 0.1
Search = Callable[[Sequence[Candidate]], StageFit]


def search_alternatives(data: Data, theta: Array, candidates: Sequence[Candidate], search: Search) -> StageFit:
    """The search of a stage without the effects that are alternatives of others; then with each in their place.

    Args:
        theta: vector of the plant under test.
        candidates: all of the stage.
        search: the search with some of them.
    """
    plain = [c for c in candidates if not c.effect.instead_of]
    found = search(plain)
    for effect in dict.fromkeys(c.effect.name for c in candidates if c.effect.instead_of):
        forms = [c for c in candidates if c.effect.name == effect]
        others = [c for c in plain if c.effect.name not in forms[0].effect.instead_of]
        model, before = found.decision.model, _left(data, found.decision.model)
        if not any(c.effect.name in forms[0].effect.instead_of for c in model.candidates) and not divides(before, 0.0):
            continue  # there is nothing in whose place it could be, and nothing left for it to explain
        fit = _in_place(data, theta, model, forms[-1])
        few = _fewest(data, theta, before, fit)
        if not divides(before, _left(data, fit)) and not _fewer(few, model):
            found = _beside(data, theta, found, fit)
            continue
        # Beside the alternative, richer forms of the others may win; the smallest set is compared by itself then.
        for some in ([*others, *forms], list(few.candidates)):
            instead = search(some)
            other, chosen = instead.decision.model, any(c.effect.name == effect for c in instead.decision.named)
            if chosen and (divides(model.left, other.left) or (_fewer(other, model) and not clearly_worse(other, model))):
                found = instead
                break
    return found


def _in_place(data: Data, theta: Array, model: ModelFit, alternative: Candidate) -> Fit:
    """The least-squares fit of a model with an alternative in the place of the effects that it replaces."""
    rest = [c for c in model.candidates if c.effect.name not in alternative.effect.instead_of]
    known = [model.values_of(c) for c in rest]
    starts = [np.concatenate([*known, np.asarray(start)]) for start in alternative.starts]
    return fit_candidates(data, theta, (*rest, alternative), starts, ROUGH)


def _left(data: Data, fit: Fit | ModelFit) -> float:
    return spread_of(data.residuals(fit.theta[None]))


def _fewest(data: Data, theta: Array, left: float, fit: Fit) -> Fit:
    """The fit without the effects beside the alternative, one by one, while it leaves at most a tenth more than ``left``."""
    while len(fit.candidates) > 1 and as_little(_left(data, fit), left):
        *rest, alternative = fit.candidates
        fewer = [[*(c for c in rest if c is not left_out), alternative] for left_out in rest]
        starts = [[np.concatenate([fit.values_of(c) for c in some])] for some in fewer]
        fits = [fit_candidates(data, theta, *each, ROUGH) for each in zip(fewer, starts, strict=True)]
        least = min(fits, key=lambda each: _left(data, each))
        if not as_little(_left(data, least), left):
            break
        fit = least
    return fit


def _fewer(one: Fit | ModelFit, other: ModelFit) -> bool:
    """Whether a set has fewer effects than another, and fewer values."""
    return len(one.candidates) < len(other.candidates) and len(one.unknowns) < len(other.unknowns)


def _beside(data: Data, theta: Array, found: StageFit, fit: Fit) -> StageFit:
    """The result with the alternative of ``fit`` noted on the one effect of the model that it replaces.

    Without a difference in likelihood it is an alias, which no recording distinguishes; with one that is not strong evidence,
    the two are tied.
    """
    decision, (*rest, alternative) = found.decision, fit.candidates
    replaced = [c for c in decision.model.candidates if all(c.label != other.label for other in rest)]
    if len(replaced) != 1 or replaced[0] not in decision.named or len(replaced[0].unknowns) != len(alternative.unknowns):
        return found
    same, instead = (fit_candidates(data, theta, each.candidates, [each.values]) for each in (decision.model, fit))
    gained = same.log_likelihood - instead.log_likelihood
    if abs(gained) <= ALIAS:
        known = replace(replaced[0], aliases=(*replaced[0].aliases, (alternative.effect.name, alternative.target)))
        named = tuple(known if c is replaced[0] else c for c in decision.named)
        return replace(found, decision=replace(decision, named=named))
    if gained > LEAST:
        return found
    named = tuple(c for c in decision.named if c is not replaced[0])
    return replace(found, decision=replace(decision, named=named, tied=(*decision.tied, (replaced[0], alternative))))
