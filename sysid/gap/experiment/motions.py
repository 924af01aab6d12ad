"""Motions that excite effects: each an endless sequence of strokes, of which an experiment uses as many as its time allows.

They are those of :class:`sysid.effects.Need` and of robot identification (Swevers, Ganseman, Tükel, De Schutter, Van Brussel,
IEEE Trans. Robotics and Automation 13 (1997): exciting trajectories are chosen from a family that keeps to the limits by
construction): here trapezoidal speed profiles that return to the initial position.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

#: Time in which a sharp stroke reaches its speed [s].
SHARP = 0.02


@dataclass(frozen=True)
class Stroke:
    """A trapezoid of speed of one axis.

    Args:
        axis: index of the axis.
        level: speed as a share of full speed, signed.
        seconds: longest duration, both edges included; shorter where the stroke would exceed ``reach``.
        edge: rise and fall time [s].
        reach: longest displacement as a share of the range of the axis.
        to: prescribed end, as a share of the range from the start of the motion; None: no prescribed end.
    """

    axis: int
    level: float
    seconds: float
    edge: float
    reach: float
    to: float | None = None


@dataclass(frozen=True)
class StrokeGroup:
    """Strokes that begin simultaneously, and the pause after the longest of them [s]."""

    strokes: tuple[Stroke, ...]
    pause: float = 0.0


#: (moving axes, random generator) → endless sequence of cycles of stroke groups; a cycle returns to the initial position.
Cycles = Callable[[Sequence[int], np.random.Generator], Iterator[tuple[StrokeGroup, ...]]]


@dataclass(frozen=True)
class MotionPattern:
    """One kind of motion; ``several``: moves all axes, else one axis at a time."""

    name: str
    about: str
    cycles: Cycles
    several: bool = False


def _there_and_back(strokes: Callable[[int, np.random.Generator], tuple[float, float, float, float, float]]) -> Cycles:
    """Pairs of strokes; ``strokes(k, rng)`` gives (level, seconds, edge, reach, pause) of the k-th pair."""

    def cycles(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[StrokeGroup, ...]]:
        k = 0
        while True:
            for axis in axes:
                level, seconds, edge, reach, pause = strokes(k, rng)
                out = Stroke(axis, level, seconds, edge, reach)
                back = Stroke(axis, -level, seconds, edge, reach, 0.0)
                yield StrokeGroup((out,), pause), StrokeGroup((back,), pause)
            k += 1

    return cycles


def _one_of(values: Sequence[float], k: int) -> float:
    return values[k % len(values)] * (1.0 if (k // len(values)) % 2 == 0 else -1.0)


def _sweep(k: int, rng: np.random.Generator) -> tuple[float, float, float, float, float]:
    """Half waves of increasing frequency from 0.3 to 4 Hz, over twelve pairs."""
    half = 0.5 / (0.3 * (4.0 / 0.3) ** ((k % 12) / 11.0))
    return 0.6, half, 0.5 * half, 0.2, 0.0


def _tap(k: int, rng: np.random.Generator) -> tuple[float, float, float, float, float]:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(0.35, 0.9)), float(rng.uniform(0.1, 0.5)), SHARP, 0.2, 0.15


def _together(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[StrokeGroup, ...]]:
    """Each axis alone, then all at once, at full speed."""
    while True:
        for moving in (*((axis,) for axis in axes), tuple(axes)):
            levels = rng.choice([-1.0, 1.0], len(moving)) * rng.uniform(0.7, 1.0, len(moving))
            pairs = list(zip(moving, map(float, levels), strict=True))
            out = tuple(Stroke(axis, level, 2.0, 0.1, 0.3) for axis, level in pairs)
            back = tuple(Stroke(axis, -level, 2.0, 0.1, 0.3, 0.0) for axis, level in pairs)
            yield StrokeGroup(out, 0.4), StrokeGroup(back, 0.4)


def _poses(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[StrokeGroup, ...]]:
    """Random poses over nine tenths of the range, all axes moving at once, with 1 s at rest at each."""
    place = dict.fromkeys(axes, 0.0)
    while True:
        strokes = []
        for axis in axes:
            to = float(rng.uniform(-0.45, 0.45))
            way = to - place[axis]
            strokes.append(Stroke(axis, 0.7 if way > 0.0 else -0.7, 60.0, 0.2, abs(way), to))
            place[axis] = to
        yield (StrokeGroup(tuple(strokes), 1.2),)


#: Motions that are tested, described as instructions for an operator.
MOTIONS: tuple[MotionPattern, ...] = (
    MotionPattern(
        "reversals",
        "slow reversals of {axes}",
        _there_and_back(lambda k, rng: (_one_of((0.25, 0.4, 0.6), k), 1.2, 0.3, 0.12, 0.0)),
    ),
    MotionPattern(
        "stairs",
        "pulses of {axes} that rise from 3 to 42 %, both ways",
        _there_and_back(lambda k, rng: (_one_of(tuple(0.03 * n for n in range(1, 15)), k), 0.6, SHARP, 0.12, 0.2)),
    ),
    MotionPattern(
        "steps",
        "sharp starts and stops of {axes} at 30, 60 and 100 %, both ways",
        _there_and_back(lambda k, rng: (_one_of((0.3, 0.6, 1.0), k), 1.0, SHARP, 0.25, 0.5)),
    ),
    MotionPattern("taps", "short sharp taps of {axes} at random", _there_and_back(_tap)),
    MotionPattern(
        "ramps",
        "slow ramps of {axes} through zero, up to 30, 60 and 100 %",
        _there_and_back(lambda k, rng: (_one_of((0.3, 0.6, 1.0), k), 3.0, 1.5, 0.3, 0.0)),
    ),
    MotionPattern(
        "creeping",
        "{axes} creeping at 1 to 15 %, both ways",
        _there_and_back(lambda k, rng: (_one_of((0.02, 0.08, 0.01, 0.15, 0.04), k), 4.0, 0.4, 0.15, 0.2)),
    ),
    MotionPattern("sweep", "{axes} to and fro with increasing frequency, 0.3 to 4 Hz", _there_and_back(_sweep)),
    MotionPattern(
        "strokes",
        "{axes} over most of the range at 50, 80 and 100 %",
        _there_and_back(lambda k, rng: (_one_of((0.5, 0.8, 1.0), k), 60.0, 0.1, 0.8, 0.4)),
    ),
    MotionPattern(
        "rest",
        "{axes} driven out and left at rest for 12 s, repeatedly",
        _there_and_back(lambda k, rng: (_one_of((0.6,), k), 60.0, 0.2, 0.4, 12.0)),
    ),
    MotionPattern(
        "swing",
        "{axes} moved briskly, stopped, and left at rest for 5 s",
        _there_and_back(lambda k, rng: (_one_of((1.0, 0.7), k), 0.8, SHARP, 0.25, 5.0)),
    ),
    MotionPattern("together", "{axes} at large commands, each alone and all at once", _together, several=True),
    MotionPattern("poses", "random poses of {axes}, 1 s at rest at each", _poses, several=True),
)
