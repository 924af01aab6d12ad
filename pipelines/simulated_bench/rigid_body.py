"""Rigid-body dynamics of the crane in its own four joints, written out from Lagrange's equations.

Every body is a mass on ``a·e1 + d·e2`` in the slewing plane, ``e1`` along the boom, ``e2`` along the stick; slewing turns the
plane about the vertical. With the planar joints p = (boom, stick, telescope):

    M(p)·p̈ + h(p, ṗ, ψ̇) + g(p) = τ,        J(p)·ψ̈ + J̇·ψ̇ = τ_slew.

A swinging gripper loads the tip with its weight; horizontally only through its rod (:func:`rod_force`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.hydraulic_recipe import MassSettings

Array = npt.NDArray[np.float64]

GRAVITY = 9.81


class RigidBodies(NamedTuple):
    """Masses and lengths for compiled code; ``swings`` 1 = the hanging mass is free horizontally."""

    column_inertia: float
    boom: float
    boom_centre: float
    boom_inertia: float
    stick: float
    stick_centre: float
    stick_inertia: float
    telescope: float
    telescope_centre: float
    telescope_inertia: float
    hanging: float
    swings: float
    boom_length: float
    stick_length: float
    gravity: float


def bodies_of(masses: MassSettings, boom_length: float, stick_length: float, rod: float) -> RigidBodies:
    return RigidBodies(
        masses.column_inertia,
        masses.boom,
        masses.boom_centre,
        masses.boom_inertia,
        masses.stick,
        masses.stick_centre,
        masses.stick_inertia,
        masses.telescope,
        masses.telescope_centre,
        masses.telescope_inertia,
        masses.gripper + masses.payload,
        1.0 if rod > 0.0 else 0.0,
        boom_length,
        stick_length,
        GRAVITY * (1.0 - masses.balanced),
    )


@compiled
def equations(joint: Array, speed: Array, bodies: RigidBodies, mass: Array, bias: Array, weight: Array) -> tuple[float, float]:
    """Fill M (3, 3), h (3,) and g (3,) of the planar joints; return the slewing inertia J [kg·m²] and its rate J̇.

    Args:
        joint, speed: slew, boom, stick, telescope and their rates, (4,).
    """
    c1, s1 = math.cos(joint[1]), math.sin(joint[1])
    c2, s2 = math.cos(joint[1] + joint[2]), math.sin(joint[1] + joint[2])
    turn, w1, w2, out = speed[0], speed[1], speed[1] + speed[2], speed[3]
    mass[:] = 0.0
    bias[:] = 0.0
    weight[:] = 0.0
    around = bodies.column_inertia
    rate = 0.0
    far = bodies.stick_length + joint[3]
    for k in range(4):
        slides = 1.0
        sideways = 1.0
        along = bodies.boom_length
        if k == 0:
            m, along, d, slides = bodies.boom, bodies.boom_centre, 0.0, 0.0
        elif k == 1:
            m, d, slides = bodies.stick, bodies.stick_centre, 0.0
        elif k == 2:
            m, d = bodies.telescope, far + bodies.telescope_centre
        else:
            m, d, sideways = bodies.hanging, far, 1.0 - bodies.swings
        # Columns of the Jacobian, radial and vertical.
        r1, z1 = -along * s1 - d * s2, along * c1 + d * c2
        r2, z2 = -d * s2, d * c2
        r3, z3 = slides * c2, slides * s2
        # Acceleration at zero p̈.
        ar = -along * w1 * w1 * c1 - d * w2 * w2 * c2 - 2.0 * slides * w2 * out * s2
        az = -along * w1 * w1 * s1 - d * w2 * w2 * s2 + 2.0 * slides * w2 * out * c2
        reach = along * c1 + d * c2
        ar -= reach * turn * turn
        mr = m * sideways
        mass[0, 0] += mr * r1 * r1 + m * z1 * z1
        mass[0, 1] += mr * r1 * r2 + m * z1 * z2
        mass[0, 2] += mr * r1 * r3 + m * z1 * z3
        mass[1, 1] += mr * r2 * r2 + m * z2 * z2
        mass[1, 2] += mr * r2 * r3 + m * z2 * z3
        mass[2, 2] += mr * r3 * r3 + m * z3 * z3
        bias[0] += mr * r1 * ar + m * z1 * az
        bias[1] += mr * r2 * ar + m * z2 * az
        bias[2] += mr * r3 * ar + m * z3 * az
        weight[0] += m * bodies.gravity * z1
        weight[1] += m * bodies.gravity * z2
        weight[2] += m * bodies.gravity * z3
        around += mr * reach * reach
        rate += 2.0 * mr * reach * (r1 * w1 + r2 * speed[2] + r3 * out)
    outer = bodies.stick_inertia + bodies.telescope_inertia
    mass[0, 0] += bodies.boom_inertia + outer
    mass[0, 1] += outer
    mass[1, 1] += outer
    mass[1, 0], mass[2, 0], mass[2, 1] = mass[0, 1], mass[0, 2], mass[1, 2]
    bias[0] += (bodies.boom_inertia * c1 * s1 + outer * c2 * s2) * turn * turn
    bias[1] += outer * c2 * s2 * turn * turn
    around += bodies.boom_inertia * c1 * c1 + outer * c2 * c2
    rate -= 2.0 * (bodies.boom_inertia * c1 * s1 * w1 + outer * c2 * s2 * w2)
    return around, rate


@compiled
def solve3(matrix: Array, right: Array, out: Array) -> None:
    """``out`` (3,) with matrix·out = right, by Cramer's rule."""
    a, b, c = matrix[0], matrix[1], matrix[2]
    m0 = b[1] * c[2] - b[2] * c[1]
    m1 = b[2] * c[0] - b[0] * c[2]
    m2 = b[0] * c[1] - b[1] * c[0]
    whole = a[0] * m0 + a[1] * m1 + a[2] * m2
    x, y, z = right[0], right[1], right[2]
    out[0] = (x * m0 + a[1] * (b[2] * z - y * c[2]) + a[2] * (y * c[1] - b[1] * z)) / whole
    out[1] = (a[0] * (y * c[2] - b[2] * z) + x * m1 + a[2] * (b[0] * z - y * c[0])) / whole
    out[2] = (a[0] * (b[1] * z - y * c[1]) + a[1] * (y * c[0] - b[0] * z) + x * m2) / whole


