"""95 % intervals of a fit.

An interval is the wider of two: the profile of the likelihood, which accounts for bounds and thresholds, and the parabola of
the sandwich covariance, which is not misled by a kink of the cost next to its minimum. The shift by noise in the stage's input
is subtracted from the values; possible errors of zeros and mounts widen the interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import Data
from sysid.gap.fit import Fit, place
from sysid.gap.intervals.criterion import criterion_at
from sysid.gap.intervals.curvature import Curvature, curvature_at
from sysid.gap.intervals.input_noise import DRAWS, InputNoise, input_noise
from sysid.gap.intervals.profile import profiled
from sysid.gap.intervals.settle import settled
from sysid.gap.intervals.shared import shared_offsets

Array = npt.NDArray[np.float64]

#: Relative uncertainty of the noise of an input.
NOISE_UNCERTAINTY = 0.15
#: Minimum half-width: the first share of the value (accuracy of the plant), plus the second share of the negligible change
#: (sampling); the latter at most the third share of a value whose range excludes zero.
OF_VALUE, OF_NEGLIGIBLE, OF_NONZERO = 2e-4, 0.1, 0.05
#: The minimum half-width ends at this share of the distance to the value of the plant under test, if that is rejected.
SHORT_OF = 1.0 - 1e-6
#: 97.5 % quantile of the normal distribution.
Z = float(stats.norm.ppf(0.975))


@dataclass(frozen=True)
class Known:
    """A fit at its exact optimum, corrected for noise in the stage's input, and its 95 % intervals ``limits``, (k, 2)."""

    fit: Fit
    limits: Array


def known_of(data: Data, theta: Array, fit: Fit, noise: Mapping[str, float], seed: int = 0) -> Known:
    """Move a fit to its exact optimum and compute its intervals.

    Args:
        theta: vector of the plant under test.
        noise: standard deviation of every measured signal.
        seed: of the noise that is added to a measured input.
    """
    if not fit.unknowns:
        return Known(fit, np.empty((0, 2)))
    fit = settled(data, theta, fit)
    values = fit.values
    criterion = criterion_at(data, theta, fit.unknowns, values)
    curvature = curvature_at(criterion, values)
    added = input_noise(criterion, curvature, values, noise, seed)
    if added is not None:
        curvature = _with(curvature, added)
    smooth = np.array([not u.stepwise for u in fit.unknowns])  # the others have no informative slopes
    reach = np.maximum(np.abs(profiled(criterion, curvature, values) - values[:, None]), (smooth * curvature.halves)[:, None])
    if added is not None:
        unsure = Z * np.hypot(NOISE_UNCERTAINTY * added.shift, added.deviation)
        reach = np.hypot(reach, unsure[:, None])
        values = np.clip(values - added.shift, criterion.low, criterion.high)
        fit = replace(fit, values=values, theta=place(theta, fit.unknowns, values[None])[0])
    reach = np.hypot(reach, Z * shared_offsets(criterion, curvature, values, noise)[:, None])
    least = np.array([least_half_width(c, u, v) for (c, u), v in zip(_owners(fit), values, strict=True)])
    away = np.abs(values - np.array([u.nominal for u in fit.unknowns]))
    # The accuracy of the plant limits a value of the machine, not that the plant's own value is rejected.
    least = np.where(np.max(reach, axis=1) < away, np.minimum(least, SHORT_OF * away), least)
    ends = values[:, None] + np.maximum(reach, least[:, None]) * [-1.0, 1.0]
    return Known(fit, np.clip(ends, criterion.low[:, None], criterion.high[:, None]))


def _owners(fit: Fit) -> list[tuple[Candidate, Unknown]]:
    """The unknowns of a fit, each with its effect."""
    return [(candidate, unknown) for candidate in fit.candidates for unknown in candidate.unknowns]


def least_half_width(candidate: Candidate, unknown: Unknown, value: float) -> float:
    """Minimum half-width of the interval of a value.

    Clocks and integration limit the accuracy of a share of the speed, and both are relative: the instants of sampling do not
    matter to it.
    """
    relative = {p.name for p in candidate.form.parameters if candidate.effect.proportional and p.unit == "1"}
    if unknown.key in relative:
        return OF_VALUE * max(abs(value), 1.0)
    most = OF_NONZERO * abs(value) if unknown.bounds[0] > 0.0 else np.inf
    return float(OF_VALUE * abs(value) + min(OF_NEGLIGIBLE * unknown.negligible, most))


def _with(curvature: Curvature, added: InputNoise) -> Curvature:
    """The curvature with the scatter caused by noise in the input, where it exceeds that of the residuals."""
    wide = np.diag(added.covariance) / np.diag(curvature.inverse) + (1.0 - added.share)
    t = float(stats.t.ppf(0.975, DRAWS - 1))
    return replace(curvature, allowed=np.maximum(curvature.allowed, 0.5 * t**2 * wide))
