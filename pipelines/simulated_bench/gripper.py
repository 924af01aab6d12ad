"""The gripper: a nonlinear spherical pendulum below the moving boom tip, on two passive crossed joints.

The tool point is a mass on a rod of fixed length. It is integrated as a constrained point (SHAKE): one explicit step under
gravity and damping, then back onto the sphere around the new pivot along the old rod. A step in the speed of the pivot, as at
the end of a backlash, then gives the pendulum the exact impulse.

Damping acts on the speed relative to the pivot, ``−2·ζ·ω₀·(v_tool − v_pivot)`` with ``ω₀ = √(g/L)``; for small angles
``L·θ̈ + 2ζω₀L·θ̇ + g·θ = −a``.

Source: Ryckaert, Ciccotti, Berendsen, J. Comput. Phys. 23 (1977) 327.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled

Array = npt.NDArray[np.float64]

GRAVITY = 9.81


@compiled
def swing(
    tool: Array, velocity: Array, pivot: Array, next_pivot: Array, length: float, damping_ratio: float, step: float
) -> None:
    """Advance ``tool`` and ``velocity`` (3,) in place while the pivot moves to ``next_pivot``."""
    if length <= 0.0:
        for i in range(3):
            velocity[i] = (next_pivot[i] - pivot[i]) / step
            tool[i] = next_pivot[i]
        return
    drag = 2.0 * damping_ratio * math.sqrt(GRAVITY / length)
    rod = np.empty(3)
    free = np.empty(3)
    for i in range(3):
        rod[i] = tool[i] - pivot[i]
        acceleration = -drag * (velocity[i] - (next_pivot[i] - pivot[i]) / step)
        if i == 2:
            acceleration -= GRAVITY
        free[i] = tool[i] + velocity[i] * step + acceleration * step * step
    # |free + s·rod − next_pivot| = length, the root near zero
    a = 0.0
    b = 0.0
    c = -length * length
    for i in range(3):
        w = free[i] - next_pivot[i]
        a += rod[i] * rod[i]
        b += rod[i] * w
        c += w * w
    s = -c / (b + math.sqrt(max(b * b - a * c, 0.0)))
    for i in range(3):
        moved = free[i] + s * rod[i]
        velocity[i] = (moved - tool[i]) / step
        tool[i] = moved
