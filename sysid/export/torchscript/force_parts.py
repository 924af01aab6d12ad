"""Parts of a force axis: force over a step → mean speed, with friction that may stop the motion but not reverse it."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from sysid.export.torchscript.command_parts import damped_sine, free_motion, parameter


class Friction(nn.Module):
    """A law of friction; ``at``: column of its first parameter, the others follow in the order of its docstring."""

    def __init__(self, at: int) -> None:
        super().__init__()
        self.at = at

    def slope(self, v: Tensor, theta: Tensor) -> Tensor:
        return torch.zeros_like(v)

    def dry(self, moved: Tensor, v: Tensor, theta: Tensor) -> Tensor:
        return torch.zeros_like(v)


class ViscousFriction(Friction):
    """positive, negative"""

    def slope(self, v: Tensor, theta: Tensor) -> Tensor:
        return torch.where(v > 0.0, theta[:, self.at], theta[:, self.at + 1])


class CoulombFriction(Friction):
    """positive, negative"""

    def dry(self, moved: Tensor, v: Tensor, theta: Tensor) -> Tensor:
        return torch.where(moved >= 0.0, theta[:, self.at], theta[:, self.at + 1])


class StribeckFriction(Friction):
    """static_force, coulomb_force, stribeck_velocity"""

    def dry(self, moved: Tensor, v: Tensor, theta: Tensor) -> Tensor:
        still, sliding = theta[:, self.at], theta[:, self.at + 1]
        return sliding + torch.relu(still - sliding) * torch.exp(-((v / theta[:, self.at + 2]) ** 2))


class SmoothCoulombFriction(Friction):
    """force, width, exponent"""

    def slope(self, v: Tensor, theta: Tensor) -> Tensor:
        width, exponent = theta[:, self.at + 1], theta[:, self.at + 2]
        x, steepest = torch.abs(v) / width, theta[:, self.at] / width
        sharp = exponent > 0.0
        power = torch.where(sharp, exponent, torch.ones_like(x))
        still = x < 1e-6
        moved = torch.where(still, torch.ones_like(x), x)
        share = torch.where(sharp, (1.0 + moved**power) ** (-1.0 / power), torch.tanh(moved) / moved)
        return torch.where(still, steepest, steepest * share)


class RigidDrive(nn.Module):
    """One mass under a force.

    ``constant_at``, ``ratio_at`` and ``bias_at`` are the columns of its force constant, inertia ratio and constant load.
    """

    def __init__(
        self, dt: float, inertia: float, constant_at: int, ratio_at: int, bias_at: int, laws: list[Friction]
    ) -> None:  # fmt: skip
        super().__init__()
        self.dt, self.inertia, self.constant_at, self.ratio_at, self.bias_at = dt, inertia, constant_at, ratio_at, bias_at
        self.laws: Any = nn.ModuleList(laws)
        self.width = 1

    def forward(self, command: Tensor, state: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Mean speed of the step, and the state: speed."""
        force = self.force(command, theta)
        v, mass = torch.nan_to_num(state[:, 0]), self.mass(theta)
        after = self.against_friction(v, force, v, self.dt / mass, theta)
        turns = (v != 0.0) & (torch.sign(after) != torch.sign(v))
        # Dry friction changes its direction within the step, after the time in which it stops the motion.
        against = -torch.sign(v) * (force - parameter(theta, self.bias_at, 0.0))
        for law in self.laws:
            against = against + law.dry(v, v, theta)
        stop = mass * torch.abs(v) / torch.where(turns, against, torch.ones_like(against))
        rest = torch.zeros_like(v)
        back = self.against_friction(rest, force, rest, (self.dt - stop) / mass, theta)
        mean = torch.where(turns, (v * stop + back * (self.dt - stop)) / self.dt, v + after)
        return 0.5 * mean, torch.where(turns, back, after)[:, None]

    def force(self, command: Tensor, theta: Tensor) -> Tensor:
        return command * parameter(theta, self.constant_at, 1.0)

    def mass(self, theta: Tensor) -> Tensor:
        return self.inertia * parameter(theta, self.ratio_at, 1.0)

    def against_friction(self, free: Tensor, force: Tensor, v: Tensor, mobility: Tensor, theta: Tensor) -> Tensor:
        """Speed after a step that changes it from ``free`` by ``mobility`` times the force (implicit)."""
        slope, dry = torch.zeros_like(v), torch.zeros_like(v)
        for law in self.laws:
            slope = slope + law.slope(v, theta)
        moved = (free + mobility * (force - parameter(theta, self.bias_at, 0.0))) / (1.0 + mobility * slope)
        for law in self.laws:
            dry = dry + law.dry(moved, v, theta)
        hold = mobility * dry / (1.0 + mobility * slope)
        return torch.sign(moved) * torch.relu(torch.abs(moved) - hold)


class FlexibleDrive(RigidDrive):
    """Motor and load on a spring; ``at``: frequency, damping_ratio, inertia_ratio. ``count``: sub-steps of a step."""

    def __init__(
        self,
        dt: float,
        inertia: float,
        constant_at: int,
        ratio_at: int,
        bias_at: int,
        laws: list[Friction],
        at: int,
        count: int,
    ) -> None:
        super().__init__(dt, inertia, constant_at, ratio_at, bias_at, laws)
        self.at, self.count, self.width = at, count, 3

    def forward(self, command: Tensor, state: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Mean speed of the load, and the state: speed of the motor, twist, speed of the load."""
        force = self.force(command, theta)
        ratio, short = theta[:, self.at + 2], self.dt / self.count
        root = torch.sqrt(1.0 + ratio)
        omega, damping = 2.0 * math.pi * theta[:, self.at] * root, theta[:, self.at + 1] * root
        fade = damping * omega
        sine, cosine = damped_sine(fade, omega**2 * (1.0 - damping**2), short)
        a, b, c, d = free_motion(omega, fade, sine, cosine)
        share, mass = ratio / (1.0 + ratio), self.mass(theta)
        mobility = short / mass - c * ratio / (mass * omega**2)
        known = torch.nan_to_num(state)
        v, twist, far = known[:, 0], known[:, 1], known[:, 2]
        moved = torch.zeros_like(v)
        for _ in range(self.count):
            twisting = v - far
            free = v + share * (c * twist + d * twisting - twisting)
            after = self.against_friction(free, force, v, mobility, theta)
            held = (after - free) / mobility
            still = held * (1.0 + ratio) / (mass * omega**2)
            centre = v - share * twisting
            faster = centre + short * held / mass
            turned = still + a * (twist - still) + b * twisting
            far = faster - (1.0 - share) * (c * (twist - still) + d * twisting)
            moved = moved + short * 0.5 * (centre + faster) + share * (turned - twist)
            v, twist = after, turned
        return moved / self.dt, torch.stack([v, twist, far], dim=1)
