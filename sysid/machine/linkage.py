"""Cylinder displacement ↔ joint angle: triangle geometry, or a table (of a fitted network)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.machine.description import Linkage

Array = npt.NDArray[np.float64]
#: Points of a tabulated map.
TABLE_POINTS = 1024


class CylinderJointMap(Protocol):
    """Monotonic map between a cylinder and its joint, in both directions."""

    def joint(self, displacement: Array) -> Array: ...

    def displacement(self, joint: Array) -> Array: ...


@dataclass(frozen=True)
class TriangleLinkage:
    """Law of cosines in the triangle of the two levers and the cylinder."""

    geometry: Linkage

    def joint(self, displacement: Array) -> Array:
        """Displacement [m] → joint angle [rad]; displacements beyond the geometry saturate."""
        g = self.geometry
        length = np.asarray(displacement, dtype=np.float64) + g.retracted
        cosine = (g.a**2 + g.b**2 - length**2) / (2.0 * g.a * g.b)
        return np.asarray(g.sense * np.arccos(np.clip(cosine, -1.0, 1.0)) - g.offset)

    def displacement(self, joint: Array) -> Array:
        """Joint angle [rad] → displacement [m]."""
        g = self.geometry
        cosine = np.cos(g.sense * (np.asarray(joint, dtype=np.float64) + g.offset))
        return np.asarray(np.sqrt(g.a**2 + g.b**2 - 2.0 * g.a * g.b * cosine) - g.retracted)


@dataclass(frozen=True)
class TabulatedLinkage:
    """Linear interpolation in a monotonic table; ends are extended along their slope.

    Args:
        displacements: strictly increasing, (m,) [m].
        joints: strictly monotonic, (m,) [rad or m].
    """

    displacements: Array
    joints: Array

    def joint(self, displacement: Array) -> Array:
        return _interpolate(displacement, self.displacements, self.joints)

    def displacement(self, joint: Array) -> Array:
        if self.joints[-1] > self.joints[0]:
            return _interpolate(joint, self.joints, self.displacements)
        return _interpolate(joint, self.joints[::-1], self.displacements[::-1])


def _interpolate(x: Array, xs: Array, ys: Array) -> Array:
    x = np.asarray(x, dtype=np.float64)
    below = ys[0] + (x - xs[0]) * (ys[1] - ys[0]) / (xs[1] - xs[0])
    above = ys[-1] + (x - xs[-1]) * (ys[-1] - ys[-2]) / (xs[-1] - xs[-2])
    return np.where(x < xs[0], below, np.where(x > xs[-1], above, np.interp(x, xs, ys)))


def tabulate(mapping: CylinderJointMap, stroke: tuple[float, float]) -> TabulatedLinkage:
    """Sample ``mapping`` evenly over the stroke, and make it monotonic."""
    displacements = np.linspace(*stroke, TABLE_POINTS)
    joints = mapping.joint(displacements)
    sign = 1.0 if joints[-1] > joints[0] else -1.0
    monotonic = np.maximum.accumulate(sign * joints)
    # Constant sections have no inverse: add the smallest slope that survives rounding.
    monotonic += np.arange(TABLE_POINTS) * max(np.ptp(monotonic), 1e-12) * 1e-9
    return TabulatedLinkage(displacements, sign * monotonic)
