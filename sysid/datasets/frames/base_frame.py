"""Where the capture frame stands in the machine's base frame: what is proposed, for a person to look at.

Nothing here is ever applied by itself, and no survey goes through the kinematics beyond the place of one axis: a base that is
fitted through the kinematics would hide errors of the machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recipe import FramePose

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FrameProposal:
    """A pose of the capture frame, and how far it can be trusted.

    Args:
        frame: what the recipe would say.
        method: ``markers`` or ``turn``.
        names: the markers it rests on.
        rms_m, max_m: what is left between survey and capture [m].
        translation95, rotation95: half widths of 95 % intervals [m], and about the base axes [rad]; infinite along what
            stays open. After a turn the place is that of the axis, at the height of the points.
        open: what the survey does not determine, in words.
        notes: what looks wrong.
    """

    frame: FramePose
    method: str
    names: tuple[str, ...]
    rms_m: float
    max_m: float
    translation95: tuple[float, float, float]
    rotation95: tuple[float, float, float]
    open: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def lines(self) -> str:
        """The table for the recipe."""
        numbers = [", ".join(f"{value:.6f}" for value in values) for values in (self.frame.translation, self.frame.rpy)]
        return f"[streams.frame]\ntranslation = [{numbers[0]}]\nrpy = [{numbers[1]}]"


def frame_of(pose: Array) -> FramePose:
    """The pose (4, 4) as a recipe has it: roll, pitch and yaw about fixed axes; where pitch is ±90° the roll is zero."""
    r = pose[:3, :3]
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if math.hypot(r[0, 0], r[1, 0]) < 1e-9:
        roll, yaw = 0.0, math.atan2(-r[0, 1], r[1, 1])
    else:
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    return FramePose(three(pose[:3, 3]), (roll, pitch, yaw))


def main_extents(points: Array) -> Array:
    """Extents of points (n, 3) along their three main directions, times √n [m]."""
    return np.append(np.linalg.svd(points - points.mean(axis=0), compute_uv=False), [0.0, 0.0])[:3]


def rms_of(off: Array) -> float:
    """Root mean square distance [m] of residuals (n, k)."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def three(values: Array) -> tuple[float, float, float]:
    """Three numbers as a tuple."""
    return (float(values[0]), float(values[1]), float(values[2]))
