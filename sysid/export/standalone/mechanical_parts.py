"""Parts behind the command stage. Of a force axis: force over a step → mean speed, with friction that may stop the motion but
not reverse it. Between drive and end effector: linkage, backlash, kinematics, hanging tool, sensors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.export.standalone.command_parts import oscillation


class Friction:
    """One law of friction: ``slope`` [N·s/m or N·m·s/rad] of its smooth part, ``dry`` [N or N·m] of its dry part."""

    def slope(self, v: float) -> float:
        """Force over speed at the speed ``v`` before the step."""
        return 0.0

    def dry(self, moved: float, v: float) -> float:
        """Largest force that opposes a motion in the direction of ``moved``."""
        return 0.0


class ViscousFriction(Friction):
    """Coefficient for each direction [N·s/m or N·m·s/rad]."""

    def __init__(self, positive: float, negative: float) -> None:
        self.positive, self.negative = positive, negative

    def slope(self, v: float) -> float:
        return self.positive if v > 0.0 else self.negative


class CoulombFriction(Friction):
    """A constant force against each direction of motion [N or N·m]."""

    def __init__(self, positive: float, negative: float) -> None:
        self.positive, self.negative = positive, negative

    def dry(self, moved: float, v: float) -> float:
        return self.positive if moved >= 0.0 else self.negative


class StribeckFriction(Friction):
    """F_c + (F_s − F_c)·e^(−(v/v_s)²) [N or N·m, m/s or rad/s]."""

    def __init__(self, static_force: float, coulomb_force: float, stribeck_velocity: float) -> None:
        self.static, self.coulomb, self.velocity = static_force, coulomb_force, stribeck_velocity

    def dry(self, moved: float, v: float) -> float:
        return self.coulomb + max(self.static - self.coulomb, 0.0) * math.exp(-((v / self.velocity) ** 2))


class SmoothCoulombFriction(Friction):
    """force·tanh(v/width), or with an exponent n > 0 force·x/(1 + |x|^n)^(1/n), x = v/width."""

    def __init__(self, force: float, width: float, exponent: float) -> None:
        self.force, self.width, self.exponent = force, width, exponent

    def slope(self, v: float) -> float:
        x, steepest = abs(v) / self.width, self.force / self.width
        if x < 1e-6:
            return steepest
        if self.exponent > 0.0:
            return steepest * float((1.0 + x**self.exponent) ** (-1.0 / self.exponent))
        return steepest * math.tanh(x) / x


class RigidDrive:
    """One mass [kg or kg·m²] under a force, a constant ``bias`` [N or N·m] and friction."""

    def __init__(self, dt: float, mass: float, bias: float, frictions: list[Friction]) -> None:
        self.dt, self.mass, self.bias, self.frictions = dt, mass, bias, frictions
        self.reset(0.0)

    def reset(self, speed: float) -> None:
        self.speed = speed

    def step(self, force: float) -> float:
        """Mean speed of a step under a held force."""
        before = self.speed
        self.speed = self.against_friction(before, force, before, self.dt / self.mass)
        if before == 0.0 or (before > 0.0 and self.speed > 0.0) or (before < 0.0 and self.speed < 0.0):
            return 0.5 * (before + self.speed)
        # Dry friction changes its direction within the step, after the time in which it stops the motion.
        along = math.copysign(1.0, before) * (force - self.bias)
        stop = self.mass * abs(before) / (sum(law.dry(before, before) for law in self.frictions) - along)
        self.speed = self.against_friction(0.0, force, 0.0, (self.dt - stop) / self.mass)
        return 0.5 * (before * stop + self.speed * (self.dt - stop)) / self.dt

    def against_friction(self, free: float, force: float, v: float, mobility: float) -> float:
        """Speed after a step that changes it from ``free`` by ``mobility`` times the force (implicit)."""
        slope = sum(law.slope(v) for law in self.frictions)
        moved = (free + mobility * (force - self.bias)) / (1.0 + mobility * slope)
        hold = mobility * sum(law.dry(moved, v) for law in self.frictions) / (1.0 + mobility * slope)
        return moved - hold if moved > hold else moved + hold if moved < -hold else 0.0


class FlexibleDrive(RigidDrive):
    """Motor and load of ``inertia_ratio`` times its inertia on a spring: the load alone oscillates at ``frequency`` [Hz]."""

    def __init__(
        self, dt: float, mass: float, bias: float, frictions: list[Friction], frequency: float, damping_ratio: float,
        inertia_ratio: float,
    ) -> None:  # fmt: skip
        self.ratio, root = inertia_ratio, math.sqrt(1.0 + inertia_ratio)
        omega, damping = 2.0 * math.pi * frequency * root, damping_ratio * root
        self.count = max(1, math.ceil(omega * dt))
        self.short, self.square = dt / self.count, omega**2
        self.matrix = oscillation(omega, damping, self.short)
        super().__init__(dt, mass, bias, frictions)

    def reset(self, speed: float) -> None:
        self.speed = speed
        self.twist, self.load_speed = 0.0, speed

    def step(self, force: float) -> float:
        share, moved = self.ratio / (1.0 + self.ratio), 0.0
        a, b, c, d = self.matrix
        mobility = self.short / self.mass - c * self.ratio / (self.mass * self.square)
        for _ in range(self.count):
            v, twisting = self.speed, self.speed - self.load_speed
            free = v + share * (c * self.twist + d * twisting - twisting)
            after = self.against_friction(free, force, v, mobility)
            held = (after - free) / mobility
            still = held * (1.0 + self.ratio) / (self.mass * self.square)
            centre, twist = v - share * twisting, self.twist
            faster = centre + self.short * held / self.mass
            self.twist = still + a * (twist - still) + b * twisting
            self.load_speed = faster - (1.0 - share) * (c * (twist - still) + d * twisting)
            moved += self.short * 0.5 * (centre + faster) + share * (self.twist - twist)
            self.speed = after
        return moved / self.dt


Array = npt.NDArray[np.float64]
#: Standard gravity [m/s²], along −z of the base.
GRAVITY = 9.80665


class Linkage:
    """Cylinder displacement [m] → joint [rad or m]: an even table, extended along its end slopes."""

    def __init__(self, low: float, step: float, joints: list[float]) -> None:
        self.low, self.spacing, self.joints = low, step, joints

    def joint(self, x: float) -> float:
        t = (x - self.low) / self.spacing
        k = min(max(math.floor(t), 0), len(self.joints) - 2)
        return self.joints[k] + (t - k) * (self.joints[k + 1] - self.joints[k])

    def displacement(self, joint: float) -> float:
        """The inverse, inside the table."""
        rising = 1.0 if self.joints[-1] > self.joints[0] else -1.0
        places = self.low + self.spacing * np.arange(len(self.joints))
        return float(np.interp(rising * joint, rising * np.asarray(self.joints), places))


class Backlash:
    """y = min(max(y, x − width/2), x + width/2) [rad or m]."""

    def __init__(self, width: float) -> None:
        self.half = 0.5 * width
        self.reset(math.nan)

    def reset(self, y: float) -> None:
        self.y = y

    def step(self, x: float) -> float:
        self.y = x if math.isnan(self.y) else min(max(self.y, x - self.half), x + self.half)
        return self.y


class Kinematics:
    """Chain of joints from base to tip.

    Args:
        joints: of each the ``rotation`` (3, 3) and ``shift`` (3) [m] of its frame in the frame that the joint before it moves,
            its ``axis`` (3), whether it is ``prismatic``, which machine ``axis_index`` moves it, with ``ratio`` and ``offset``,
            and ``mass`` [kg] and ``centre`` (3) [m] of all that moves with it and no further joint.
        tip: place of the tip in the frame that the last joint moves (3) [m].
        base_rotation, base_translation: model → measured frame, (3, 3) and (3) [m].
    """

    def __init__(self, joints: list[Any], tip: list[float], base_rotation: list[Any], base_translation: list[float]) -> None:
        self.joints: list[dict[str, Any]] = [
            {key: np.array(value, dtype=np.float64) if isinstance(value, list) else value for key, value in joint.items()}
            for joint in joints
        ]
        self.tip, self.base_rotation, self.base_translation = map(np.array, (tip, base_rotation, base_translation))

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Joints of the structure (A,) → end effector (3,) [m] and gravity load of each axis (A,) [N·m or N]."""
        turn, place = np.eye(3), np.zeros(3)
        axes: list[Array] = []
        origins: list[Array] = []
        moments: list[Array] = []
        for joint in self.joints:
            place = place + turn @ joint["shift"]
            turn = turn @ joint["rotation"]
            axis, value = turn @ joint["axis"], q[joint["axis_index"]] * joint["ratio"] + joint["offset"]
            axes.append(axis)
            origins.append(place)
            if joint["prismatic"]:
                place = place + value * axis
            else:
                turn = turned(axis, value) @ turn
            moments.append(joint["mass"] * (place + turn @ joint["centre"]))
        load, mass, moment = np.zeros(len(q)), 0.0, np.zeros(3)
        for k in reversed(range(len(self.joints))):
            joint, (x, y, z) = self.joints[k], axes[k]
            mass, moment = mass + float(joint["mass"]), moment + moments[k]
            lever = moment - mass * origins[k]
            own = mass * z if joint["prismatic"] else x * lever[1] - y * lever[0]
            load[joint["axis_index"]] += GRAVITY * own * joint["ratio"]
        return self.base_rotation @ (place + turn @ self.tip) + self.base_translation, load


