"""Motions that show effects: each an endless sequence of strokes, of which an experiment takes as many as it has time for.

They are those of :class:`sysid.effects.Need` and of robot identification (Swevers, Ganseman, Tükel, De Schutter, Van Brussel,
IEEE Trans. Robotics and Automation 13 (1997): exciting trajectories are chosen from a family that keeps to the limits by
construction): here trapezoids of speed that come back to where they began.
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
        reach: longest way as a share of the axis's room.
        to: where it has to end, as a share of the room from where the motion began; None: wherever.
    """

    axis: int
    level: float
    seconds: float
    edge: float
    reach: float
    to: float | None = None


@dataclass(frozen=True)
class Turn:
    """Strokes that begin together, and the pause after the longest of them [s]. Turns are repeated whole."""

    strokes: tuple[Stroke, ...]
    pause: float = 0.0


#: Axes that move, a generator → groups of turns, without end; a group comes back to the beginning.
Groups = Callable[[Sequence[int], np.random.Generator], Iterator[tuple[Turn, ...]]]


@dataclass(frozen=True)
class Motion:
    """One kind of motion; ``several``: needs all axes that are offered, else it is tried on each one alone."""

    name: str
    about: str
    groups: Groups
    several: bool = False


def _there_and_back(strokes: Callable[[int, np.random.Generator], tuple[float, float, float, float, float]]) -> Groups:
    """Pairs of strokes; ``strokes(k, rng)`` gives (level, seconds, edge, reach, pause) of the k-th pair."""

    def groups(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[Turn, ...]]:
        k = 0
        while True:
            for axis in axes:
                level, seconds, edge, reach, pause = strokes(k, rng)
                out = Stroke(axis, level, seconds, edge, reach)
                back = Stroke(axis, -level, seconds, edge, reach, 0.0)
                yield Turn((out,), pause), Turn((back,), pause)
            k += 1

    return groups


def _one_of(values: Sequence[float], k: int) -> float:
    return values[k % len(values)] * (1.0 if (k // len(values)) % 2 == 0 else -1.0)


def _sweep(k: int, rng: np.random.Generator) -> tuple[float, float, float, float, float]:
    """Half waves from 0.3 to 4 Hz, faster and faster, over twelve pairs."""
    half = 0.5 / (0.3 * (4.0 / 0.3) ** ((k % 12) / 11.0))
    return 0.6, half, 0.5 * half, 0.2, 0.0


def _tap(k: int, rng: np.random.Generator) -> tuple[float, float, float, float, float]:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(0.35, 0.9)), float(rng.uniform(0.1, 0.5)), SHARP, 0.2, 0.15


def _together(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[Turn, ...]]:
    """Each axis alone, then all at once, at full speed."""
    while True:
        for moving in (*((axis,) for axis in axes), tuple(axes)):
            levels = rng.choice([-1.0, 1.0], len(moving)) * rng.uniform(0.7, 1.0, len(moving))
            pairs = list(zip(moving, map(float, levels), strict=True))
            out = tuple(Stroke(axis, level, 2.0, 0.1, 0.3) for axis, level in pairs)
            back = tuple(Stroke(axis, -level, 2.0, 0.1, 0.3, 0.0) for axis, level in pairs)
            yield Turn(out, 0.4), Turn(back, 0.4)


def _poses(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[Turn, ...]]:
    """Random poses over nine tenths of the room, all axes on their way at once, a still second at each."""
    place = dict.fromkeys(axes, 0.0)
    while True:
        strokes = []
        for axis in axes:
            to = float(rng.uniform(-0.45, 0.45))
            way = to - place[axis]
            strokes.append(Stroke(axis, 0.7 if way > 0.0 else -0.7, 60.0, 0.2, abs(way), to))
            place[axis] = to
        yield (Turn(tuple(strokes), 1.2),)


#: What is tried, in words that say what an operator would do.
MOTIONS: tuple[Motion, ...] = (
    Motion(
        "reversals",
        "slow reversals of {axes}",
        _there_and_back(lambda k, rng: (_one_of((0.25, 0.4, 0.6), k), 1.2, 0.3, 0.12, 0.0)),
    ),
    Motion(
        "stairs",
        "pulses of {axes} that rise from next to nothing to 42 %, both ways",
        _there_and_back(lambda k, rng: (_one_of(tuple(0.03 * n for n in range(1, 15)), k), 0.6, SHARP, 0.12, 0.2)),
    ),
    Motion(
        "steps",
        "sharp starts and stops of {axes} at 30, 60 and 100 %, both ways",
        _there_and_back(lambda k, rng: (_one_of((0.3, 0.6, 1.0), k), 1.0, SHARP, 0.25, 0.5)),
    ),
    Motion("taps", "short sharp taps of {axes} at random", _there_and_back(_tap)),
    Motion(
        "ramps",
        "slow ramps of {axes} through zero, up to 30, 60 and 100 %",
        _there_and_back(lambda k, rng: (_one_of((0.3, 0.6, 1.0), k), 3.0, 1.5, 0.3, 0.0)),
    ),
    Motion(
        "creeping",
        "{axes} creeping at 1 to 15 %, both ways",
        _there_and_back(lambda k, rng: (_one_of((0.02, 0.08, 0.01, 0.15, 0.04), k), 4.0, 0.4, 0.15, 0.2)),
    ),
    Motion("sweep", "{axes} to and fro, faster and faster, 0.3 to 4 Hz", _there_and_back(_sweep)),
    Motion(
        "strokes",
        "{axes} over most of the range at 50, 80 and 100 %",
        _there_and_back(lambda k, rng: (_one_of((0.5, 0.8, 1.0), k), 60.0, 0.1, 0.8, 0.4)),
    ),
    Motion(
        "rest",
        "{axes} driven out and left alone for 12 s, again and again",
        _there_and_back(lambda k, rng: (_one_of((0.6,), k), 60.0, 0.2, 0.4, 12.0)),
    ),
    Motion(
        "swing",
        "{axes} moved briskly, stopped, and left alone for 5 s",
        _there_and_back(lambda k, rng: (_one_of((1.0, 0.7), k), 0.8, SHARP, 0.25, 5.0)),
    ),
    Motion("together", "{axes} at large commands, each alone and all at once", _together, several=True),
    Motion("poses", "random poses of {axes}, a still second at each", _poses, several=True),
)
