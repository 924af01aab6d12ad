"""What a command → motion network looks at: commands and speeds over a stated history, on a grid of whole steps.

A command is its mean over a step, so that nothing between two looks is lost; the first one is that of the step to come. Speeds
are means between the edges of the history. All a free run needs is what it made itself: positions on the grid, and commands.
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
        commands: whole steps before the one to come at which commands are looked at, rising from 0 on.
        edges: whole steps before now between which mean speeds are taken, rising from 0 on; (0,) for none.
        position: whether it sees where it is.
        follows: whether commands are positions to go to: they are then seen from where it is.
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
        """Samples a step.

        Raises:
            SettingsError: a step is no whole number of samples.
        """
        stride = round(self.step * rate_hz)
        if stride < 1 or abs(stride - self.step * rate_hz) > 1e-3 * stride:
            found = f"a step of {self.step:g} s at {rate_hz:g} Hz"
            raise SettingsError("command to motion", found, f"whole samples, as in {max(1, stride) / rate_hz:g} s")
        return stride

    def names(self, command: str, driven: str) -> tuple[str, ...]:
        """Of the columns, for messages and files."""
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
        SettingsError: times that do not rise, or begin too early.
    """
    step = max(1, round(step * rate_hz)) / rate_hz
    for key, times, fine in (
        ("history", history, bool(history) and history[0] >= 0.0),
        ("speeds", speeds, not speeds or speeds[0] > 0.0),
    ):
        if not fine or any(b <= a for a, b in itertools.pairwise(times)):
            expected = "times that rise, " + ("from 0 on" if key == "history" else "above 0")
            raise SettingsError(f"recipe: motion.{key}", str(list(times)), expected)
    commands = tuple(dict.fromkeys(round(time / step) for time in history))
    return Window(step, commands, tuple(dict.fromkeys([0, *(round(time / step) for time in speeds)])), position, follows)


@dataclass(frozen=True)
class MotionStretch:
    """One stretch of a recording on its own samples; NaN where nothing was measured.

    Args:
        command: mean over the step that begins at each sample, (n,).
        position: (n,).
        stride: samples a step.
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
        """Samples with what it takes to learn from them, or to run freely for ``ahead`` steps and evaluate the end."""
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
        """Inputs (n, d) and mean speeds over the step to come (n, 1) at samples ``at``."""
        commands = self.command[at[:, None] - np.array(window.commands) * self.stride]
        positions = self.position[at[:, None] - np.array(window.edges) * self.stride]
        speed = (self.position[at + self.stride] - self.position[at]) / window.step
        return window.features(commands, positions), speed[:, None]
