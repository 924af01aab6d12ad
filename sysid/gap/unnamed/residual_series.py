"""Residual of a stage in bins, the variables it may depend on, and terms of those variables.

A stage that integrates its command is compared as a rate, in which an error of speed appears without delay. Residual and
terms pass the same filter (means over bins, and for a rate the difference of neighbouring bins), so that a term of the right
form matches its residual without attenuation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.gap.problem import Problem
from sysid.machine import Axis, Machine
from sysid.plant import gravity_load
from sysid.plant.force import force_inputs
from sysid.signals import axis_signal, point_signals
from sysid.validate.error_analysis import direction_of, speed_of
from sysid.validate.metrics import bootstrap_means

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
#: A change of the simulation by more than this multiple of its 90th percentile is a restart and no motion.
RESTART = 50.0
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
        """Terms at the parts of bins (p,) → their contribution to the target (m,)."""
        ends = PARTS * len(self.target)
        return np.asarray(sum(weight * values[k : k + ends : PARTS] for k, weight in enumerate(self.weights)))

    @property
    def weights(self) -> Array:
        """Weight of each part in an entry of the target."""
        return _TRIANGLE if self.rate else np.full(PARTS, 1.0 / PARTS)

    def part(self, first: int, last: int) -> ResidualSeries:
        """Entries ``first … last`` of the target as a series of their own."""
        ends = slice(PARTS * first, PARTS * (last + (1 if self.rate else 0)))
        variables = {name: values[ends] for name, values in self.variables.items()}
        return ResidualSeries(self.name, self.target[first:last], variables, self.rate, self.step)


def residual_series(
    problem: Problem, theta: Array, recording: Recording, machine: Machine, signal: int
) -> ResidualSeries | None:
    """The residual of output ``signal`` of a stage on one recording; None where it is not measured for long enough."""
    predicted = problem.predict(theta[None], recording)[0]
    left = (problem.measured(recording) - predicted)[:, signal]
    rows, rate_hz = problem.rows(recording), problem.rate(recording)
    variables = _variables(problem, recording, machine, predicted[:, signal])
    found = {name: filled(values)[rows] for name, values in variables.items()}
    inner = max(1, round(BIN * rate_hz / PARTS))
    if problem.force_filter is not None:  # decimated until its rows are nearly independent: each is a bin
        left, found = np.repeat(left, PARTS), {name: np.repeat(values, PARTS) for name, values in found.items()}
        rate_hz, inner = PARTS * rate_hz, 1
    width = PARTS * inner
    count = len(left) // width
    if count < 20 or np.isfinite(left).sum() < 20 * width:
        return None
    bins = _means(left[: count * width].reshape(count, width))
    parts = {name: values[: count * width].reshape(-1, inner).mean(axis=1) for name, values in found.items()}
    step = width / rate_hz
    target = np.diff(bins) / step if problem.kind.integrates else bins
    return ResidualSeries(recording.name, target, parts, problem.kind.integrates, step)


def _variables(problem: Problem, recording: Recording, machine: Machine, predicted: Array) -> dict[str, Array]:
    """Name → value on every row of the recording, NaN where it is missing; without those that do not vary."""
    if problem.target in machine.axis_names:
        found = _of_axis(problem, recording, machine, predicted)
    else:
        found = _of_points(recording, machine)
    found["time"] = recording.values("time")
    return {name: values for name, values in found.items() if _varies(values)}


def _of_axis(problem: Problem, recording: Recording, machine: Machine, predicted: Array) -> dict[str, Array]:
    """Variables of an axis: its position, motion, command and load, and the motion of the others.

    The speed of an axis that a command moves is the simulated one: a measured one would share its noise with the residual.
    """
    axis, rate = machine.axis(problem.target), recording.rate_hz
    position, command = recording.values(axis.driven), axis_signal(axis.name, "command")
    if problem.force_filter is not None:
        speed = force_inputs(recording, axis, problem.force_filter, problem.rows(recording)).speed
    elif axis.driven in problem.signals:
        speed = np.gradient(filled(predicted), 1.0 / rate)
        speed[np.abs(speed) > RESTART * np.percentile(np.abs(speed), 90) + 1e-12] = 0.0
    else:
        speed = speed_of(position, rate)
    direction = direction_of(speed)
    found = {axis.driven: position, f"speed of {axis.name}": speed, f"direction of {axis.name}": direction}
    found[f"reversal of {axis.name}"] = _since_reversal(direction, rate)
    found[f"time {axis.name} has moved"] = _moving_for(direction, rate)
    if command not in problem.signals:
        u = recording.values(command)
        small = (np.abs(u) > 0.0) & (np.abs(u) < SMALL * float(np.nanmax(np.abs(u), initial=0.0)))
        found[command] = u
        found[f"small commands of {axis.name}"] = np.where(np.isnan(u), np.nan, np.where(small, np.sign(u), 0.0))
    return found | _others(axis, recording, machine) | _loads(recording, machine, (axis.name,))


def _of_points(recording: Recording, machine: Machine) -> dict[str, Array]:
    """Variables of the boom tip and the tool: position, direction and load of every joint, speeds of the tip."""
    found: dict[str, Array] = {}
    for axis in machine.axes:
        joint = recording.values(axis_signal(axis.name, "joint"))
        found[axis_signal(axis.name, "joint")] = joint
        found[f"speed of {axis.name}"] = speed_of(joint, recording.rate_hz)
        found[f"direction of {axis.name}"] = direction_of(found[f"speed of {axis.name}"])
    for coordinate in point_signals("ee"):
        found[f"speed of {coordinate}"] = speed_of(recording.values(coordinate), recording.rate_hz)
    return found | _loads(recording, machine, machine.axis_names)


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


def quasi_difference(values: Array, ar1: float) -> Array:
    """``x_k − ar1·x_{k−1}`` of a series (n,), without the first entry (Cochrane and Orcutt 1949), (n − 1,)."""
    return np.asarray(values[1:] - ar1 * values[:-1])


def lag1_autocorrelation(series: Sequence[Array]) -> float:
    """Lag-1 autocorrelation about the common mean, clipped to 0 … 0.999; zero for white noise."""
    mean = float(np.nanmean(np.concatenate(series)))
    top = sum(float(np.nansum((x[1:] - mean) * (x[:-1] - mean))) for x in series)
    bottom = sum(float(np.nansum((x - mean) ** 2)) for x in series)
    return float(np.clip(top / bottom, 0.0, 0.999)) if bottom > 0.0 else 0.0


#: Least number of blocks of a bootstrap.
LEAST_BLOCKS = 20


def gain_p_value(gain: Array, seed: int, draws: int = 1000) -> float:
    """Share of stationary-bootstrap means of a gain in predictive density that are not positive.

    Blocks keep the autocorrelation of residuals, which a naive criterion ignores (Politis & Romano, JASA 89 (1994)).
    """
    if len(gain) < LEAST_BLOCKS or not np.any(gain != 0.0):
        return 1.0
    means = bootstrap_means(gain, seed, draws)
    return float((np.sum(means <= 0.0) + 1) / (draws + 1))


def share_explained(before: Sequence[Array], after: Sequence[Array]) -> tuple[float, float]:
    """Share of the squared errors ``before`` that are gone ``after``, and the p-value of that gain."""
    total, rest = np.concatenate(before), np.concatenate(after)
    share = 1.0 - float(rest.sum() / total.sum()) if total.sum() > 0.0 else 0.0
    return share, gain_p_value(total - rest, 0)


@dataclass(frozen=True)
class Factor:
    """One factor of a term: a ``function`` of a measured variable, with its ``number`` (centre, time constant or period)."""

    function: str
    variable: str
    number: float = 0.0

    def values(self, series: ResidualSeries) -> Array:
        return _FUNCTIONS[self.function][0](series.variables[self.variable], self.number)

    def __str__(self) -> str:
        centred = f"({self.variable} {'−' if self.number >= 0.0 else '+'} {abs(self.number):g})"
        return _FUNCTIONS[self.function][1].format(x=self.variable, number=self.number, centred=centred)


#: Function of a variable and of the number of its factor, and how it is written.
_FUNCTIONS: dict[str, tuple[Callable[[Array, float], Array], str]] = {
    "identity": (lambda x, _: x, "{x}"),
    "abs": (lambda x, _: np.abs(x), "|{x}|"),
    "square": (lambda x, _: x * x, "({x})²"),
    "signed square": (lambda x, _: x * np.abs(x), "{x}·|{x}|"),
    "cube": (lambda x, _: x**3, "({x})³"),
    "offset": (lambda x, centre: x - centre, "{centred}"),
    "offset square": (lambda x, centre: (x - centre) ** 2, "{centred}²"),
    "decay": (lambda x, seconds: np.exp(-x / seconds), "exp(−{x}/{number:g} s)"),
    "sin": (lambda x, period: np.sin(2.0 * np.pi * x / period), "sin(2π·{x}/{number:.4g})"),
    "cos": (lambda x, period: np.cos(2.0 * np.pi * x / period), "cos(2π·{x}/{number:.4g})"),
}


@dataclass(frozen=True)
class Term:
    """A product of factors; none is a constant."""

    factors: tuple[Factor, ...] = ()

    def column(self, series: ResidualSeries) -> Array:
        """Its contribution to the target, (m,)."""
        return series.filtered(self.values(series))

    def values(self, series: ResidualSeries) -> Array:
        """Values at the parts of the bins."""
        out = np.ones(len(next(iter(series.variables.values()))))
        for factor in self.factors:
            out = out * factor.values(series)
        return out

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(f.variable for f in self.factors))

    @property
    def periodic(self) -> Factor | None:
        """The sine or cosine factor; None where the term is not periodic."""
        return next((f for f in self.factors if f.function in ("sin", "cos")), None)

    @property
    def group(self) -> tuple[Factor, ...]:
        """Key of the group of the term: sine and cosine of one ripple form one group."""
        return tuple(Factor("periodic", f.variable, f.number) if f is self.periodic else f for f in self.factors)

    def __str__(self) -> str:
        return "·".join(map(str, self.factors))


def ripple(variable: str, period: float, modulation: tuple[Factor, ...]) -> tuple[Term, Term]:
    """Sine and cosine over a variable, each times the modulation of their amplitude."""
    return Term((Factor("sin", variable, period), *modulation)), Term((Factor("cos", variable, period), *modulation))


def modulations(series: Sequence[ResidualSeries]) -> list[tuple[Factor, ...]]:
    """Factors by which the amplitude of a ripple may be modulated, of variables that all series have."""
    if not series[0].rate:
        return [()]
    shared = shared_variables(series)
    directions = [name for name in shared if name.startswith("direction of ")]
    speeds = [name.replace("direction", "speed", 1) for name in directions[:1]]
    moving = [(Factor("abs", name),) for name in directions[:1]]
    return [(), *moving, *((Factor(function, name),) for name in speeds for function in ("identity", "abs"))]


def shared_variables(series: Sequence[ResidualSeries]) -> list[str]:
    """Names of the variables that all series have."""
    return [name for name in series[0].variables if all(name in part.variables for part in series)]
