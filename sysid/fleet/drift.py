"""Change of a parameter over time: a self-starting cumulative sum over the recordings of one machine.

The residual of a recording, predicted from all before it, divided by its standard deviation, follows Student's t while nothing
changes, whatever the unknown mean and the unknown common scale of the errors; transformed to a normal variable it enters a
two-sided cumulative sum (self-starting CUSUM: Hawkins, The Statistician 36 (1987), 299; weights: Brown, Durbin and Evans,
J. R. Stat. Soc. B 37 (1975), 149). The variance of a value is that of its own error and of a scatter between recordings. The
decision interval follows from the accepted rate of false alarms by Siegmund's approximation of the average run length
(Siegmund, Sequential Analysis, 1985, §2.6; Montgomery, Introduction to Statistical Quality Control, §9.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import optimize, special, stats

from sysid.fleet.effects import FleetEffect, ParameterHistory

Array = npt.NDArray[np.float64]

#: Half the change, in standard deviations of a recording, that is to be noticed soonest.
REFERENCE = 0.5
#: A single recording counts for no more, so that an outlier alone never raises an alarm.
MOST = 4.0
#: Probability of a larger one, on one side.
_BEYOND = float(special.ndtr(-MOST))
#: Overshoot of a random walk over its boundary (Siegmund 1985).
_OVERSHOOT = 1.166
#: Recordings before the first prediction: mean and scale are estimated from them.
_LEAST = 3
#: Fewest recordings, if there are so many, from which the value after a change is estimated.
_LATEST = 3


@dataclass(frozen=True)
class Drift:
    """A parameter that changed on one machine.

    Args:
        noticed: recording at which the cumulative sum crossed its decision interval; ``noticed_hours``: of recorded motion.
        since: first recording after the estimated change.
        before: mean before the change; ``after``: mean of the later half of the recordings since, so that a change that grows
            is measured where it has come to; each with its 95 % interval.
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
            unit = math.sqrt(squares / (k - 1) * variance)
            most = -float(special.stdtrit(k - 1, _BEYOND))
            t = min(most, max(-most, residual / unit))
            out[k] = math.copysign(special.ndtri(special.stdtr(k - 1, -abs(t))), t)
            residual = t * unit  # mean and scale do not follow an outlier, nor the first values after a change
        squares += residual**2 / variance
        mean += weights[k] / (total + weights[k]) * residual
        total += weights[k]
    return out


def cumulative_sums(residuals: Array) -> Array:
    """The larger of both one-sided cumulative sums at every recording, (r,); NaN counts as no recording."""
    sums = np.zeros(len(residuals))
    up, down = 0.0, 0.0
    for k, z in enumerate(residuals.tolist()):
        if not math.isnan(z):
            up, down = max(0.0, up + z - REFERENCE), max(0.0, down - z - REFERENCE)
        sums[k] = max(up, down)
    return sums


def date_of_change(values: Array, deviations: Array) -> int:
    """First recording after a step of the mean, by maximum likelihood (Hinkley, Biometrika 57 (1970), 1)."""
    weights = deviations**-2.0
    weights /= weights.max()
    centred = values - np.average(values, weights=weights)
    sums = np.cumsum([weights, weights * centred], axis=1)
    (left, left_sum), (total, whole) = sums[:, :-1], sums[:, -1]
    # The scatter about both means is the whole one less these squares.
    squares = left_sum**2 / left + (whole - left_sum) ** 2 / (total - left)
    return 1 + int(np.argmax(squares))


def with_scatter(values: Array, deviations: Array) -> Array:
    """Standard deviations (r,) of the values about a level that changes slowly or seldom: of their own errors and of a scatter
    between recordings, which is the same for all.

    The scatter follows from differences of neighbours (Rice, Ann. Stat. 12 (1984), 1215). A step makes it too large, which only
    makes the weights of the recordings more alike.
    """
    if len(values) < 2:
        return deviations
    excess = np.diff(values) ** 2 - deviations[1:] ** 2 - deviations[:-1] ** 2
    return np.asarray(np.sqrt(deviations**2 + max(0.0, 0.5 * float(np.mean(excess)))))


def _changes(history: ParameterHistory, interval: float) -> list[Drift]:
    """The changes of one parameter; after one the search goes on with the recordings after it.

    A change is reported while the sum is beyond its interval, as soon as it is not negligible. A change that is negligible yet
    does not become the new normal, or a slow growth would never be reported.
    """
    values = np.array(history.values)
    deviations = with_scatter(values, np.array(history.deviations))
    found: list[Drift] = []
    begin = 0
    while True:
        sums = cumulative_sums(standardised(values[begin:], deviations[begin:]))
        change = next(
            (
                drift
                for k in begin + np.flatnonzero(sums > interval)
                if abs((drift := _change(history, deviations, begin, int(k))).after - drift.before) > history.negligible
            ),
            None,
        )
        if change is None:
            return found
        found.append(change)
        begin = history.recordings.index(change.since)


def _change(history: ParameterHistory, deviations: Array, begin: int, noticed: int) -> Drift:
    """The change between the recordings ``begin`` and ``noticed``."""
    values = np.array(history.values)
    since = begin + date_of_change(values[begin : noticed + 1], deviations[begin : noticed + 1])
    latest = max(since, min((since + noticed + 1) // 2, noticed + 1 - _LATEST))
    before, before95 = _mean(values[begin:since], deviations[begin:since])
    after, after95 = _mean(values[latest : noticed + 1], deviations[latest : noticed + 1])
    return Drift(
        history.machine, history.effect, history.parameter, history.unit, history.recordings[noticed],
        history.ends[noticed], history.recordings[since], before, before95, after, after95,
    )  # fmt: skip


def _mean(values: Array, deviations: Array) -> tuple[float, tuple[float, float]]:
    """Weighted mean and its 95 % interval; the scale of the errors is that of the values, at least that of their deviations."""
    weights = deviations**-2.0
    mean = float(np.average(values, weights=weights))
    free = len(values) - 1
    scale = float(weights @ (values - mean) ** 2) / free if free else 1.0
    reach = float(stats.t.ppf(0.975, free) if free else stats.norm.ppf(0.975)) * math.sqrt(max(1.0, scale) / weights.sum())
    return mean, (mean - reach, mean + reach)
