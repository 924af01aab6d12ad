"""Use of an axis: command space per direction, reversals, small commands, slow motion; additive over recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import Array, counted, ends, finite, known, measured, quantiles, remembered
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.scratch import computed, pieces
from sysid.signals import axis_signal

#: Values that are looked at together: at least after a reversal (else half as many as before it), and at most; those in a row
#: of which the lowest and the highest count.
_FEW, _MOST, _ROW = 64, 2**16, 32
#: Command of each row as −1, 0, +1, (n,).
Levels = npt.NDArray[np.int8]


def turning_points(values: Array, least: float) -> int:
    """Number of reversals of a signal without gaps (n,) by more than ``least``; 0 if that is not positive."""
    return len(turning_rows(_outline(values, least), least)) if least > 0.0 else 0


def _outline(values: Array, least: float) -> Array:
    """A part of a signal (n,) with as many reversals by more than ``least``.

    Of values in a row that differ by at most that, the lowest and the highest: none of them is a reversal against another.
    """
    parts = []
    for first, last in pieces(len(values)):
        some = values[first:last]
        rows = some[: len(some) // _ROW * _ROW].reshape(-1, _ROW)
        every, low, high = np.arange(len(rows)), rows.argmin(axis=1), rows.argmax(axis=1)
        kept = np.ones(len(some), dtype=np.bool_)
        there = kept[: rows.size].reshape(rows.shape)
        there[rows[every, high] - rows[every, low] <= least] = False
        there[every, low] = there[every, high] = True
        parts.append(some[kept])
    return np.concatenate(parts) if parts else values


def turning_rows(values: Array, least: float) -> npt.NDArray[np.intp]:
    """Rows at which it is certain that a signal without gaps (n,) has reversed by more than ``least``.

    The first motion by more than ``least``, in either direction, is none.
    """
    found: list[int] = []
    direction, low, high, row, piece = 0, np.inf, -np.inf, 0, _FEW
    while row < len(values):
        some = values[row : row + piece]
        rise = some - np.minimum(np.minimum.accumulate(some), low) > least if direction <= 0 else None
        fall = np.maximum(np.maximum.accumulate(some), high) - some > least if direction >= 0 else None
        up, down = _first(rise), _first(fall)
        if up is None and down is None:
            low, high, row = min(low, float(some.min())), max(high, float(some.max())), row + len(some)
            piece = min(2 * piece, _MOST)
            continue
        rises = down is None or (up is not None and up < down)
        row += (up if rises else down) or 0
        if direction:
            found.append(row)
        direction, low, high = (1, low, float(values[row])) if rises else (-1, float(values[row]), high)
        row, piece = row + 1, max(piece // 2, _FEW)
    return np.array(found, dtype=np.intp)


def _first(mask: npt.NDArray[np.bool_] | None) -> int | None:
    """The first True of a mask."""
    if mask is None:
        return None
    place = int(np.argmax(mask))
    return place if mask[place] else None


#: A command below this share of the axis's 95th percentile is zero, because a joystick rarely returns exactly.
IDLE = 0.02
#: Small commands as shares of full; they contain the end of a valve's dead-band.
SMALL = (0.02, 0.4)
#: Cells over −full … full in which the time at each command is counted, and the time that makes a cell visited [s].
CELLS, VISITED_S = 20, 0.2
#: Least size of a reversal as a share of a recording's travel, and in standard deviations of the noise: thousands of samples of
#: a sensor at rest are within four on either side.
TURN, TURN_NOISE = 0.01, 8.0
#: Slow motion as shares of the top speed. Dry friction falls with speed, and drives stick and slip, at small speeds only
#: (Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083); the upper limit is a choice.
SLOW = (0.02, 0.1)
#: Interval over which slopes are speeds [s]; least speed in standard deviations of its noise.
SLOPE_S, SPEED_NOISE = 0.2, 4.0


@dataclass(frozen=True)
class Scale:
    """Full command of an axis (1 for a valve, else the largest recorded), and its top speed [SI/s]."""

    full: float
    top_speed: float


@dataclass(frozen=True)
class AxisUse:
    """Commands and motion of an axis.

    Args:
        full: full command.
        seconds: time at commands in :data:`CELLS` equal cells over −full … full, without idle time.
        idle_s, positive_s, negative_s: time without command and with one in either direction.
        small_positive_s, small_negative_s: time at small commands, :data:`SMALL` as shares of full.
        command_changes: starts, stops and reversals of the command, or its turning points if it is never zero.
        reversals: of the joint (of the driven quantity, where no joint is measured), beyond :data:`TURN`.
        slow_positive_s, slow_negative_s: time in slow motion, :data:`SLOW`.
    """

    full: float
    seconds: tuple[float, ...]
    idle_s: float
    positive_s: float
    negative_s: float
    small_positive_s: float
    small_negative_s: float
    command_changes: int
    reversals: int
    slow_positive_s: float
    slow_negative_s: float

    def covered(self, side: int) -> float:
        """Share of the command cells on one side (+1 or −1) that were visited."""
        half = self.seconds[CELLS // 2 :] if side > 0 else self.seconds[: CELLS // 2]
        return sum(s >= VISITED_S for s in half) / len(half)


def scales_of(recordings: Sequence[Recording], machine: Machine) -> dict[str, Scale]:
    """Axis → its scale in these recordings; an axis without commands is omitted."""
    found, recordings = {}, [recording for recording in recordings if recording.kind == "motion"]
    for axis in machine.axes:
        commands = [r.values(axis_signal(axis.name, "command")) for r in recordings]
        largest = [max(high, -low) for low, high in map(ends, filter(measured, commands))]
        if not largest:
            continue
        full = 1.0 if axis.actuation == "velocity" else max(largest) or 1.0
        sizes = [_sizes(r.values(moved_signal(r, axis)), r.rate_hz) for r in recordings]
        (top,) = quantiles(sizes, (0.99,))
        found[axis.name] = Scale(full, 0.0 if np.isnan(top) else top)
    return found


def _sizes(values: Array, rate_hz: float) -> tuple[int, Callable[[int, int], Array]]:
    """Sizes of the speeds of a signal (n,), for :func:`~sysid.datasets.chunked.quantiles`."""
    return len(values), lambda first, last: known(np.abs(speeds(values, rate_hz, first, last)))


def use_of(recording: Recording, axis: Axis, scale: Scale) -> AxisUse:
    """Use of the axis in one recording of motion."""
    command, moved = (recording.values(name) for name in (axis_signal(axis.name, "command"), moved_signal(recording, axis)))
    level = level_of(command)
    least = max(SLOW[0] * scale.top_speed, SPEED_NOISE * float(np.sqrt(2.0)) * table_noise(moved, recording.rate_hz) / SLOPE_S)
    small, slow = (SMALL[0] * scale.full, SMALL[1] * scale.full), (least, SLOW[1] * scale.top_speed)
    cells, rows = np.zeros(CELLS, dtype=np.intp), dict[str, int]()
    for first, last in pieces(len(command)):
        u, to, speed = command[first:last], level[first:last], speeds(moved, recording.rate_hz, first, last)
        cells += np.histogram(np.clip(finite(u[to != 0]) / scale.full, -1.0, 1.0), bins=CELLS, range=(-1.0, 1.0))[0]
        own = {"idle_s": (to == 0) & ~np.isnan(u), "positive_s": to > 0, "negative_s": to < 0}
        for name, values, (low, high) in (("small", u, small), ("slow", speed, slow)):
            own[f"{name}_positive_s"] = (values > low) & (values < high)
            own[f"{name}_negative_s"] = (values < -low) & (values > -high)
        for name, mask in own.items():
            rows[name] = rows.get(name, 0) + int(np.count_nonzero(mask))
    seconds = {name: rows.get(name, 0) / recording.rate_hz for name in AxisUse.__dataclass_fields__ if name.endswith("_s")}
    return AxisUse(
        full=scale.full,
        seconds=tuple(map(float, cells / recording.rate_hz)),
        command_changes=command_changes(command),
        reversals=reversals(moved, recording.rate_hz),
        **seconds,
    )


def together(uses: Sequence[AxisUse]) -> AxisUse:
    """The sum over recordings.

    Raises:
        ValueError: ``uses`` is empty.
    """
    if not uses:
        raise ValueError("no use to add up")
    counts = np.sum([use.seconds for use in uses], axis=0)
    sums: dict[str, Any] = {
        key: sum(getattr(use, key) for use in uses) for key in AxisUse.__dataclass_fields__ if key != "seconds"
    }
    return AxisUse(**{**sums, "full": uses[0].full, "seconds": tuple(map(float, counts))})


def pairs_together(recording: Recording, scales: Mapping[str, Scale]) -> dict[tuple[str, str], float]:
    """Pair of axes → seconds in which both are commanded."""
    active = {name: level_of(recording.values(axis_signal(name, "command"))) != 0 for name in scales}
    return {(a, b): float(np.sum(active[a] & active[b])) / recording.rate_hz for a, b in combinations(active, 2)}


def moved_signal(recording: Recording, axis: Axis, stride: int = 1) -> str:
    """The joint, or the driven quantity where this recording has no joint in every ``stride``-th sample."""
    joint = axis_signal(axis.name, "joint")
    return joint if measured(recording.values(joint)[::stride]) else axis.driven


@remembered
def level_of(command: Array) -> Levels:
    """The command as −1, 0, +1, with 0 below :data:`IDLE` of its 95th percentile (which is robust against outliers)."""

    def given(first: int, last: int) -> Array:
        sizes: Array = np.abs(finite(command[first:last]))
        return np.asarray(sizes[sizes != 0.0])

    (high,) = quantiles([(len(command), given)], (0.95,))
    least = IDLE * high if not np.isnan(high) else np.inf

    def level(first: int, last: int) -> Levels:
        u = command[first:last]
        return (u > least).view(np.int8) - (u < -least).view(np.int8)

    result: Levels = computed(len(command), level, np.int8)
    return result


@remembered
def command_changes(command: Array) -> int:
    """Starts, stops and reversals, or the turning points of a command that is never zero."""
    if not len(command):
        return 0
    given = len(command), lambda first, last: finite(command[first:last])
    low, high = quantiles([given], (0.025, 0.975))
    whole = not counted(len(command), lambda first, last: ~np.isfinite(command[first:last]))
    turns = turning_points(command if whole else computed(*given), 0.2 * (high - low))
    level = level_of(command)
    return max(counted(len(level) - 1, lambda first, last: level[first + 1 : last + 1] != level[first:last]), turns)


@remembered
def reversals(values: Array, rate_hz: float | None) -> int:
    """Changes of direction beyond :data:`TURN` of the travel and :data:`TURN_NOISE` of the noise.

    Args:
        rate_hz: None for static poses, whose rows are no motion.
    """
    there = known(values)
    if not len(there):
        return 0
    noise = 0.0 if rate_hz is None else table_noise(there, rate_hz)
    low, high = ends(values)
    return turning_points(there, max(TURN * (high - low), TURN_NOISE * noise))


def speed_of(values: Array, rate_hz: float) -> Array:
    """Slope over :data:`SLOPE_S` around each sample [unit/s], NaN at the ends and across gaps, (n,)."""
    speed: Array = computed(len(values), lambda first, last: speeds(values, rate_hz, first, last))
    return speed


def speeds(values: Array, rate_hz: float, first: int, last: int) -> Array:
    """Rows ``first`` to ``last`` - 1 of :func:`speed_of`."""
    half = max(round(0.5 * SLOPE_S * rate_hz), 1)
    speed = np.full(last - first, np.nan)
    a, b = max(first, half), min(last, len(values) - half)
    if b > a:
        speed[a - first : b - first] = (values[a + half : b + half] - values[a - half : b - half]) * rate_hz / (2 * half)
    return speed
