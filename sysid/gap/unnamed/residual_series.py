"""Residual of a stage in bins, and the variables it may depend on: position, speed, reversals, small commands, load, time.

A stage that integrates its command is compared as a rate, in which an error of speed appears without delay. Residual and
variables pass the same filter (means over bins, and for a rate the difference of neighbouring bins), so that a term of the
right form matches its residual without attenuation. Whether the residual depends on a variable is tested by cross-correlations
whose bounds hold for autocorrelated and heteroscedastic residuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.gap.problem import Problem
from sysid.gap.result import Probe
from sysid.machine import Axis, Machine
from sysid.plant import gravity_load
from sysid.plant.force import force_inputs
from sysid.signals import axis_signal, point_signals
from sysid.validate.binning import direction_of, speed_of
from sysid.validate.bootstrap import bootstrap_means

Array = npt.NDArray[np.float64]

#: Width of the bins in which a residual is compared [s].
BIN = 0.1
#: Parts of a bin at which terms are evaluated.
PARTS = 2
#: Time constant with which the reversal variable decays [s].
REVERSAL = 0.3
#: Commands below this share of the largest one count as small.
SMALL = 0.25
#: Longest time since the start of a motion that is distinguished [s].
MAX_MOTION_TIME = 3.0
#: Longest time by which a variable may lead the residual [s].
LONGEST_LAG = 1.0
#: Probability that an independent residual exceeds any of its bounds.
FALSE_ALARM = 0.01
#: Weights of the parts of two neighbouring bins in the change of a bin's mean: a triangle.
_TRIANGLE = np.array([1.0, 3.0, 3.0, 1.0]) / 8.0


@dataclass(frozen=True)
class ResidualSeries:
    """One recording: the residual in bins, and the variables it may depend on in parts of bins.

    Args:
        target: residual of each bin, or its rate between two bins (m,); NaN where it was not measured.
        variables: name → value at each part of a bin, (PARTS·m + PARTS·rate,); complete.
        rate: whether ``target`` is a rate.
        step: seconds from one entry of ``target`` to the next.
    """

    name: str
    target: Array
    variables: Mapping[str, Array]
    rate: bool
    step: float

    def filtered(self, values: Array) -> Array:
        """Terms at the parts of bins (…, p) → their contribution to the target (…, m)."""
        count = len(self.target)
        shifted = [values[..., k : k + PARTS * count : PARTS] for k in range(2 * PARTS if self.rate else PARTS)]
        return np.asarray(sum(weight * part for weight, part in zip(self.weights, shifted, strict=True)))

    @property
    def weights(self) -> Array:
        """Weight of each part in an entry of the target."""
        return _TRIANGLE if self.rate else np.full(PARTS, 1.0 / PARTS)

    def part(self, first: int, last: int, name: str) -> ResidualSeries:
        """Entries ``first … last`` of the target as a series of their own."""
        ends = slice(PARTS * first, PARTS * (last + (1 if self.rate else 0)))
        return ResidualSeries(
            name, self.target[first:last], {k: v[ends] for k, v in self.variables.items()}, self.rate, self.step
        )


def residual_series(
    problem: Problem, theta: Array, recording: Recording, machine: Machine, signal: int
) -> ResidualSeries | None:
    """The residual of output ``signal`` of a stage on one recording; None where it is not measured for long enough."""
    predicted = problem.predict(theta[None], recording)[0]
    left = (problem.measured(recording) - predicted)[:, signal]
    rows = problem.rows(recording)
    found = {
        name: filled(values)[rows] for name, values in variables_of(problem, recording, machine, predicted[:, signal]).items()
    }
    rate_hz = problem.rate(recording)
    width = max(PARTS, PARTS * max(1, round(BIN * rate_hz / PARTS))) if problem.stage != "force" else PARTS
    if problem.stage == "force":  # decimated until its rows are nearly independent: each is a bin
        left, found = np.repeat(left, PARTS), {name: np.repeat(values, PARTS) for name, values in found.items()}
    count = len(left) // width
    if count < 20 or np.isfinite(left).sum() < 20 * width:
        return None
    bins = _means(left[: count * width].reshape(count, width))
    inner = width // PARTS
    parts = {name: values[: count * width].reshape(-1, inner).mean(axis=1) for name, values in found.items()}
    step = width / (rate_hz * PARTS if problem.stage == "force" else rate_hz)
    target = np.diff(bins) / step if problem.integrates else bins
    return ResidualSeries(recording.name, target, parts, problem.integrates, step)


def variables_of(problem: Problem, recording: Recording, machine: Machine, predicted: Array) -> dict[str, Array]:
    """Name → value on every row of the recording, NaN where it is missing.

    The speed of an axis that a command moves is the simulated one: a measured one would share its noise with the residual.
    """
    rate = recording.rate_hz
    if problem.target not in machine.axis_names:
        return _of_point(recording, machine)
    axis = machine.axis(problem.target)
    position, command = recording.values(axis.driven), recording.values(axis_signal(axis.name, "command"))
    if problem.stage == "force":
        speed = force_inputs(recording, axis, problem.force_filter, problem.rows(recording)).speed
    elif problem.stage == "command" and axis.driven == problem.signals[0]:
        speed = np.gradient(filled(predicted), 1.0 / rate)
        speed[np.abs(speed) > 50.0 * np.percentile(np.abs(speed), 90) + 1e-12] = 0.0  # a restart of the simulation is no motion
    else:
        speed = speed_of(position, rate)
    found = {axis.driven: position, f"speed of {axis.name}": speed, f"direction of {axis.name}": direction_of(speed)}
    found[f"reversal of {axis.name}"] = _since_reversal(found[f"direction of {axis.name}"], rate)
    found[f"time {axis.name} has moved"] = _moving_for(found[f"direction of {axis.name}"], rate)
    if problem.stage != "force":
        largest = float(np.nanmax(np.abs(command), initial=0.0))
        small = (np.abs(command) > 0.0) & (np.abs(command) < SMALL * largest)
        found[axis_signal(axis.name, "command")] = command
        found[f"small commands of {axis.name}"] = np.where(np.isnan(command), np.nan, np.where(small, np.sign(command), 0.0))
    found |= _others(axis, recording, machine)
    found |= _loads(recording, machine, (axis.name,))
    found["time"] = recording.values("time")
    return {name: values for name, values in found.items() if _varies(values)}


def cross_correlations(series: Sequence[ResidualSeries], ar1: float) -> tuple[Probe, ...]:
    """Each variable at the lag of its largest correlation relative to the bound, in descending order.

    Residual and variable are prewhitened by a first-order autoregression (coefficient ``ar1``). The variance of the mean of
    their product is that of Newey and West (Econometrica 55, 1987), which allows for remaining autocorrelation and for a
    disturbance whose variance depends on the variable; the bounds hold for all variables and lags together (Bonferroni).
    """
    from scipy.stats import norm

    names = [name for name in series[0].variables if all(name in part.variables for part in series)]
    lags = range(max(1, round(LONGEST_LAG / series[0].step)) + 1)
    level = float(norm.isf(0.5 * FALSE_ALARM / (max(len(names), 1) * len(lags))))
    found = []
    for name in names:
        best = None
        probes = [part.filtered(part.variables[name]) for part in series]
        for lag in lags:
            pairs = [_pair(part.target, probe, lag, ar1) for part, probe in zip(series, probes, strict=True)]
            e, x = (np.concatenate(side) for side in zip(*pairs, strict=True))
            if len(e) < 50 or not (e.std() > 0.0 and x.std() > 0.0):
                continue
            product = (e - e.mean()) * (x - x.mean()) / (e.std() * x.std())
            bound = level * float(np.sqrt(_long_run_variance(product - product.mean()) / len(product)))
            if best is None or abs(product.mean()) / bound > abs(best.correlation) / best.bound:
                best = Probe(name, float(product.mean()), bound, lag * series[0].step)
        if best is not None:
            found.append(best)
    return tuple(sorted(found, key=lambda probe: -abs(probe.correlation) / probe.bound))


def gain_p_value(gain: Array, seed: int, draws: int = 1000) -> float:
    """Share of stationary-bootstrap means of a gain in predictive density that are not positive.

    Blocks keep the autocorrelation of residuals, which a naive criterion ignores (Politis & Romano, JASA 89 (1994)).
    """
    if len(gain) < 20 or not np.any(gain != 0.0):
        return 1.0
    means = bootstrap_means(gain, seed, draws)
    return float((np.sum(means <= 0.0) + 1) / (draws + 1))


def quasi_difference(values: Array, ar1: float) -> Array:
    """``x_k − ar1·x_{k−1}`` along the last axis, without the first entry (Cochrane and Orcutt 1949)."""
    return np.asarray(values[..., 1:] - ar1 * values[..., :-1])


def lag1_autocorrelation(series: Sequence[Array]) -> float:
    """Lag-1 autocorrelation about the common mean, clipped to 0 … 0.999; zero for white noise."""
    mean = float(np.nanmean(np.concatenate(series)))
    top = sum(float(np.nansum((x[1:] - mean) * (x[:-1] - mean))) for x in series)
    bottom = sum(float(np.nansum((x - mean) ** 2)) for x in series)
    return float(np.clip(top / bottom, 0.0, 0.999)) if bottom > 0.0 else 0.0


def _pair(target: Array, probe: Array, lag: int, ar1: float) -> tuple[Array, Array]:
    e, x = quasi_difference(target[lag:], ar1), quasi_difference(probe[: len(probe) - lag], ar1)
    there = np.isfinite(e) & np.isfinite(x)
    return e[there], x[there]


def _long_run_variance(values: Array) -> float:
    """Long-run variance of a series with Bartlett weights; at least that of a white series."""
    count = len(values)
    widest = int(4.0 * (count / 100.0) ** (2.0 / 9.0))
    white = float(values @ values) / count
    total = white
    for lag in range(1, widest + 1):
        total += 2.0 * (1.0 - lag / (widest + 1.0)) * float(values[lag:] @ values[:-lag]) / count
    return max(total, white)


def _of_point(recording: Recording, machine: Machine) -> dict[str, Array]:
    """Variables of the boom tip and the tool: position, direction and load of every joint, speeds of the tip, time."""
    found: dict[str, Array] = {}
    for axis in machine.axes:
        joint = recording.values(axis_signal(axis.name, "joint"))
        found[axis_signal(axis.name, "joint")] = joint
        found[f"speed of {axis.name}"] = speed_of(joint, recording.rate_hz)
        found[f"direction of {axis.name}"] = direction_of(found[f"speed of {axis.name}"])
    for coordinate in point_signals("ee"):
        speed = speed_of(recording.values(coordinate), recording.rate_hz)
        found[f"speed of {coordinate}"] = speed
    found |= _loads(recording, machine, machine.axis_names)
    found["time"] = recording.values("time")
    return {name: values for name, values in found.items() if _varies(values)}


def _others(axis: Axis, recording: Recording, machine: Machine) -> dict[str, Array]:
    """Speed of each other axis, and the sum of their speeds, each relative to its maximum."""
    found: dict[str, Array] = {}
    total = np.zeros(len(recording))
    for other in machine.axes:
        speed = speed_of(recording.values(other.driven), recording.rate_hz)
        if np.isnan(speed).all():
            speed = recording.values(axis_signal(other.name, "command"))
        largest = float(np.nanmax(np.abs(speed), initial=0.0))
        if other.name != axis.name and largest > 0.0:
            found[f"speed of {other.name}"] = speed
            total += np.abs(np.nan_to_num(speed)) / largest
    return {**found, "other axes together": total} if len(found) > 1 else found


def _loads(recording: Recording, machine: Machine, axes: Sequence[str]) -> dict[str, Array]:
    if machine.kinematics() is None:
        return {}
    loads = gravity_load(machine, recording)
    columns = {f"load of {name}": loads[:, machine.axis_names.index(name)] for name in axes}
    return {name: values for name, values in columns.items() if np.ptp(values) > 0.0}


def _varies(values: Array) -> bool:
    there = values[np.isfinite(values)]
    return len(there) > 1 and bool(there.max() > there.min())


def _since_reversal(direction: Array, rate_hz: float) -> Array:
    """Direction, decaying exponentially after each reversal: the residual of backlash or of a spring."""
    out, last, age = np.zeros(len(direction)), 0.0, np.inf
    for k, now in enumerate(np.nan_to_num(direction)):
        if now != 0.0 and now != last:
            age, last = (0.0 if last != 0.0 else np.inf), now
        out[k] = last * np.exp(-age / REVERSAL)
        age += 1.0 / rate_hz
    return out


def _moving_for(direction: Array, rate_hz: float) -> Array:
    """Time since the axis began to move in its direction [s], up to :data:`MAX_MOTION_TIME`; zero at standstill."""
    direction = np.nan_to_num(direction)
    changes = np.flatnonzero(np.diff(direction, prepend=direction[:1]) != 0.0)
    begin = np.zeros(len(direction))
    begin[changes] = changes
    since = (np.arange(len(direction)) - np.maximum.accumulate(begin)) / rate_hz
    return np.where(direction != 0.0, np.minimum(since, MAX_MOTION_TIME), 0.0)


def _means(blocks: Array) -> Array:
    """Mean of each row; NaN where less than half of it is measured."""
    there = np.isfinite(blocks)
    count = there.sum(axis=1)
    total = np.where(there, blocks, 0.0).sum(axis=1)
    return np.where(count >= 0.5 * blocks.shape[1], total / np.maximum(count, 1), np.nan)