def turned(axis: Array, angle: float) -> Array:
    """Rotation matrix about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross))


class SensorReading:
    """step·⌊(scale·x + bias)/step + ½⌋; without rounding for a step of zero."""

    def __init__(self, scale: float, bias: float, step: float) -> None:
        self.scale, self.bias, self.resolution = scale, bias, step

    def read(self, x: float) -> float:
        y = self.scale * x + self.bias
        return self.resolution * math.floor(y / self.resolution + 0.5) if self.resolution > 0.0 else y


class GripperSway:
    """A tool that hangs ``length`` [m] below the tip on two passive joints: a damped spherical pendulum."""

    def __init__(self, dt: float, length: float, damping_ratio: float) -> None:
        self.dt, self.length, self.damping, self.rate = dt, length, damping_ratio, math.sqrt(GRAVITY / length)
        self.reset()

    def reset(self) -> None:
        self.bob: Array | None = None

    def step(self, pivot: Array) -> Array:
        """Tip (3,) → tool (3,); the pivot moves evenly during the step (velocity Verlet in sub-steps)."""
        square = self.length**2
        if self.bob is None:
            self.bob, self.speed, self.pivot, self.pivot_speed = pivot[:2].copy(), np.zeros(2), pivot.copy(), np.zeros(3)
        parts = max(1, math.ceil(self.dt * self.rate / 0.1))
        h, going = self.dt / parts, (pivot - self.pivot) / self.dt
        at, away = self.pivot[:2].copy(), self.bob - self.pivot[:2]
        drop = math.sqrt(max(square - float(away @ away), 1e-4 * square))
        jump = going - self.pivot_speed
        speed = self.speed + away * (float(away @ jump[:2]) - drop * jump[2]) / square
        bob = self.bob
        for _ in range(parts):
            pull = self._pull(bob - at, speed - going[:2], h)
            half, ahead = speed + 0.5 * h * pull, speed + h * pull
            bob, at = bob + h * half, at + h * going[:2]
            speed = half + 0.5 * h * self._pull(bob - at, ahead - going[:2], h)
            over = float((bob - at) @ (bob - at)) / (0.9999 * square)
            if over > 1.0:  # a jump of the pivot beyond the length: the tool follows
                bob, speed = at + (bob - at) / math.sqrt(over), going[:2].copy()
        self.bob, self.speed, self.pivot, self.pivot_speed = bob, speed, pivot.copy(), going
        away = bob - pivot[:2]
        return np.array([bob[0], bob[1], pivot[2] - math.sqrt(max(square - float(away @ away), 0.0))])

    def _pull(self, away: Array, speed: Array, h: float) -> Array:
        """Acceleration for a horizontal deflection and a speed relative to the pivot."""
        square = self.length**2
        drop = math.sqrt(max(square - float(away @ away), 1e-4 * square))
        fall = -float(away @ speed) / drop
        tension = min((GRAVITY * drop / self.length + (float(speed @ speed) + fall**2) / self.length) / self.length, 1.0 / h**2)
        return -tension * away - 2.0 * self.damping * self.rate * speed
