"""Inputs and free runs of command → motion models: commands and speeds over a configured history, on a grid of whole steps.

A command is its mean over a step; the first one is that of the predicted step. Speeds are means between the edges of the
history. In a free run, of which many run in parallel, each step starts from the model's own previous prediction.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Speed = Callable[[Array], Array]


@dataclass(frozen=True)
class Window:
    """The inputs of one network.

    Args:
        step: seconds from one prediction to the next.
        commands: lags of the commands, whole steps before the predicted one, increasing from 0.
        edges: whole steps before now between which mean speeds are taken, increasing from 0; (0,) for none.
        position: whether the position is an input.
        follows: whether commands are position setpoints; they are then relative to the current position.
    """

    step: float
    commands: tuple[int, ...]
    edges: tuple[int, ...]
    position: bool = True
    follows: bool = False

    @property
    def depth(self) -> int:
        """Steps of history before now."""
        return max(self.commands[-1], self.edges[-1])

    def stride(self, rate_hz: float) -> int:
        """Samples per step.

        Raises:
            SettingsError: a step is not a whole number of samples.
        """
        stride = round(self.step * rate_hz)
        if stride < 1 or abs(stride - self.step * rate_hz) > 1e-3 * stride:
            found = f"a step of {self.step:g} s at {rate_hz:g} Hz"
            raise SettingsError("command to motion", found, f"whole samples, as in {max(1, stride) / rate_hz:g} s")
        return stride

    def names(self, command: str, driven: str) -> tuple[str, ...]:
        """Names of the columns, for messages and files."""
        seen = f"{command} from {driven}" if self.follows else command
        columns = [f"{seen} {lag * self.step:g} s before" for lag in self.commands]
        columns += [f"speed of {driven} up to {self.edges[k] * self.step:g} s before" for k in range(len(self.edges) - 1)]
        return (*columns, driven) if self.position else tuple(columns)

    def features(self, commands: Array, positions: Array) -> Array:
        """Inputs (n, d) from ``commands`` (n, len(commands)) and ``positions`` at the edges (n, len(edges))."""
        seen = commands - positions[:, :1] if self.follows else commands
        parts = [seen]
        if len(self.edges) > 1:
            parts.append((positions[:, :-1] - positions[:, 1:]) / (self.step * np.diff(self.edges)))
        if self.position:
            parts.append(positions[:, :1])
        return np.hstack(parts)


def window_of(
    step: float, history: Sequence[float], speeds: Sequence[float], rate_hz: float, position: bool = True, follows: bool = False
) -> Window:
    """A window from times in seconds: the step is rounded to whole samples, times to whole steps; equal ones count once.

    Raises:
        SettingsError: times that do not increase, or start too early.
    """
    step = max(1, round(step * rate_hz)) / rate_hz
    for key, times, fine in (
        ("history", history, bool(history) and history[0] >= 0.0),
        ("speeds", speeds, not speeds or speeds[0] > 0.0),
    ):
        if not fine or any(b <= a for a, b in itertools.pairwise(times)):
            expected = "increasing times, " + ("from 0 on" if key == "history" else "above 0")
            raise SettingsError(f"recipe: motion.{key}", str(list(times)), expected)
    commands = tuple(dict.fromkeys(round(time / step) for time in history))
    return Window(step, commands, tuple(dict.fromkeys([0, *(round(time / step) for time in speeds)])), position, follows)


@dataclass(frozen=True)
class MotionStretch:
    """Signals of one recording at its own samples; NaN where nothing was measured.

    Args:
        command: mean over the step that begins at each sample, (n,).
        position: (n,).
        stride: samples per step.
    """

    command: Array
    position: Array
    stride: int

    @staticmethod
    def of(command: Array, position: Array, stride: int) -> MotionStretch:
        means = np.full(len(command), np.nan)
        if len(command) >= stride:
            means[: len(command) - stride + 1] = np.lib.stride_tricks.sliding_window_view(command, stride).mean(axis=1)
        return MotionStretch(means, np.array(position, dtype=np.float64), stride)

    def starts(self, window: Window, ahead: int = 0) -> Index:
        """Samples with complete inputs and target, or with all that a free run of ``ahead`` steps and its evaluation need."""
        n, past, last = len(self.command), window.depth * self.stride, max(1, ahead)
        at = np.arange(past, max(past, n - last * self.stride))
        edges = range(window.edges[-1] + 1) if ahead else window.edges
        lags = range(-ahead + 1, window.commands[-1] + 1) if ahead else window.commands
        good = np.isfinite(self.position[at + last * self.stride])
        for edge in edges:
            good &= np.isfinite(self.position[at - edge * self.stride])
        for lag in lags:
            good &= np.isfinite(self.command[at - lag * self.stride])
        return at[good]

    def rows(self, window: Window, at: Index) -> tuple[Array, Array]:
        """Inputs (n, d) and mean speeds over the next step (n, 1) at samples ``at``."""
        commands = self.command[at[:, None] - np.array(window.commands) * self.stride]
        positions = self.position[at[:, None] - np.array(window.edges) * self.stride]
        speed = (self.position[at + self.stride] - self.position[at]) / window.step
        return window.features(commands, positions), speed[:, None]


@dataclass(frozen=True)
class MotionBounds:
    """Bounds of a free run: ``speeds`` and ``positions``, (lowest, highest) each [SI]."""

    speeds: tuple[float, float]
    positions: tuple[float, float]


def roll(speed: Speed, window: Window, bounds: MotionBounds, commands: Array, positions: Array) -> Array:
    """Free runs of one length from measured histories.

    Args:
        speed: inputs (b, d) → mean speed over the next step (b,).
        commands: mean over each step, (b, depth + steps), the history first.
        positions: at the start of the steps of the history, (b, depth + 1); the runs start at the last one.

    Returns:
        Positions at the start and after every step, (b, steps + 1).
    """
    depth = window.depth
    steps = commands.shape[1] - depth
    run = np.empty((len(commands), depth + steps + 1))
    run[:, : depth + 1] = positions
    seen, edges = -np.array(window.commands), -np.array(window.edges)
    for k in range(depth, depth + steps):
        predicted = np.clip(speed(window.features(commands[:, k + seen], run[:, k + edges])), *bounds.speeds)
        run[:, k + 1] = np.clip(run[:, k] + window.step * predicted, *bounds.positions)
    return run[:, depth:]


def horizon_errors(
    speed: Speed, window: Window, bounds: MotionBounds, motions: Sequence[MotionStretch], seconds: float, interval: float
) -> list[tuple[Index, Array, Array]]:
    """End points of free runs of ``seconds``, whose starts are ``interval`` seconds apart, all runs at once.

    Returns:
        For each motion: samples at which the runs end, predicted and measured positions there, (b,) each.
    """
    ahead = max(1, round(seconds / window.step))
    begins, commands, positions = [], [], []
    for motion in motions:
        found = motion.starts(window, ahead)
        at = _spaced(found, max(1, round(interval / window.step)) * motion.stride)
        begins.append(at)
        grid = at[:, None] + np.arange(-window.depth, ahead) * motion.stride
        commands.append(motion.command[grid])
        positions.append(motion.position[grid[:, : window.depth + 1]])
    joined = roll(speed, window, bounds, np.concatenate(commands), np.concatenate(positions))[:, -1]
    parts = np.split(joined, np.cumsum([len(at) for at in begins])[:-1])
    ends = [at + ahead * motion.stride for at, motion in zip(begins, motions, strict=True)]
    return [(end, predicted, motion.position[end]) for end, predicted, motion in zip(ends, parts, motions, strict=True)]


def whole_run(speed: Speed, window: Window, bounds: MotionBounds, motion: MotionStretch) -> Array:
    """A free run of a whole recording at its own samples, (n,).

    It starts where history and commands are first complete and restarts only after a gap of the commands; NaN before and in
    between.
    """
    n, stride, depth = len(motion.command), motion.stride, window.depth
    out = np.full(n, np.nan)
    at = 0
    begins = motion.starts(window, 1)
    while len(begins := begins[begins >= at]):
        start = int(begins[0])
        grid = np.arange(start, n, stride)
        there = np.isfinite(motion.command[grid])
        steps = len(grid) if there.all() else int(np.argmin(there))
        whole = start + np.arange(-depth, steps) * stride
        run = roll(speed, window, bounds, motion.command[whole][None], motion.position[whole[: depth + 1]][None])[0]
        last = min(start + steps * stride, n - 1)
        samples = np.arange(start, last + 1)
        out[samples] = np.interp(samples, start + np.arange(steps + 1) * stride, run)
        at = last + 1
    return out


def _spaced(at: Index, interval: int) -> Index:
    """Of increasing samples those at least ``interval`` after the previous one taken."""
    kept, last = [], -interval
    for sample in at.tolist():
        if sample - last >= interval:
            kept.append(sample)
            last = sample
    return np.array(kept, dtype=np.int64)
