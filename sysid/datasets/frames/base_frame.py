"""A proposal for the pose of the capture frame in the machine's base frame.

A proposal is never applied automatically, and uses the kinematics only for the position of one axis: a base that is fitted
through the kinematics would hide errors of the machine.
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
    """A pose of the capture frame with its uncertainty.

    Args:
        frame: for the recipe.
        method: ``markers`` or ``turn``.
        names: of the markers used.
        rms_m, max_m: residuals between survey and capture [m].
        translation95, rotation95: half widths of 95 % intervals [m], and about the base axes [rad]; infinite where not
            determined. After a turn the position is that of the axis, at the height of the points.
        open: what the survey does not determine, as sentences.
        notes: possible mistakes.
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
        """The TOML table for the recipe."""
        numbers = [", ".join(f"{value:.6f}" for value in values) for values in (self.frame.translation, self.frame.rpy)]
        return f"[streams.frame]\ntranslation = [{numbers[0]}]\nrpy = [{numbers[1]}]"


def frame_of(pose: Array) -> FramePose:
    """The pose (4, 4) with roll, pitch and yaw about fixed axes; at a pitch of ±90° the roll is zero."""
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
