"""Change of a parameter over time: a self-starting cumulative sum over the recordings of one machine.

The residual of a recording, predicted from all before it, divided by its standard deviation, follows Student's t while nothing
changes, whatever the unknown mean and the unknown common scale of the errors; transformed to a normal variable it enters a
two-sided cumulative sum (self-starting CUSUM: Hawkins, The Statistician 36 (1987), 299; weights: Brown, Durbin and Evans,
J. R. Stat. Soc. B 37 (1975), 149). The decision interval follows from the accepted rate of false alarms by Siegmund's
approximation of the average run length (Siegmund, Sequential Analysis, 1985, §2.6; Montgomery, Introduction to Statistical
Quality Control, §9.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import optimize, stats

from sysid.fleet.effects import FleetEffect, ParameterHistory

Array = npt.NDArray[np.float64]

#: Half the change, in standard deviations of a recording, that is to be noticed soonest.
REFERENCE = 0.5
#: A single recording counts for no more, so that an outlier alone never raises an alarm.
MOST = 4.0
#: Overshoot of a random walk over its boundary (Siegmund 1985).
_OVERSHOOT = 1.166
#: Recordings before the first prediction: mean and scale are estimated from them.
_LEAST = 3


@dataclass(frozen=True)
class Drift:
    """A parameter that changed on one machine.

    Args:
        noticed: recording at which the cumulative sum crossed its decision interval; ``noticed_hours``: of recorded motion.
        since: first recording after the estimated change.
        before, after: mean before the change and after it, each with its 95 % interval.
    """

    machine: str
    effect: FleetEffect
    parameter: str
    unit: str
    noticed: str
    noticed_hours: float
    since: str
    before: float
    before95: tuple[float, float]
    after: float
    after95: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def drifts(histories: Sequence[ParameterHistory], false_alarms_per_hour: float) -> tuple[Drift, ...]:
    """The changes in all histories.

    Args:
        false_alarms_per_hour: accepted for a machine, all its parameters together, in hours of recorded motion.
    """
    charts: dict[str, int] = {}
    for history in histories:
        charts[history.machine] = charts.get(history.machine, 0) + 1
    found: list[Drift] = []
    for history in histories:
        if len(history.values) <= _LEAST:
            continue
        hours = history.ends[-1] / len(history.ends)
        run_length = charts[history.machine] / (false_alarms_per_hour * hours)
        found += _changes(history, decision_interval(run_length))
    return tuple(found)


def since_last_change(history: ParameterHistory, changes: Sequence[Drift]) -> ParameterHistory:
    """The recordings after the last change of the parameter on this machine: all of them without one."""
    own = [
        c.since for c in changes if (c.machine, c.effect, c.parameter) == (history.machine, history.effect, history.parameter)
    ]
    begin = max((history.recordings.index(name) for name in own), default=0)
    parts = {key: getattr(history, key)[begin:] for key in ("recordings", "ends", "values", "deviations")}
    return replace(history, **parts)


def decision_interval(run_length: float) -> float:
    """Decision interval of a two-sided CUSUM with the average ``run_length`` between false alarms, in standard deviations."""
    wanted = math.log(2.0 * run_length)  # either side alone

    def excess(b: float) -> float:
        return math.log((math.exp(2.0 * REFERENCE * b) - 2.0 * REFERENCE * b - 1.0) / (2.0 * REFERENCE**2)) - wanted

    if excess(1e-3) >= 0.0:
        return 0.0
    return max(0.0, float(optimize.brentq(excess, 1e-3, 600.0)) - _OVERSHOOT)


def standardised(values: Array, deviations: Array) -> Array:
    """Standard normal residuals of the values (r,), each predicted from those before it, (r,); the first are NaN.

    Args:
        deviations: standard deviations up to one common unknown factor, (r,).
    """
    out = np.full(len(values), np.nan)
    weights = deviations**-2.0
    total, mean, squares = weights[0], values[0], 0.0
    for k in range(1, len(values)):
        residual = values[k] - mean
        variance = 1.0 / weights[k] + 1.0 / total
        if k >= _LEAST and squares > 0.0:
            scale = squares / (k - 1)
            unit = math.sqrt(scale * variance)
            most = float(stats.t.isf(stats.norm.sf(MOST), k - 1))
            t = min(most, max(-most, residual / unit))
            out[k] = math.copysign(stats.norm.isf(stats.t.sf(abs(t), k - 1)), t)
            residual = t * unit  # mean and scale do not follow an outlier, nor the first values after a change
        squares += residual**2 / variance
        mean += weights[k] / (total + weights[k]) * residual
        total += weights[k]
    return out


def cumulative_sum(residuals: Array, interval: float) -> int | None:
    """Recording at which the cumulative sum of either sign first crosses the decision interval; None if it does not."""
    up, down = 0.0, 0.0
    for k, z in enumerate(residuals):
        if math.isnan(z):
            continue
        up, down = max(0.0, up + z - REFERENCE), max(0.0, down - z - REFERENCE)
        if max(up, down) > interval:
            return k
    return None


def date_of_change(values: Array, deviations: Array) -> int:
    """First recording after a step of the mean, by maximum likelihood (Hinkley, Biometrika 57 (1970), 1)."""
    weights = deviations**-2.0

    def scatter(rows: slice) -> float:
        return float(weights[rows] @ (values[rows] - np.average(values[rows], weights=weights[rows])) ** 2)

    costs = [scatter(slice(0, k)) + scatter(slice(k, None)) for k in range(1, len(values))]
    return 1 + int(np.argmin(costs))


def _changes(history: ParameterHistory, interval: float) -> list[Drift]:
    """The changes of one parameter; after an alarm the search goes on with the recordings after the change."""
    values, deviations = np.array(history.values), np.array(history.deviations)
    found: list[Drift] = []
    begin = 0
    while begin < len(values):
        alarm = cumulative_sum(standardised(values[begin:], deviations[begin:]), interval)
        if alarm is None:
            break
        noticed = begin + alarm
        since = begin + date_of_change(values[begin : noticed + 1], deviations[begin : noticed + 1])
        before, before95 = _mean(values[begin:since], deviations[begin:since])
        after, after95 = _mean(values[since : noticed + 1], deviations[since : noticed + 1])
        if abs(after - before) > history.negligible:
            found.append(
                Drift(
                    history.machine, history.effect, history.parameter, history.unit, history.recordings[noticed],
                    history.ends[noticed], history.recordings[since], before, before95, after, after95,
                )
            )  # fmt: skip
        begin = since
    return found


def _mean(values: Array, deviations: Array) -> tuple[float, tuple[float, float]]:
    """Weighted mean and its 95 % interval; the scale of the errors is that of the values, at least that of their deviations."""
    weights = deviations**-2.0
    mean = float(np.average(values, weights=weights))
    free = len(values) - 1
    scale = float(weights @ (values - mean) ** 2) / free if free else 1.0
    reach = float(stats.t.ppf(0.975, free) if free else stats.norm.ppf(0.975)) * math.sqrt(max(1.0, scale) / weights.sum())
    return mean, (mean - reach, mean + reach)
