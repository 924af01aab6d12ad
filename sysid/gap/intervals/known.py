"""95 % intervals of a fit, and the covariance that goes with them.

An interval is the wider of two: the profile of the likelihood, which knows bounds and thresholds, and the parabola of the
sandwich, which is not misled where the cost has a kink right beside its least. What noise in the stage's input adds is taken
off the values, and what zeros and mounts may be off widens it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.candidates import Unknown
from sysid.gap.data import Data
from sysid.gap.fit import Fit, place
from sysid.gap.intervals.criterion import criterion_at
from sysid.gap.intervals.curvature import Curvature, curvature_at
from sysid.gap.intervals.input_noise import DRAWS, InputNoise, input_noise
from sysid.gap.intervals.profile import profiled
from sysid.gap.intervals.settle import settled
from sysid.gap.intervals.shared import shared_offsets

Array = npt.NDArray[np.float64]

#: The noise of an input is known to about this share.
NOISE_KNOWN = 0.15
#: Nothing is known to a smaller share of itself, since plants compute no more exactly; nor to less of what is negligible, since
#: clocks, the steps of an integration and samples stand behind it (of what can not be zero, at most the third share of itself).
EXACT, EXACT_ZERO, EXACT_FORM = 2e-4, 0.1, 0.05
#: 95 % of a normal distribution lie within so many standard deviations.
Z = float(stats.norm.ppf(0.975))


@dataclass(frozen=True)
class Known:
    """What is known of a fit's unknowns.

    Args:
        fit: settled, and without what noise in the stage's input adds.
        limits: 95 % intervals (k, 2).
        covariance: (k, k); its deviations are those of the intervals.
    """

    fit: Fit
    limits: Array
    covariance: Array


def known_of(data: Data, theta: Array, fit: Fit, noise: Mapping[str, float], seed: int = 0) -> Known:
    """Settle a fit and say how well it is known.

    Args:
        theta: vector of the questioned plant.
        noise: standard deviation of every measured signal.
        seed: of the noise that is added to a measured input.
    """
    if not fit.unknowns:
        return Known(fit, np.empty((0, 2)), np.empty((0, 0)))
    fit = settled(data, theta, fit)
    values = fit.values
    criterion = criterion_at(data, theta, fit.unknowns, values)
    curvature = curvature_at(criterion, values)
    added = input_noise(criterion, curvature, values, noise, seed)
    if added is not None:
        curvature = _with(curvature, added)
    smooth = np.array([not u.stepwise for u in fit.unknowns])  # slopes say nothing about the others
    reach = np.maximum(np.abs(profiled(criterion, curvature, values) - values[:, None]), (smooth * curvature.halves)[:, None])
    if added is not None:
        unsure = Z * np.hypot(NOISE_KNOWN * added.shift, added.unsure)
        reach = np.hypot(reach, unsure[:, None])
        values = np.clip(values - added.shift, criterion.low, criterion.high)
        fit = replace(fit, values=values, theta=place(theta, fit.unknowns, values[None])[0])
    reach = np.hypot(reach, Z * shared_offsets(criterion, curvature, values, noise)[:, None])
    least = _least(fit.unknowns, values)
    ends = values[:, None] + np.maximum(reach, least[:, None]) * [-1.0, 1.0]
    limits = np.clip(ends, criterion.low[:, None], criterion.high[:, None])
    deviations = np.abs(limits - values[:, None]).max(axis=1) / Z
    correlations = np.where(np.outer(smooth, smooth), _correlations(curvature.covariance), np.eye(len(values)))
    return Known(fit, limits, correlations * np.outer(deviations, deviations))


def _correlations(covariance: Array) -> Array:
    """Of a covariance; what has no variance at all correlates with nothing."""
    scale = np.sqrt(np.diag(covariance))
    there = scale > 1e-12 * scale.max(initial=0.0)
    unit = np.where(there, scale, 1.0)
    found: Array = np.where(np.outer(there, there), covariance, 0.0) / np.outer(unit, unit)
    np.fill_diagonal(found, 1.0)
    return found


def _least(unknowns: Sequence[Unknown], values: Array) -> Array:
    """Half widths below which no interval is drawn."""
    least = EXACT * np.abs(values)
    for k, unknown in enumerate(unknowns):
        most = EXACT_FORM * abs(values[k]) if unknown.bounds[0] > 0.0 else np.inf
        least[k] += min(EXACT_ZERO * unknown.negligible, most)
    return np.asarray(least)


def _with(curvature: Curvature, added: InputNoise) -> Curvature:
    """The curvature with the scatter that noise in the input alone gives, where that is wider than the residuals tell."""
    wide = np.diag(added.covariance) / np.diag(curvature.inverse) + (1.0 - added.share)
    t = float(stats.t.ppf(0.975, DRAWS - 1))
    return replace(curvature, allowed=np.maximum(curvature.allowed, 0.5 * t**2 * wide))
