"""Torques of the two links of the probe arm (:func:`sysid.testing.probe.probe_arm`) in closed form."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

GRAVITY = 9.80665
#: Of the probe arm: length of the upper arm [m]; mass [kg], centre in the plane [m] and inertia about it [kg·m²] of both links.
LENGTH, M1, C1, I1, M2, C2, I2 = 0.4, 4.0, np.array([0.2, 0.0]), 0.06, 2.0, np.array([0.15, 0.0]), 0.02


def planar(q: Array, v: Array, a: Array, m1: float, m2: float, c2: Array, i2: float) -> Array:
    """Torques (n, 2) of two links, angles upwards from the horizontal; Lagrange's equations by hand.

    ``c2``: centre of the second link along it and across it, upwards.
    """
    r, off = float(np.hypot(*c2)), float(np.arctan2(c2[1], c2[0]))
    angle = q[:, 1] + off
    k = m2 * LENGTH * r
    cos, sin = np.cos(angle), np.sin(angle)
    r1 = C1[0]
    m22 = i2 + m2 * r**2
    m12 = m22 + k * cos
    m11 = I1 * m1 / M1 + m1 * r1**2 + m2 * LENGTH**2 + m22 + 2.0 * k * cos
    down2 = m2 * r * GRAVITY * np.cos(q[:, 0] + angle)
    down1 = (m1 * r1 + m2 * LENGTH) * GRAVITY * np.cos(q[:, 0]) + down2
    one = m11 * a[:, 0] + m12 * a[:, 1] - k * sin * (2.0 * v[:, 0] * v[:, 1] + v[:, 1] ** 2) + down1
    return np.column_stack([one, m12 * a[:, 0] + m22 * a[:, 1] + k * sin * v[:, 0] ** 2 + down2])
