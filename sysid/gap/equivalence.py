"""The region of practical equivalence of a parameter around its known value, and the bounds of its range."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.thresholds import EXPLAINED, Z
from sysid.machine import EffectKey

Array = npt.NDArray[np.float64]
#: Distance from a bound at which a fit stops, as a share of the bound, or of the negligible change where it is zero.
AT = 1e-3


def at_bound(candidate: Candidate, model: ModelFit) -> bool:
    """Whether a value of an effect lies at a bound, to within :data:`AT`, where it is neither nominal nor absent."""
    return any(
        abs(value - bound) <= AT * (abs(bound) or u.negligible) and value not in (u.nominal, absent)
        for u, value, absent in zip(candidate.unknowns, model.values_of(candidate), candidate.absent, strict=True)
        for bound in u.bounds
    )


def near_known(candidate: Candidate, model: ModelFit) -> bool:
    """Whether the plant has the effect already, and the intervals of all its values reach within a tenth of the known ones.

    An owner has fitted them to other motion; where formulas are wrong, the best values differ between motions. Of a ratio it is
    a tenth of its distance from one, where the effect is absent.
    """
    nominal, absent = np.array([u.nominal for u in candidate.unknowns]), np.array(candidate.absent)
    tenth = (EXPLAINED - 1.0) * np.minimum(np.abs(nominal), np.abs(nominal - absent))
    return candidate.known and reaches(candidate, model, tenth)


def beyond_rate(candidate: Candidate, model: ModelFit) -> bool:
    """Whether a value of an effect is larger than the rate of the recordings shows."""
    return any(value > u.shown for u, value in zip(candidate.unknowns, model.values_of(candidate), strict=True))


def equivalent_change(left: float) -> float:
    """Change of the output that adds a tenth, in quadrature, to its remaining error ``left``; both in noise floors."""
    return float(np.sqrt(EXPLAINED**2 - 1.0) * max(1.0, left))


def equivalent_half(candidate: Candidate, model: ModelFit) -> Array:
    """Half-widths (k,) of the regions of practical equivalence of the parameters of an effect."""
    with np.errstate(divide="ignore", over="ignore"):  # no value changes an output that does not respond
        return np.asarray(equivalent_change(model.left) / model.response[model.rows_of(candidate)])


def within_equivalence(candidate: Candidate, model: ModelFit, rope: Mapping[EffectKey, float]) -> bool:
    """Whether the 95 % intervals of all its parameters reach into the region of practical equivalence.

    They include what the discrepancy could do in its place.
    """
    return reaches(candidate, model, np.maximum(equivalent_half(candidate, model), rope.get(candidate.key, 0.0)))


def reaches(candidate: Candidate, model: ModelFit, half: Array) -> bool:
    """Whether the 95 % intervals of all parameters of an effect reach within ``half`` (k,) of their known values."""
    reach = Z * np.hypot(model.deviations_of(candidate), model.confounded[model.rows_of(candidate)])
    nominal = np.array([u.nominal for u in candidate.unknowns])
    return bool((np.abs(model.values_of(candidate) - nominal) - reach <= half).all())
