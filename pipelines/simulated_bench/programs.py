"""Excitation programs for single properties of the machine, beside an operator's work.

A program fills the same table of strokes as the operator (:mod:`simulated_bench.operator`), with the same rules near the end
stops. Axes take turns unless the program moves all of them at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from simulated_bench.operator import draw_strokes
from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings

Array = npt.NDArray[np.float64]
#: Start [s], duration [s], level [command], edge [s].
Stroke = tuple[float, float, float, float]

#: Shortest edge: a step as fast as the controller's cycle allows [s].
SHARP = 0.01


def strokes_of(recipe: BenchRecipe, recording: RecordingSettings, rng: np.random.Generator) -> Array:
    """Strokes of a recording (axes, m, 4); see :func:`simulated_bench.operator.draw_strokes`."""
    if recording.program == "operator":
        return draw_strokes(recipe.operator, recording.seconds, rng)
    begin = recipe.operator.parked
    if recording.program == "flight":
        return np.full((len(AXES), 1, 4), np.inf)  # no strokes
    if recording.program == "script":
        per_axis: list[list[Stroke]] = [
            [(s.start, s.duration, s.level, s.edge) for s in recording.strokes if s.axis == name] for name in AXES
        ]
    else:
        per_axis = _PROGRAMS[recording.program](begin, recording.seconds - 1.0, rng)
    table = np.full((len(AXES), max(len(strokes) for strokes in per_axis) + 1, 4), np.inf)
    for row, strokes in zip(table, per_axis, strict=True):
        row[: len(strokes)] = np.reshape(sorted(strokes), (-1, 4))
    return table


def _in_turns(begin: float, end: float, pattern: Callable[[int], list[Stroke]]) -> list[list[Stroke]]:
    """Axes one after the other, again and again; ``pattern(round)`` gives (pause, duration, level, edge) of one turn."""
    per_axis: list[list[Stroke]] = [[] for _ in AXES]
    time, turn = begin, 0
    while True:
        for strokes in per_axis:
            for pause, duration, level, edge in pattern(turn):
                if time + duration > end:
                    return per_axis
                strokes.append((time, duration, level, edge))
                time += duration + pause
        turn += 1


def _reversals(begin: float, end: float, rng: np.random.Generator) -> list[list[Stroke]]:
    """Slow reversals: for backlash, hysteresis and friction at low speed."""

    def pattern(turn: int) -> list[Stroke]:
        level = float(rng.uniform(0.28, 0.40))
        return [(0.05, 0.9, level * (1 if k % 2 == 0 else -1), 0.25) for k in range(6)]

    return _in_turns(begin, end, pattern)


def _stairs(begin: float, end: float, rng: np.random.Generator) -> list[list[Stroke]]:
    """Small commands in rising pulses, both ways: for overlap, stiction and break-away."""
    levels = np.arange(0.04, 0.37, 0.04)

    def pattern(turn: int) -> list[Stroke]:
        shift = 0.02 * (turn % 2)
        return [(0.1, 0.6, sign * (float(level) + shift), SHARP) for level in levels for sign in (1.0, -1.0)]

    return _in_turns(begin, end, pattern)


def _steps(begin: float, end: float, rng: np.random.Generator) -> list[list[Stroke]]:
    """Steps of one axis at several amplitudes: for delay, lag, gain, gain curve, asymmetry and oscillation."""

    def pattern(turn: int) -> list[Stroke]:
        levels = (0.35, 0.6, 0.85, 1.0)
        order = rng.permutation(len(levels))
        return [(0.4, 0.9, sign * levels[k], SHARP) for k in order for sign in (1.0, -1.0)]

    return _in_turns(begin, end, pattern)


def _together(begin: float, end: float, rng: np.random.Generator) -> list[list[Stroke]]:
    """One axis, then all at once with large commands: for the shared pump."""
    per_axis: list[list[Stroke]] = [[] for _ in AXES]
    time = begin
    while True:
        signs = rng.choice([-1.0, 1.0], len(AXES))
        alone = int(rng.integers(len(AXES)))
        for moving, size in (([alone], -1.0), (range(len(AXES)), 1.0)):
            duration = float(rng.uniform(1.2, 2.2))
            if time + duration > end:
                return per_axis
            for axis in moving:
                per_axis[axis].append((time, duration, float(size * signs[axis] * rng.uniform(0.7, 1.0)), 0.1))
            time += duration + 0.5


def _rest(begin: float, end: float, rng: np.random.Generator) -> list[list[Stroke]]:
    """Move to a loaded pose, then a long rest: for leakage, drift and sag."""
    per_axis: list[list[Stroke]] = [[] for _ in AXES]
    time = begin
    while time + 4.0 < end:
        for axis, level in ((1, -0.7), (2, -0.8), (3, 0.9)):
            wide = level * float(rng.uniform(0.8, 1.0)) * (1.0 if len(per_axis[axis]) % 2 == 0 else -1.0)
            per_axis[axis].append((time, 2.0, wide, 0.3))
        time += 2.0 + max(10.0, 0.3 * (end - begin))
    return per_axis


_PROGRAMS: dict[str, Callable[[float, float, np.random.Generator], list[list[Stroke]]]] = {
    "reversals": _reversals,
    "stairs": _stairs,
    "steps": _steps,
    "together": _together,
    "rest": _rest,
}


def check_script(recording: RecordingSettings) -> str | None:
    """The error in the strokes of a script, or None."""
    if (recording.program == "script") != bool(recording.strokes):
        return "strokes belong to the program 'script', and only to it"
    for name in AXES:
        end = -math.inf
        for stroke in sorted((s for s in recording.strokes if s.axis == name), key=lambda s: s.start):
            if stroke.start < end or not stroke.duration > 0.0 or not 0.0 < stroke.edge <= 0.5 * stroke.duration:
                return f"stroke of {name} at {stroke.start} s overlaps another or has no duration or edge"
            end = stroke.start + stroke.duration
    return None
