"""How an axis was used: command space per direction, reversals, small commands, slow motion. It adds up over recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.quality.noise import unsteadiness
from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: A command below this share of the axis's large ones (their 95th percentile) is none: a joystick rarely comes back exactly.
IDLE = 0.02
#: A command between these shares of full is small: a valve's dead-band ends somewhere in there.
SMALL = (0.02, 0.4)
#: Cells over −full … full in which the time at each command is counted, and the time that makes a cell visited [s].
CELLS, VISITED_S = 20, 0.2
#: A turn of less than this share of a recording's travel, or of so many standard deviations of noise, is no reversal: thousands
#: of samples of a sensor at rest lie within four standard deviations on either side.
TURN, TURN_NOISE = 0.01, 8.0
#: Slow is between these shares of the top speed. Dry friction falls with speed, and drives stick and slip, at small speeds only
#: (Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083); where that ends differs: the tenth is a choice.
SLOW = (0.02, 0.1)
#: Speeds are slopes over this long [s]; below so many standard deviations of noise they are none.
SLOPE_S, UNREST = 0.2, 4.0


@dataclass(frozen=True)
class Scale:
    """What is large for an axis: its full command (1 for a valve, else the largest recorded), and its top speed [SI/s]."""

    full: float
    top_speed: float


@dataclass(frozen=True)
class AxisUse:
    """What an axis was asked to do and did.

    Args:
        full: the command that counts as full.
        seconds: time at commands in :data:`CELLS` equal cells over −full … full (idle time is not among them).
        idle_s, positive_s, negative_s: time without command and with one in either direction.
        small_positive_s, small_negative_s: time at small commands, :data:`SMALL` as shares of full.
        command_changes: starts, stops and reversals of the command, or its turning points where it never comes to rest.
        reversals: of the joint (of what is driven, where no joint is measured), beyond :data:`TURN`.
        slow_positive_s, slow_negative_s: time in which it moved slowly, :data:`SLOW`.
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
    """Axis → what is large for it in these recordings; an axis without commands is left out."""
    found, recordings = {}, [recording for recording in recordings if recording.kind == "motion"]
    for axis in machine.axes:
        parts = [r.values(axis_signal(axis.name, "command")) for r in recordings]
        commands = np.concatenate([part[~np.isnan(part)] for part in parts]) if parts else np.empty(0)
        if not len(commands):
            continue
        full = 1.0 if axis.actuation == "velocity" else float(np.max(np.abs(commands))) or 1.0
        speeds = np.concatenate([np.abs(speed_of(r.values(moved_signal(r, axis)), r.rate_hz)) for r in recordings])
        speeds = speeds[~np.isnan(speeds)]
        found[axis.name] = Scale(full, float(np.quantile(speeds, 0.99)) if len(speeds) else 0.0)
    return found


def use_of(recording: Recording, axis: Axis, scale: Scale) -> AxisUse:
    """How the axis was used in one recording of motion."""
    command = recording.values(axis_signal(axis.name, "command"))
    level = level_of(command)
    given = np.nan_to_num(command[level != 0]) / scale.full
    seconds = np.histogram(np.clip(given, -1.0, 1.0), bins=CELLS, range=(-1.0, 1.0))[0] / recording.rate_hz
    moved = recording.values(moved_signal(recording, axis))
    speed = speed_of(moved, recording.rate_hz)
    least = max(SLOW[0] * scale.top_speed, _unrest(moved, recording.rate_hz))
    slow = (np.abs(speed) > least) & (np.abs(speed) < SLOW[1] * scale.top_speed)
    small = [(side * command > SMALL[0] * scale.full) & (side * command < SMALL[1] * scale.full) for side in (1.0, -1.0)]

    def lasting(mask: npt.NDArray[np.bool_]) -> float:
        return float(np.sum(mask)) / recording.rate_hz

    return AxisUse(
        full=scale.full,
        seconds=tuple(map(float, seconds)),
        idle_s=lasting((level == 0) & ~np.isnan(command)),
        positive_s=lasting(level > 0),
        negative_s=lasting(level < 0),
        small_positive_s=lasting(small[0]),
        small_negative_s=lasting(small[1]),
        command_changes=command_changes(command),
        reversals=reversals(moved, recording.rate_hz),
        slow_positive_s=lasting(slow & (speed > 0)),
        slow_negative_s=lasting(slow & (speed < 0)),
    )


