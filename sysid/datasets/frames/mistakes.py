"""Frames in which a motion capture system confused bodies or markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import stretches

Array = npt.NDArray[np.float64]

#: Largest speed [m/s] and acceleration [m/s²] of a point of the machine; a body beyond them was confused with another.
MAX_SPEED, MAX_ACCELERATION = 3.0, 20.0
#: Tolerance for noise [m]; a smaller mistake is not detected as a jump.
JUMP = 0.02
#: Largest distance of a body from its position before a mistake [m], beyond its motion at its 95th percentile of speed.
NEAR = 0.1
#: Largest mean marker error of a body: in metres, and as a multiple of its median.
MAX_MARKER_ERROR, MARKER_ERROR_RATIO = 0.002, 8.0


@dataclass(frozen=True)
class MissingFrames:
    """Frames of a body that have been set to missing; seconds on the capture clock from its first frame."""

    body: str
    reason: str
    start_s: float
    end_s: float
    frames: int


def without_mistakes(
    body: str, poses: Array, seconds: Array, error: Array | None = None
) -> tuple[Array, tuple[MissingFrames, ...]]:
    """The poses without frames in which the body was mistaken (swapped markers or bodies), and the dropped frames.

    A frame is dropped if the markers do not fit the body's shape, or the body jumps faster than a machine moves. After jumps,
    the longest sequence of feasible moves is kept.

    Args:
        body: its name.
        poses: (n, 4, 4), NaN where not visible.
        seconds: increasing, (n,).
        error: mean marker error (n,) [m], where the system gives it.
    """
    bad = np.zeros(len(poses), dtype=bool)
    flags: list[MissingFrames] = []
    if error is not None and np.isfinite(error).any():
        limit = max(MAX_MARKER_ERROR, MARKER_ERROR_RATIO * float(np.nanmedian(error)))
        misfit = np.nan_to_num(error) > limit
        flags += _dropped(body, "markers do not fit the body", misfit, seconds)
        bad |= misfit
    seen = np.flatnonzero(~np.isnan(poses[:, 0, 3]) & ~bad)
    jumped = np.zeros(len(poses), dtype=bool)
    jumped[seen[~_plausible(poses[seen, :3, 3], seconds[seen])]] = True
    flags += _dropped(body, "jumped further than a machine can move", jumped, seconds)
    result = poses.copy()
    result[bad | jumped] = np.nan
    return result, tuple(flags)


def _plausible(positions: Array, seconds: Array) -> npt.NDArray[np.bool_]:
    """Mask of the frames on the longest chain of runs with feasible jumps between them, (n,)."""
    if len(positions) < 2:
        return np.ones(len(positions), dtype=bool)
    breaks = np.flatnonzero(_jumps(positions, seconds)) + 1
    runs = np.split(np.arange(len(positions)), breaks)
    usual = float(np.quantile(np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(seconds), 0.95))
    weight = np.array([float(len(run)) for run in runs])
    best = weight.copy()
    before = np.full(len(runs), -1)
    for i in range(1, len(runs)):
        for j in range(max(0, i - 50), i - 1):  # neighbouring runs are separated by a jump
            gap = np.linalg.norm(positions[runs[i][0]] - positions[runs[j][-1]])
            time = seconds[runs[i][0]] - seconds[runs[j][-1]]
            # A long time between two runs alone does not make a far jump feasible.
            if gap <= min(MAX_SPEED * time + JUMP, usual * time + NEAR) and best[j] + weight[i] > best[i]:
                best[i], before[i] = best[j] + weight[i], j
    keep = np.zeros(len(positions), dtype=bool)
    run = int(np.argmax(best))
    while run >= 0:
        keep[runs[run]] = True
        run = int(before[run])
    return keep


def _jumps(positions: Array, seconds: Array) -> npt.NDArray[np.bool_]:
    """Mask of the steps between neighbours that a machine cannot make, (n − 1,).

    Too far for their time; or, between frames without a gap, different from the step before and the step after by more than
    the largest acceleration, which detects mistakes along and against the motion alike.
    """
    steps, times = np.diff(positions, axis=0), np.diff(seconds)
    too_fast = np.linalg.norm(steps, axis=1) > MAX_SPEED * times + JUMP
    regular = times < 1.5 * float(np.median(times))
    change = np.full(len(steps) + 1, np.inf)
    change[1:-1] = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    change[1:-1][~(regular[1:] & regular[:-1])] = np.inf
    alone = np.minimum(change[:-1], change[1:])
    sudden = regular & np.isfinite(alone) & (alone > MAX_ACCELERATION * times**2 + JUMP)
    return np.asarray(too_fast | sudden)


def _dropped(body: str, reason: str, bad: npt.NDArray[np.bool_], seconds: Array) -> list[MissingFrames]:
    return [
        MissingFrames(body, reason, float(seconds[first]), float(seconds[last - 1]), int(last - first))
        for first, last in zip(*stretches(bad), strict=True)
    ]
