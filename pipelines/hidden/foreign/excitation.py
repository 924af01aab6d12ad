"""Excitation of the machines: an operator's joystick, steps, and sums of sines.

An operator chooses the direction of a stroke by the position of the axis and stops before the end; the rest is random.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Program = Literal["operator", "steps", "fourier"]

#: A joystick's converter: commands are multiples of this.
COMMAND_STEP = 0.001
#: Share of its range that an axis keeps clear at either end, and time for which it still moves when the lever is let go [s].
CLEAR, STOPPING = 0.08, 0.25
#: Base frequencies of the sums of sines [Hz], and number of harmonics.
BASE, HARMONICS = (0.08, 0.13), 5


@dataclass(frozen=True)
class Take:
    """One recording [s]. ``lead`` is how long the machine moves before it begins: 0 = it has stood still.

    Args:
        swing: the hanging tool starts this far from the vertical, about x and y [rad].
    """

    name: str
    seed: int
    seconds: float
    program: Program
    lead: float = 0.0
    swing: tuple[float, float] = (0.0, 0.0)


@dataclass
class Lever:
    """The command of one velocity axis, called once a controller's cycle.

    Args:
        strokes: (m, 4) start, duration, level, edge [s, s, 1, s].
        limits, gain: of the axis.
    """

    strokes: Array
    limits: tuple[float, float]
    gain: float
    place: int = 0
    direction: float = 0.0

    def command(self, time: float, position: float) -> float:
        while self.place < len(self.strokes) and time >= self.strokes[self.place, 0] + self.strokes[self.place, 1]:
            self.place += 1
            self.direction = 0.0
        if self.place == len(self.strokes) or time < self.strokes[self.place, 0]:
            return 0.0
        start, duration, level, edge = self.strokes[self.place]
        low, high = self.limits
        clear = CLEAR * (high - low)
        size = abs(level)
        if self.direction == 0.0:
            wish = math.copysign(1.0, level)
            travel = size * self.gain * duration
            ahead, behind = (high - position, position - low) if wish > 0.0 else (position - low, high - position)
            self.direction = -wish if ahead - clear < travel and behind > ahead else wish
        stopping = clear + STOPPING * size * self.gain
        if (position > high - stopping) if self.direction > 0.0 else (position < low + stopping):
            return 0.0
        into = time - start
        ramp = min(into / edge, (duration - into) / edge, 1.0) if edge > 0.0 else 1.0
        shape = 0.5 - 0.5 * math.cos(math.pi * max(ramp, 0.0))
        return float(round(self.direction * size * shape / COMMAND_STEP) * COMMAND_STEP)


@dataclass
class Sines:
    """The command of one velocity axis as a sum of sines, let go near an end of its range."""

    times: tuple[Array, Array, Array]
    limits: tuple[float, float]

    def command(self, time: float, position: float) -> float:
        size, frequency, phase = self.times
        value = float(np.sum(size * np.cos(2.0 * math.pi * frequency * time + phase)))
        low, high = self.limits
        clear = CLEAR * (high - low)
        if (value > 0.0 and position > high - clear) or (value < 0.0 and position < low + clear):
            return 0.0
        return round(value / COMMAND_STEP) * COMMAND_STEP


def levers(program: Program, seed: int, seconds: float, axes: dict[str, dict[str, object]]) -> list[Lever | Sines]:
    """Commands of all velocity axes for ``seconds``."""
    draw = np.random.default_rng([seed, 3])
    found: list[Lever | Sines] = []
    turns = draw.permutation(len(axes))
    for k, axis in enumerate(axes.values()):
        low, high = axis["limits"]  # type: ignore[misc]
        limits, gain = (float(low), float(high)), float(axis["gain"])  # type: ignore[arg-type, has-type]
        if program == "fourier":
            found.append(Sines(_sines(draw, 0.9), limits))
            continue
        offset, every = (0, 1) if program == "operator" else (int(turns[k]), len(axes))
        found.append(Lever(_strokes(program, draw, seconds, offset, every), limits, gain))
    return found


def _sines(draw: np.random.Generator, most: float) -> tuple[Array, Array, Array]:
    frequency = draw.uniform(*BASE) * (1.0 + np.arange(HARMONICS)) * draw.uniform(0.97, 1.03, HARMONICS)
    size = draw.uniform(0.3, 1.0, HARMONICS)
    return most * size / size.sum(), frequency, draw.uniform(0.0, 2.0 * math.pi, HARMONICS)


def _strokes(program: Program, draw: np.random.Generator, seconds: float, offset: int, every: int) -> Array:
    """An operator moves several axes at once; in steps one axis after the other moves alone, with sharp edges."""
    rows = []
    time = draw.uniform(0.3, 1.5)
    turn = 0
    while time < seconds:
        if program == "steps":
            duration, pause = draw.uniform(0.5, 1.2), draw.uniform(0.1, 0.4)
            if turn % every == offset:
                rows.append((time, duration, draw.choice([-1.0, 1.0]) * draw.choice([0.15, 0.3, 0.5, 0.75, 1.0]), 0.0))
            time += duration + pause
            turn += 1
            continue
        slow = draw.random() < 0.35
        duration = draw.uniform(0.8, 2.4)
        level = draw.uniform(0.08, 0.35) if slow else draw.uniform(0.35, 1.0)
        edge = min(draw.uniform(0.05, 0.5), 0.45 * duration)
        rows.append((time, duration, draw.choice([-1.0, 1.0]) * level, edge))
        time += duration + (0.0 if draw.random() < 0.3 else draw.exponential(0.5))
    return np.array(rows).reshape(-1, 4)


def path(program: Program, seed: int, time: Array, limits: tuple[float, float]) -> Array:
    """Set position of an axis, (n,): strokes of constant speed between places where it waits, or a sum of sines."""
    draw = np.random.default_rng([seed, 5])
    low, high = limits
    middle, half = 0.5 * (low + high), (0.5 - CLEAR) * (high - low)
    if program == "fourier":
        size, frequency, phase = _sines(draw, half)
        frequency = frequency * 1.5
        return np.asarray(middle + np.sum(size * np.sin(2.0 * math.pi * np.outer(time, frequency) + phase), axis=1))
    knots, places = [time[0]], [middle + half * draw.uniform(-0.8, 0.8)]
    fastest = 1.2 * half if program == "operator" else 2.5 * half
    while knots[-1] < time[-1]:
        wanted = middle + half * draw.uniform(-1.0, 1.0)
        if draw.random() < 0.4:
            wanted = float(np.clip(places[-1] + 0.1 * half * draw.uniform(-1.0, 1.0), middle - half, middle + half))
        speed = fastest * draw.uniform(0.1, 1.0)
        knots += [knots[-1] + max(abs(wanted - places[-1]) / speed, 0.02)]
        knots += [knots[-1] + draw.uniform(0.1, 0.9)]
        places += [wanted, wanted]
    return np.asarray(np.interp(time, knots, places))
