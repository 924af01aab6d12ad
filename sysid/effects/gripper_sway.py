"""``gripper_sway``: the tool hangs on two passive joints and swings as a damped pendulum below the tip."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot
from sysid.machine.kinematics import GRAVITY

#: State: bob x, y, its velocity x, y, last pivot x, y, z, last pivot velocity x, y, z.
MEMORY = 10

EFFECT = Effect(
    name="gripper_sway",
    title="Swinging tool",
    sentences=(
        "The tool swings on a pendulum of {length} (damping ratio {damping_ratio}); the simulation keeps it still.",
        "The tool swings on a pendulum of {length}; the simulation keeps it still.",
    ),
    part="tool",
    stage="tool",
    target="tool",
    slots=(Slot("length"), Slot("damping_ratio")),
    forms=(
        Form(
            (
                Parameter("length", "m", (0.0, 5.0), (0.03, 0.1, 0.25, 0.6), 5e-3, "pivot to tool point"),
                Parameter("damping_ratio", "1", (0.001, 0.9), (0.05, 0.02, 0.1), 1.0, "of the swing", secondary=True),
            )
        ),
    ),
    equation="L·θ̈ + 2ζω₀L·θ̇ + g·θ = −a in both horizontal directions, ω₀² = g/L; hangs straight down at rest",
    source="Goldstein, Classical Mechanics, §1.4; L 0.20–0.30 m, ζ 0.01–0.08 at 1:5 (machine facts)",
    excited_by="starts and stops of the tip, and seconds of rest after them",
    confused_with={
        "oil_compressibility": "sway, 0.9–1.3 Hz, continues after the joints stop; oil, 5–13 Hz, moves the axis itself"
    },
    example={"length": 0.25, "damping_ratio": 0.05},
    need=Need("tip_stops", 5, "Move the tip fast, stop, and let the tool swing for 5 s; ten times."),
    memory=lambda dt: MEMORY,
)


@inlined
def _pull(dx, dy, vx, vy, length, rate, damping, h):
    """Acceleration of the bob for a horizontal deflection (dx, dy) and a velocity relative to the pivot, in a sub-step ``h``.

    String tension keeps the bob on the sphere: with w² = L² − d² the restoring acceleration is g·d·w/L²
    plus the centripetal part, which at small angles is the linear pendulum g·d/L. The tension of a bob at the height of its
    pivot (a jump in the measured tip) is unbounded; it is limited to what the sub-step can integrate, at least a hundred times
    that at rest.
    """
    reach = length * length - dx * dx - dy * dy
    drop = math.sqrt(max(reach, 1e-4 * length * length))
    fall = -(dx * vx + dy * vy) / drop
    speed2 = vx * vx + vy * vy + fall * fall
    tension = min((GRAVITY * drop / length + speed2 / length) / length, 1.0 / (h * h))
    return -tension * dx - 2.0 * damping * rate * vx, -tension * dy - 2.0 * damping * rate * vy


@inlined
def step(x, y, z, p, i, s, j, dt, out):
    """Advance by ``dt`` with the pivot moving evenly from its last place to (x, y, z); writes the tool into ``out``.

    The pivot enters as a position; its velocity changes at samples only, and the component of each change along the string
    moves the bob (``Δv = r (r·Δv_pivot)/L²``), so that a measured pivot is not differentiated twice. Velocity Verlet in
    sub-steps, of second order: the tension depends on the velocity, for which that at the end of the sub-step is predicted.
    """
    length = p[i]
    if length < 1e-3:
        out[0] = x
        out[1] = y
        out[2] = z - length
        return
    if np.isnan(s[j]):
        s[j] = x
        s[j + 1] = y
        s[j + 2] = 0.0
        s[j + 3] = 0.0
    if np.isnan(s[j + 4]):
        s[j + 4] = x
        s[j + 5] = y
        s[j + 6] = z
        s[j + 7] = 0.0
        s[j + 8] = 0.0
        s[j + 9] = 0.0
    rate = math.sqrt(GRAVITY / length)
    damping = p[i + 1]
    parts = max(1, math.ceil(dt * rate / 0.1))
    h = dt / parts
    px = s[j + 4]
    py = s[j + 5]
    gx = (x - px) / dt
    gy = (y - py) / dt
    bx = s[j]
    by = s[j + 1]
    gz = (z - s[j + 6]) / dt
    vx = s[j + 2]
    vy = s[j + 3]
    dx = bx - px
    dy = by - py
    drop = math.sqrt(max(length * length - dx * dx - dy * dy, 1e-4 * length * length))
    along = dx * (gx - s[j + 7]) + dy * (gy - s[j + 8]) - drop * (gz - s[j + 9])
    vx += dx * along / (length * length)
    vy += dy * along / (length * length)
    for _ in range(parts):
        ax, ay = _pull(bx - px, by - py, vx - gx, vy - gy, length, rate, damping, h)
        hx = vx + 0.5 * h * ax
        hy = vy + 0.5 * h * ay
        bx += h * hx
        by += h * hy
        px += h * gx
        py += h * gy
        ax, ay = _pull(bx - px, by - py, vx + h * ax - gx, vy + h * ay - gy, length, rate, damping, h)
        vx = hx + 0.5 * h * ax
        vy = hy + 0.5 * h * ay
        over = ((bx - px) ** 2 + (by - py) ** 2) / (0.9999 * length * length)
        if over > 1.0:  # a jump of the pivot beyond the string length: the bob follows
            bx = px + (bx - px) / math.sqrt(over)
            by = py + (by - py) / math.sqrt(over)
            vx = gx
            vy = gy
    s[j] = bx
    s[j + 1] = by
    s[j + 2] = vx
    s[j + 3] = vy
    s[j + 4] = x
    s[j + 5] = y
    s[j + 6] = z
    s[j + 7] = gx
    s[j + 8] = gy
    s[j + 9] = gz
    dx = bx - x
    dy = by - y
    out[0] = bx
    out[1] = by
    out[2] = z - math.sqrt(max(length * length - dx * dx - dy * dy, 0.0))
