"""Free runs of command → motion models, many in parallel: each step starts from the model's own previous prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.networks.motion_inputs import Index, MotionStretch, Window

Array = npt.NDArray[np.float64]
Speed = Callable[[Array], Array]


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
