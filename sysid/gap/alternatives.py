"""Effects that are compared in the place of others, after a search without them: richer formulas for the same physics.

A richer formula of friction fits a little better on every machine, since no friction is as its formula says, and beside the
plain one it compensates for whatever is missing. It therefore takes the place of the plain ones, and only where it divides the
variance that they leave above the noise floor by the price of an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates, spread_of
from sysid.gap.price import divides
from sysid.gap.stage_model import StageFit

Array = npt.NDArray[np.float64]
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
        if not _may_divide(data, theta, found, forms[-1]):
            continue
        instead = search([*others, *forms])
        chosen = any(c.effect.name == effect for c in instead.decision.named)
        if chosen and divides(found.decision.model.left, instead.decision.model.left):
            found = instead
    return found


def _may_divide(data: Data, theta: Array, found: StageFit, alternative: Candidate) -> bool:
    """Whether a least-squares fit with the richest form in the place of the others leaves so much less."""
    model = found.decision.model
    rest = [c for c in model.candidates if c.effect.name not in alternative.effect.instead_of]
    known = [model.values_of(c) for c in rest]
    starts = [np.concatenate([*known, np.asarray(start)]) for start in alternative.starts]
    fit = fit_candidates(data, theta, (*rest, alternative), starts)
    before, after = (spread_of(data.residuals(each[None])) for each in (model.theta, fit.theta))
    return divides(before, after)
