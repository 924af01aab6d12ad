"""Inputs of a command → motion network: commands and speeds over a configured history, on a grid of whole steps.

A command is its mean over a step; the first one is that of the predicted step. Speeds are means between the edges of the
history. A free run needs only commands and its own positions on the grid.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


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
