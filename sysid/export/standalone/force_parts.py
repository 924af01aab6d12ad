"""Parts of a force axis: force over a step → mean speed, with friction that may stop the motion but not reverse it."""

from __future__ import annotations

import math

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
