"""Forward kinematics of a chain with a constant geometry: constant transforms are multiplied in advance.

From the tip to the base, with the constant rotation R and translation t before joint j, its axis k and reading θ::

    p ← t + R·(k kᵀ + cos θ·(I − k kᵀ) + sin θ·[k]×)·p        revolute
    p ← t + R·(p + θ·k)                                        prismatic
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FoldedJoint:
    """One joint with the constant transform before it.

    Args:
        column: of the joint values.
        stretch, offset: factor of its reading, and what is added [rad or m].
        prismatic: whether it is a prismatic joint.
        shift: t, (3, 1).
        factors: factors of the point; revolute (9, 3): constant, cos and sin part; prismatic (3, 3): R.
        slide: R·k, (3, 1).
    """

    column: int
    stretch: float
    offset: float
    prismatic: bool
    shift: Array
    factors: Array
    slide: Array

    @staticmethod
    def of(
        column: int, stretch: float, offset: float, prismatic: bool, axis: Array, rotation: Array, shift: Array
    ) -> FoldedJoint:
        along = np.outer(axis, axis)
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        parts = [rotation] if prismatic else [rotation @ along, rotation @ (np.eye(3) - along), rotation @ cross]
        return FoldedJoint(column, stretch, offset, prismatic, shift[:, None], np.vstack(parts), (rotation @ axis)[:, None])


@dataclass(frozen=True)
class FoldedChain:
    """The joints from base to tip, and the tip in the frame of the last joint, (3, 1)."""

    joints: tuple[FoldedJoint, ...]
    last: Array

    @cached_property
    def _readings(self) -> tuple[npt.NDArray[np.int64], Array, Array | None]:
        """Columns of the joint values in the order of the chain, the factors of their readings, and offsets where there are
        any."""
        columns = np.array([joint.column for joint in self.joints], dtype=np.int64)
        offsets = np.array([[joint.offset] for joint in self.joints])
        return columns, np.array([[joint.stretch] for joint in self.joints]), offsets if offsets.any() else None

    def tip(self, q: Array) -> Array:
        """Joint values (n, n_axes) → tip in the base frame, (n, 3) [m]."""
        columns, stretches, offsets = self._readings
        readings = q.take(columns, axis=1).T * stretches
        if offsets is not None:
            readings += offsets
        cosines, sines = np.cos(readings), np.sin(readings)
        point = self.last
        for k in range(len(self.joints) - 1, -1, -1):
            joint = self.joints[k]
            moved = joint.factors.dot(point)
            if joint.prismatic:
                point = joint.slide * readings[k]
                point += moved
            else:
                point = moved[3:6] * cosines[k]
                point += moved[6:] * sines[k]
                point += moved[:3]
            point += joint.shift
        return np.ascontiguousarray(point.T)
