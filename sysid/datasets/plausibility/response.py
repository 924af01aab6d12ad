"""Response of an axis to its command: speed, position or acceleration per unit of command, from all recordings.

A regression over all of the motion: its slope is less exact than a fit of the plant, and sufficient to tell a factor of ten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine import Axis
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

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
        command = recording.values(axis_signal(axis.name, "command"))[::stride]
        place = recording.values(signal)[::stride]
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
    known, there = (_filled(values[::stride]) for values in (commands, answers))
    best = np.zeros((commands.shape[1], answers.shape[1]))
    for delay in range(max(1, delays // stride) + 1):
        (u, has_u), (y, has_y) = ((each[: len(each) - delay] for each in known), (each[delay:] for each in there))
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


def _filled(values: Array) -> tuple[Array, Array]:
    """Columns (n, a) of mean zero and largest absolute value one, with zero for NaN; and where they are known."""
    known = ~np.isnan(values)
    centred = np.where(known, values - np.nanmean(values, axis=0), 0.0)
    return centred / np.maximum(np.abs(centred).max(axis=0), 1e-300), known.astype(np.float64)


def _slope(command: Array, answer: Array, delays: int) -> Response | None:
    """Slope at the delay with the largest correlation."""
    best: Response | None = None
    for delay in range(delays + 1):
        u, y = command[: len(command) - delay], answer[delay:]
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