@compiled
def rod_force(tool: Array, tip: Array, hanging: float) -> tuple[float, float]:
    """Horizontal pull of the hanging mass on the tip, x and y [N]: its weight along a rod that leans."""
    down = max(tip[2] - tool[2], 1e-3)
    pull = hanging * GRAVITY / down
    return pull * (tool[0] - tip[0]), pull * (tool[1] - tip[1])


@compiled
def energy(joint: Array, speed: Array, bodies: RigidBodies) -> tuple[float, float]:
    """Kinetic and potential energy [J] of booms and hanging mass, from M, J and the heights (for evaluating an integration)."""
    mass = np.empty((3, 3))
    bias = np.empty(3)
    weight = np.empty(3)
    around, _ = equations(joint, speed, bodies, mass, bias, weight)
    moving = around * speed[0] * speed[0]
    for i in range(3):
        for j in range(3):
            moving += speed[1 + i] * mass[i, j] * speed[1 + j]
    s1, s2 = math.sin(joint[1]), math.sin(joint[1] + joint[2])
    far = bodies.stick_length + joint[3]
    lifted = bodies.boom * bodies.boom_centre * s1
    lifted += bodies.stick * (bodies.boom_length * s1 + bodies.stick_centre * s2)
    lifted += bodies.telescope * (bodies.boom_length * s1 + (far + bodies.telescope_centre) * s2)
    lifted += bodies.hanging * (bodies.boom_length * s1 + far * s2)
    return 0.5 * moving, bodies.gravity * lifted
