"""95 % intervals of a fit.

An interval is the wider of two: the profile of the likelihood, which accounts for bounds and thresholds, and the parabola of
the sandwich covariance, which is not misled by a kink of the cost next to its minimum. The shift by noise in the stage's input
is subtracted from the values; possible errors of zeros and mounts widen the interval.

The exact optimum by batches of values around the best so far, compared by the cost itself.

Descents by slopes end early where the cost has steps and kinks, as with thresholds and backlash. Every round evaluates the
Gauss–Newton step in several lengths and each stepwise parameter on a grid in one batch, and keeps the lowest cost.

Errors that all recordings share, so that no residual shows them: zeros of joints and mounts of bodies.

Both come from one reference pose, whose frames are averaged when logs are ingested. Every signal may have an offset equal to
the noise of such a mean; to first order it moves the values of a fit as it moves its residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import Data
from sysid.gap.fit import GRID, Fit, place
from sysid.gap.intervals.criterion import Criterion, Curvature, criterion_at, curvature_at
from sysid.gap.intervals.input_noise import DRAWS, InputNoise, input_noise
from sysid.gap.intervals.profile import profiled
from sysid.signals import split_signal

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


# -- the exact optimum ---------------------------------------------------------------------------------------------------------

#: Shares of a Gauss–Newton step that are evaluated.
SHARES = (0.1, 0.3, 0.6, 1.0, 1.6)
#: Rounds at most, and the gain [nats] below which the optimum is settled.
ROUNDS, SETTLED = 8, 0.02


def settled(data: Data, theta: Array, fit: Fit) -> Fit:
    """The fit at the least (softly winsorised) squares.

    Args:
        theta: vector of the plant under test.
    """
    values = fit.values
    for _ in range(2):
        criterion = criterion_at(data, theta, fit.unknowns, values)
        moved = descended(criterion, values)
        if np.array_equal(moved, values):
            break
        values = moved
    at = place(theta, fit.unknowns, values[None])[0]
    return replace(fit, values=values, theta=at, log_likelihood=data.log_likelihood(at))


def descended(criterion: Criterion, values: Array) -> Array:
    """Local minimum of the cost near ``values`` (k,)."""
    best = values
    cost = float(criterion.costs(criterion.errors(best[None]))[0])
    stepwise = [k for k, u in enumerate(criterion.unknowns) if u.stepwise]
    for reach in GRID if stepwise else ():
        best, cost = _least(criterion, best, cost, _grid(criterion, best, stepwise, reach))
        curvature = curvature_at(criterion, best)
        best, cost = _least(criterion, best, cost, _steps(criterion, curvature, best))
    for _ in range(ROUNDS):
        before = cost
        curvature = curvature_at(criterion, best)
        best, cost = _least(criterion, best, cost, _steps(criterion, curvature, best))
        if before - cost < SETTLED:
            break
    return best


def _least(criterion: Criterion, best: Array, cost: float, lanes: Array) -> tuple[Array, float]:
    """The lane of lowest cost, or the best so far."""
    lanes = np.clip(lanes, criterion.low, criterion.high)
    costs = criterion.costs(criterion.errors(lanes))
    k = int(np.argmin(costs))
    return (lanes[k], float(costs[k])) if costs[k] < cost else (best, cost)


def _steps(criterion: Criterion, curvature: Curvature, values: Array) -> Array:
    """Shares of the Gauss–Newton step, and a standard error of each parameter to both sides with the others refitted."""
    weighted = criterion.weights(curvature.errors) * curvature.errors
    step = -curvature.inverse @ (curvature.slopes.T @ weighted)
    along = (curvature.inverse / curvature.deviations).T
    return np.vstack([values + share * step for share in SHARES] + [values + s * along for s in (-1.0, -0.3, 0.3, 1.0)])


def _grid(criterion: Criterion, values: Array, places: list[int], reach: float) -> Array:
    points = np.linspace(-reach, reach, 9 if len(places) < 3 else 3)
    lanes = np.repeat(values[None], len(points) ** len(places), axis=0)
    sizes = np.array([criterion.unknowns[k].negligible for k in places])
    lanes[:, places] += sizes * np.array(list(product(points, repeat=len(places))))
    return lanes


# -- errors of zeros and mounts ------------------------------------------------------------------------------------------------

#: Frames of a reference pose: a second of it.
FRAMES = 100


def shared_offsets(criterion: Criterion, curvature: Curvature, values: Array, noise: Mapping[str, float]) -> Array:
    """Standard deviation (k,) of a fit at ``values`` (k,) caused by offsets of the signals.

    At static stages alone: elsewhere a run starts at the measurement and includes its offset.

    Args:
        noise: standard deviation of every measured signal.
    """
    problem, recordings = criterion.data.problem, criterion.data.recordings
    squares = np.zeros(len(values))
    if not problem.kind.static:
        return squares
    made = criterion.predicted(values, recordings)
    gain = curvature.inverse @ (curvature.slopes * criterion.weights(curvature.errors)[:, None]).T
    for name, level in noise.items():
        off = level / FRAMES**0.5
        if name in problem.signals:
            moved = [part + off * (np.array(problem.signals) == name) for part in made]
        elif split_signal(name)[1] != "command":
            shifted = [
                replace(r, table=r.table.assign(**{name: r.table[name] + off})) if name in r.table else r for r in recordings
            ]
            moved = criterion.predicted(values, shifted)
        else:
            continue
        squares += (gain @ criterion.between(made, moved)) ** 2
    return np.sqrt(squares)