def together(uses: Sequence[AxisUse]) -> AxisUse:
    """The sum over recordings.

    Raises:
        ValueError: there is none to add up.
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
    names = list(active)
    return {
        (a, b): float(np.sum(active[a] & active[b])) / recording.rate_hz for i, a in enumerate(names) for b in names[i + 1 :]
    }


def moved_signal(recording: Recording, axis: Axis) -> str:
    """The joint; what is driven, where this recording has no joint."""
    joint = axis_signal(axis.name, "joint")
    return joint if not np.isnan(recording.values(joint)).all() else axis.driven


def level_of(command: Array) -> Array:
    """The command as −1, 0, +1, with what is below :data:`IDLE` of its large values as 0 (a spike is none of them)."""
    u = np.nan_to_num(command)
    given = np.abs(u[u != 0.0])
    return np.where(np.abs(u) > IDLE * np.percentile(given, 95), np.sign(u), 0.0) if len(given) else np.zeros(len(u))


def command_changes(command: Array) -> int:
    """Starts, stops and reversals, or the turning points of a command that never comes to rest."""
    u = np.nan_to_num(command)
    if not len(u):
        return 0
    turns = turning_points(u, 0.2 * float(np.ptp(np.percentile(u, (2.5, 97.5)))))
    return max(int(np.sum(np.diff(level_of(command)) != 0)), turns)


def reversals(values: Array, rate_hz: float | None) -> int:
    """Changes of direction beyond :data:`TURN` of the travel and :data:`TURN_NOISE` of the noise.

    Args:
        rate_hz: None for static poses: their rows are no motion from which noise could be told.
    """
    known = values[~np.isnan(values)]
    if not len(known):
        return 0
    noise = 0.0 if rate_hz is None else unsteadiness(known, rate_hz)
    return turning_points(known, max(TURN * float(np.ptp(known)), TURN_NOISE * noise))


def turning_points(values: Array, least: float) -> int:
    """Reversals of a signal by more than ``least`` (so that noise does not count)."""
    if least <= 0.0 or not len(values):
        return 0
    count, direction, extreme = 0, 0, float(values[0])
    for value in _corners(values):
        if (direction >= 0 and value > extreme) or (direction <= 0 and value < extreme):
            if direction == 0 and abs(value - extreme) > least:
                direction = 1 if value > extreme else -1
                extreme = value
            elif direction != 0:
                extreme = value
        elif abs(value - extreme) > least:
            count += 1
            direction = 1 if value > extreme else -1
            extreme = value
    return count


def _corners(values: Array) -> list[float]:
    """The ends of all stretches in which the signal only rises or only falls: nothing between them can be a turn."""
    changed = values[np.concatenate([[True], np.diff(values) != 0.0])]
    up = np.diff(changed) > 0.0
    ends: list[float] = changed[1:][np.concatenate([up[1:] != up[:-1], [True]])].tolist() if len(up) else []
    return ends


def speed_of(values: Array, rate_hz: float) -> Array:
    """Slope over :data:`SLOPE_S` around each sample [unit/s], NaN at the ends and across gaps, (n,)."""
    half = max(round(0.5 * SLOPE_S * rate_hz), 1)
    speed = np.full(len(values), np.nan)
    if len(values) > 2 * half:
        speed[half:-half] = (values[2 * half :] - values[: -2 * half]) * rate_hz / (2 * half)
    return speed


def _unrest(values: Array, rate_hz: float) -> float:
    """The speed that noise alone may feign [unit/s]."""
    return UNREST * float(np.sqrt(2.0)) * unsteadiness(values, rate_hz) / SLOPE_S
