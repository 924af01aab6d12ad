"""What recordings show of each axis without any model: the size of its response to the command, its delay, and its speed over
the command, by direction.

The size is a regression over all of the motion on a coarse grid: less exact than a fit of the plant, and sufficient to tell a
factor of ten. Delay and speed are the plots that an engineer makes first. All of them need no description of the machine beyond
which signal is which.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import correlate, savgol_filter

from sysid.datasets.chunked import Array, earlier, strided
from sysid.datasets.recording import Dataset, Recording
from sysid.machine import Axis, Machine
from sysid.scratch import computed, empty, pieces
from sysid.signals import axis_signal

#: Interval of the samples, and longest delay of a response that is tried [s].
STEP_S, MAX_DELAY_S = 0.05, 1.5
#: Interval of the samples of a force axis, whose acceleration is needed [s].
FORCE_STEP_S = 0.02
#: Rows of a recording, at most; and at least in all, for a response.
MAX_ROWS, MIN_ROWS = 2**15, 40
#: Rows for the response of every axis to the command of every other.
MAX_CROSS_ROWS, MIN_CROSS_ROWS = 2**13, 2**9
#: Axes up to which all of these rows are compared; and variance [of the largest square] that is rounding.
FEW, ROUNDING = 32, 1e-12


@dataclass(frozen=True)
class Response:
    """Slope of the driven quantity over the command.

    Args:
        value: velocity axes: speed per unit of command; position axes: position per unit of commanded position; force axes:
            moving mass or inertia.
        strength: correlation (multiple, for force axes) with the command, 0 … 1.
    """

    value: float
    strength: float

    def scaled(self, factor: float) -> Response:
        return replace(self, value=self.value * factor)


@dataclass(frozen=True)
class Motion:
    """Commands and a measured quantity of one axis on a coarse grid, (n,); NaN between recordings.

    Args:
        command, place, speed: of the axis; ``acceleration`` of force axes.
        step_s: interval of the rows [s].
    """

    command: Array
    place: Array
    speed: Array
    acceleration: Array
    step_s: float

    @property
    def delays(self) -> int:
        """Longest delay [rows]."""
        return max(1, round(MAX_DELAY_S / self.step_s))


def motion_of(recordings: Sequence[Recording], axis: Axis, signal: str, time_scale: float = 1.0) -> Motion:
    """Motion of ``signal`` over recordings.

    Args:
        time_scale: stamps / true time, where the unit of the stamps is known to be wrong.
    """
    wanted = (FORCE_STEP_S if axis.actuation == "force" else STEP_S) * time_scale
    longest = max((len(r) / r.rate_hz for r in recordings), default=0.0)
    wanted = max(wanted, longest / MAX_ROWS)
    parts: list[tuple[Array, ...]] = []
    gap = np.full(round(MAX_DELAY_S * time_scale / wanted) + 2, np.nan)
    for recording in recordings:
        stride = max(1, round(wanted * recording.rate_hz))
        dt = stride / recording.rate_hz
        command, place = (strided(recording.values(s), stride) for s in (axis_signal(axis.name, "command"), signal))
        speed, acceleration = np.full(len(place), np.nan), np.full(len(place), np.nan)
        if len(place) > 2:
            speed[1:-1] = (place[2:] - place[:-2]) / (2.0 * dt)
            acceleration[1:-1] = (place[2:] - 2.0 * place[1:-1] + place[:-2]) / dt**2
        parts.append(tuple(np.concatenate([part, gap]) for part in (command, place, speed, acceleration)))
    if not parts:
        return Motion(gap, gap, gap, gap, wanted)
    command, place, speed, acceleration = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Motion(command, place, speed, acceleration, wanted / time_scale)


def response_of(motion: Motion, axis: Axis) -> Response | None:
    """The response of an axis; None without enough motion and commands."""
    if axis.actuation == "force":
        return _moved_mass(motion)
    return _slope(motion.command, motion.speed if axis.actuation == "velocity" else motion.place, motion.delays)


def changes(values: Array) -> bool:
    """Whether values (n,) have two different numbers."""
    known = values[~np.isnan(values)]
    return bool(known.size) and bool(known.max() > known.min())


def correlation(command: Array, answer: Array, delays: int) -> float:
    """Largest correlation of the answer with the delayed command, signed; 0 where one of them does not change."""
    stride = max(1, len(command) // MAX_CROSS_ROWS)
    found = _slope(command[::stride], answer[::stride], max(1, delays // stride))
    return 0.0 if found is None else float(np.copysign(found.strength, found.value))


def strengths(commands: Array, answers: Array, delays: int) -> Array:
    """Largest absolute correlation of each answer (n, b) with each delayed command (n, a), (a, b); 0 where one is constant.

    The rows become fewer as the pairs become more.
    """
    rows = max(MIN_CROSS_ROWS, MAX_CROSS_ROWS // max(1, commands.shape[1] // FEW) ** 2)
    stride = max(1, len(commands) // rows)
    known, there = (_scaled(values[::stride]) for values in (commands, answers))
    best = np.zeros((commands.shape[1], answers.shape[1]))
    for delay in range(max(1, delays // stride) + 1):
        (u, has_u), (y, has_y) = ((earlier(each, delay) for each in known), (each[delay:] for each in there))
        count = has_u.T @ has_y
        enough = np.maximum(count, 1.0)
        sum_u, sum_y = u.T @ has_y, has_u.T @ y
        uu, yy = (u * u).T @ has_y - sum_u**2 / enough, has_u.T @ (y * y) - sum_y**2 / enough
        uy = u.T @ y - sum_u * sum_y / enough
        valid = (count >= MIN_ROWS) & (uu > ROUNDING) & (yy > ROUNDING)
        best = np.maximum(
            best, np.divide(np.abs(uy), np.sqrt(np.where(valid, uu * yy, 1.0)), where=valid, out=np.zeros_like(uy))
        )
    return best


def _scaled(values: Array) -> tuple[Array, Array]:
    """Columns (n, a) of mean zero and largest absolute value one, with zero for NaN; and where they are known."""
    known = ~np.isnan(values)
    centred = np.where(known, values - np.nanmean(values, axis=0), 0.0)
    return centred / np.maximum(np.abs(centred).max(axis=0), 1e-300), known.astype(np.float64)


def _slope(command: Array, answer: Array, delays: int) -> Response | None:
    """Slope at the delay with the largest correlation."""
    best: Response | None = None
    for delay in range(delays + 1):
        u, y = earlier(command, delay), answer[delay:]
        there = ~np.isnan(u) & ~np.isnan(y)
        if np.count_nonzero(there) < MIN_ROWS:
            continue
        u, y = u[there] - u[there].mean(), y[there] - y[there].mean()
        uu, yy, uy = float(u @ u), float(y @ y), float(u @ y)
        if not uu * yy > 0.0:
            continue
        strength = abs(uy) / np.sqrt(uu * yy)
        if best is None or strength > best.strength:
            best = Response(uy / uu, float(strength))
    return best


def _moved_mass(motion: Motion) -> Response | None:
    """Mass of ``force = mass · acceleration + viscous · speed + Coulomb · sign(speed) + load``, by least squares.

    The slope over the acceleration in the residuals of the other terms, at no delay (the force is measured).
    """
    columns = (motion.command, motion.acceleration, motion.speed, motion.place)
    there = ~np.any(np.isnan(columns), axis=0)
    if np.count_nonzero(there) < MIN_ROWS:
        return None
    force, acceleration, speed, place = (column[there] for column in columns)
    others = np.column_stack([np.ones(len(force)), speed, np.sign(speed), np.sin(place), np.cos(place)])
    basis = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))[0]
    force, acceleration = (column - basis @ (basis.T @ column) for column in (force, acceleration))
    aa, ff, af = float(acceleration @ acceleration), float(force @ force), float(acceleration @ force)
    if aa <= 0.0 or ff <= 0.0:
        return None
    return Response(af / aa, abs(af) / float(np.sqrt(aa * ff)))


#: Length of the blocks whose scatter gives the interval of a delay [s]; least number of them.
BLOCK_S, BLOCKS = 10.0, 4
#: A delay between two positions is exact to this share of a sample (the parabola between samples). Half of one is open where
#: there are fewer blocks, and between a command that is held for a sample and the speed that it makes.
EXACT = 0.05
#: A block shows a delay of its own if it has this share of the usual motion, and of the correlation of all.
MOVING, ALIKE = 0.2, 0.7
#: Least correlation of command and speed for a delay.
LEAST_CORRELATION = 0.2
#: Window of the derivative of a position [s], and least number of its samples.
WINDOW_S, WINDOW = 0.15, 5
#: Bins of the command in each direction, as a share of the largest; least number of samples in one.
BINS, LEAST = 10, 5
#: The command changed by at most this share of its largest value within this time [s] before a sample that counts.
STEADY, STEADY_S = 0.1, 0.2
#: An axis moves above this share of its speed at full command; samples nearer to the ends of its range do not count (a share).
MOVES, ENDS = 0.05, 0.02
#: Standard deviations of the noise of a speed above which an axis moves.
NOISES = 3.0
#: 97.5 % quantile of the normal distribution.
Z = 1.959964


@dataclass(frozen=True)
class SpeedBin:
    """Median speed of an axis at commands about ``command``, over ``count`` samples with a steady command."""

    command: float
    speed: float
    count: int


@dataclass(frozen=True)
class Direction:
    """One direction of the command of a valve axis.

    Args:
        bins: by size of the command.
        begins: between which commands (absolute values) motion begins; (0, first) where the smallest ones move it, NaN where
            none does or the recordings have no such commands.
        full, full95: median speed at the largest commands (absolute value), with its 95 % interval; NaN without any, and where
            the axis moved at them too shortly for an interval.
    """

    bins: tuple[SpeedBin, ...]
    begins: tuple[float, float]
    full: float
    full95: tuple[float, float]


@dataclass(frozen=True)
class AxisResponse:
    """What the recordings show of one axis.

    Args:
        delay, delay95: of the motion behind the command as the log has them, by cross-correlation, with its 95 % interval [s];
            NaN where they do not correlate, or where a force is commanded. Up to a sample before it, where a log has as its
            command what comes next.
        delays90: between which delays nine tenths of all parts of :data:`BLOCK_S` are [s]; NaN where there are few.
        correlation: of both at that delay.
        positive, negative: directions of the command of a valve axis; else None.
        unit: SI unit of what the command drives.
    """

    axis: str
    delay: float
    delay95: tuple[float, float]
    delays90: tuple[float, float]
    correlation: float
    positive: Direction | None
    negative: Direction | None
    unit: str


def responses_of(dataset: Dataset) -> tuple[AxisResponse, ...]:
    """One response for every axis with a measured motion."""
    return responses_in(dataset.of_kind("motion"), dataset.machine, dataset.units)


def responses_in(recordings: Sequence[Recording], machine: Machine, units: Mapping[str, str]) -> tuple[AxisResponse, ...]:
    """As :func:`responses_of`, in some recordings of motion."""
    found = []
    for axis in machine.axes:
        own = [r for r in recordings if {axis_signal(axis.name, "command"), axis.driven} <= {*r.signals}]
        if not own:
            continue
        delay, interval, parts, correlation = _delay(own, axis)
        unit = units.get(axis.driven) or machine.expected_unit(axis.driven) or "1"
        positive = negative = None
        if axis.actuation == "velocity" and math.isfinite(delay):
            positive, negative = _directions(own, axis, delay)
        found.append(AxisResponse(axis.name, delay, interval, parts, correlation, positive, negative, unit))
    return tuple(found)


def speed(values: Array, rate_hz: float) -> Array:
    """Derivative (n,) of a position by local quadratics; NaN beside missing values."""
    width = max(WINDOW, 2 * round(0.5 * WINDOW_S * rate_hz) + 1)
    if len(values) < width:
        return np.full(len(values), np.nan)

    def piece(first: int, last: int) -> Array:
        begin, end = max(first - width, 0), min(last + width, len(values))
        filled, known = _filled(values[begin:end])
        found = np.asarray(savgol_filter(filled, width, 2, deriv=1, delta=1.0 / rate_hz), dtype=np.float64)
        near = np.convolve(1.0 - known, np.ones(width), "same") > 0.5
        return np.where(near, np.nan, found)[first - begin : last - begin]

    result: Array = computed(len(values), piece)
    return result


Interval = tuple[float, float]
UNKNOWN: Interval = (math.nan, math.nan)


def _delay(recordings: Sequence[Recording], axis: Axis) -> tuple[float, Interval, Interval, float]:
    """Delay of the largest correlation [s], its 95 % interval, the range of those of the blocks, and the correlation."""
    unknown = math.nan, UNKNOWN, UNKNOWN, math.nan
    rate = max(r.rate_hz for r in recordings)
    if axis.actuation == "force":
        return unknown
    sums = [block for r in recordings for block in _correlation_sums(r, axis, rate)]
    if not sums:
        return unknown
    stacked = np.array(sums)  # (blocks, lags, 6)
    total = stacked.sum(axis=0)
    delay, correlation = _peak(total, rate)
    if not correlation >= LEAST_CORRELATION:
        return unknown
    half, parts = 0.5 / rate, UNKNOWN
    if len(stacked) >= BLOCKS:
        without = np.array([_peak(total - block, rate)[0] for block in stacked])
        count = len(without)
        least = 0.5 if axis.actuation == "velocity" else EXACT
        half = max(least / rate, Z * float(np.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2))))
        parts = _of_parts(stacked, rate, ALIKE * correlation)
    return delay, (delay - half, delay + half), parts, correlation


def _of_parts(sums: Array, rate: float, least: float) -> Interval:
    """Delays (5th and 95th percentile) of the blocks that move, and in which the motion answers: their correlation."""
    moved = sums[:, :, 4].max(axis=1)
    peaks = [_peak(block, rate) for block in sums[moved >= MOVING * np.median(moved)]]
    delays = [delay for delay, correlation in peaks if correlation >= least]
    return tuple(np.quantile(delays, (0.05, 0.95)).tolist()) if len(delays) >= BLOCKS else UNKNOWN


def _correlation_sums(recording: Recording, axis: Axis, rate: float) -> list[Array]:
    """Sums of both series, their squares and products at every lag from one sample ahead on, for each block: (lags, 6)."""
    command, moved = recording.values(axis_signal(axis.name, "command")), speed(recording.values(axis.driven), rate)
    if axis.actuation != "velocity":
        command = speed(command, rate)
    lags, length, found = round(MAX_DELAY_S * rate) + 2, max(round(BLOCK_S * rate), 1), []
    for first in range(0, max(len(moved) - length // 2, 1), length):
        last = min(first + length, len(moved))
        (u, has_u), (v, has_v) = _filled(_rows(command, first + 2 - lags, last + 1)), _filled(moved[first:last])
        rows = [
            correlate(one, other, "valid")[::-1]  # the last one is a sample ahead
            for one, other in ((has_u, has_v), (u, has_v), (has_u, v), (u * u, has_v), (has_u, v * v), (u, v))
        ]
        found.append(np.column_stack(rows))
    return found


def _rows(values: Array, first: int, last: int) -> Array:
    """Rows ``first`` to ``last`` - 1 of a signal (n,), NaN before its first and after its last."""
    found = np.full(last - first, np.nan)
    begin, end = max(first, 0), min(last, len(values))
    if end > begin:
        found[begin - first : end - first] = values[begin:end]
    return found


def _filled(values: Array) -> tuple[Array, Array]:
    """Values (n,) with zero for NaN, and where they are known."""
    known = ~np.isnan(values)
    return np.where(known, values, 0.0), known.astype(np.float64)


def _peak(sums: Array, rate: float) -> tuple[float, float]:
    """Lag of the largest correlation [s], between samples by a parabola, and the correlation."""
    count, u, v, uu, vv, uv = sums.T
    count = np.maximum(count, 1.0)
    scale = np.sqrt(np.maximum((uu - u * u / count) * (vv - v * v / count), 0.0))
    r = np.divide(uv - u * v / count, scale, out=np.zeros(len(scale)), where=scale > 0.0)
    best = int(np.argmax(np.abs(r)))
    at, sizes = float(best), np.abs(r)
    if 0 < best < len(r) - 1:
        below, top, above = sizes[best - 1 : best + 2]
        bend = below - 2.0 * top + above
        at += float(0.5 * (below - above) / bend) if bend < 0.0 else 0.0
    return (at - 1.0) / rate, float(sizes[best])


def _directions(recordings: Sequence[Recording], axis: Axis, delay: float) -> tuple[Direction, Direction]:
    """Both directions of the command of a valve axis."""
    places, commands = ([r.values(axis_signal(axis.name, part)) for r in recordings] for part in (axis.drives, "command"))
    low, high = (end.reduce([end.reduce(values, initial=np.nan) for values in places]) for end in (np.fmin, np.fmax))
    most = max(max(float(np.fmax.reduce(c, initial=0.0)), -float(np.fmin.reduce(c, initial=0.0))) for c in commands)
    u, v, own = (empty(sum(map(len, recordings))) for _ in range(3))
    done = 0
    for recording, values, command in zip(recordings, places, commands, strict=True):
        lag, before = max(0, round(delay * recording.rate_hz)), max(round(STEADY_S * recording.rate_hz), 1)
        weight = 1.0 / max(WINDOW, round(WINDOW_S * recording.rate_hz))
        moved = speed(values, recording.rate_hz)
        for first, last in pieces(len(recording)):
            late, place, rate = _rows(command, first - lag - before, last - lag), values[first:last], moved[first:last]
            steady = np.abs(late[before:] - late[:-before]) <= STEADY * most
            inside = (place > low + ENDS * (high - low)) & (place < high - ENDS * (high - low))
            counts = steady & inside & ~np.isnan(rate) & ~np.isnan(late[before:])
            rows = slice(done, done + int(np.count_nonzero(counts)))
            u[rows], v[rows], own[rows] = late[before:][counts], rate[counts], weight
            done = rows.stop
    u, v, own = u[:done], v[:done], own[:done]
    resting = v[np.abs(u) < 0.5 / BINS * most]
    noise = 1.4826 * float(np.median(np.abs(resting - np.median(resting)))) if len(resting) >= LEAST else 0.0
    forward, backward = u > 0.0, u < 0.0
    positive = _direction(u[forward], v[forward], own[forward], most, noise)
    return positive, _direction(-u[backward], -v[backward], own[backward], most, noise)


def _direction(u: Array, v: Array, own: Array, most: float, noise: float) -> Direction:
    """One direction from commands and speeds (n,); ``own``: independent values that a sample counts for, (n,)."""
    edges, bins, largest = np.linspace(0.0, most, BINS + 1), [], np.empty(0, dtype=bool)
    for low, high in itertools.pairwise(edges):
        inside = (u > low) & (u <= high * (1.0 + 1e-9))
        if low == 0.0:
            inside &= u > 0.5 * high  # the valve is in neutral below
        if np.count_nonzero(inside) >= LEAST:
            at, size = float(np.median(u[inside])), float(np.median(v[inside]))
            bins.append(SpeedBin(at, size, int(np.count_nonzero(inside))))
            largest = inside
    if not bins or bins[-1].command < 0.5 * most:
        return Direction(tuple(bins), (math.nan, math.nan), math.nan, (math.nan, math.nan))
    full = abs(bins[-1].speed)
    least = max(MOVES * full, NOISES * noise)
    still = [item.command for item in bins if abs(item.speed) <= least]
    last = max(still, default=0.0)
    moving = [item.command for item in bins if item.command > last and abs(item.speed) > least]
    full95 = _median95(math.copysign(1.0, bins[-1].speed) * v[largest], float(own[largest].sum()))
    return Direction(tuple(bins), (last, min(moving, default=math.nan)), full, full95)


def _median95(values: Array, count: float) -> tuple[float, float]:
    """95 % interval of the median of values of which ``count`` are independent, by their order; NaN where these are too few."""
    away = 0.5 * Z / math.sqrt(max(count, 1e-12))
    if away >= 0.5:
        return math.nan, math.nan
    low, high = np.quantile(values, [0.5 - away, 0.5 + away])
    return float(low), float(high)
