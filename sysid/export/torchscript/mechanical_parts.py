"""Parts behind the command stage, batched. Of a force axis: force over a step → mean speed, with friction that may stop the
motion but not reverse it. Between drive and end effector: linkage, backlash, kinematics, hanging tool.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from sysid.export.standalone.mechanical_parts import GRAVITY
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


class Linkage(nn.Module):
    """Cylinder displacement [m] → joint [rad or m]: an even table, extended along its end slopes."""

    def __init__(self, low: float, step: float, joints: list[float]) -> None:
        super().__init__()
        self.low, self.spacing, self.count = low, step, len(joints)
        self.rising = 1.0 if joints[-1] > joints[0] else -1.0
        self.register_buffer("joints", torch.tensor(joints, dtype=torch.float64))
        self.joints: Tensor

    def forward(self, x: Tensor) -> Tensor:
        t = (x - self.low) / self.spacing
        k = torch.clamp(torch.floor(t), 0.0, float(self.count - 2))
        left = self.joints[k.to(torch.int64)]
        return left + (t - k) * (self.joints[k.to(torch.int64) + 1] - left)

    def displacement(self, joint: Tensor) -> Tensor:
        """The inverse, inside the table."""
        sorted_joints = (self.rising * self.joints).contiguous()
        k = torch.clamp(
            torch.searchsorted(sorted_joints, (self.rising * joint).contiguous(), right=True) - 1, 0, self.count - 2
        )
        share = (self.rising * joint - sorted_joints[k]) / (sorted_joints[k + 1] - sorted_joints[k])
        return self.low + self.spacing * (k + torch.clamp(share, 0.0, 1.0))


def backlash(y: Tensor, x: Tensor, width: Tensor) -> Tensor:
    """min(max(y, x − width/2), x + width/2), x itself where y is NaN."""
    return torch.where(torch.isnan(y), x, torch.minimum(torch.maximum(y, x - 0.5 * width), x + 0.5 * width))


def turned(axis: Tensor, angle: Tensor) -> Tensor:
    """Rotation matrices (N, 3, 3) about unit axes (N, 3) (Rodrigues)."""
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    none = torch.zeros_like(x)
    cross = torch.stack([none, -z, y, z, none, -x, -y, x, none], dim=1).reshape(-1, 3, 3)
    sine, rest = torch.sin(angle)[:, None, None], (1.0 - torch.cos(angle))[:, None, None]
    return torch.eye(3, dtype=axis.dtype, device=axis.device)[None] + sine * cross + rest * torch.bmm(cross, cross)


def applied(turn: Tensor, vector: Tensor) -> Tensor:
    """(N, 3, 3) times (N, 3)."""
    return torch.bmm(turn, vector[:, :, None])[:, :, 0]


class Kinematics(nn.Module):
    """Chain of joints from base to tip.

    Args:
        joints: as of :class:`sysid.export.standalone.mechanical_parts.Kinematics`, with the nominal ``shift``, and with
            ``length_at``, the column of the length error of the link before the joint (−1 for none), and its ``length`` [m].
        tip: the same entries of the tip; ``tip_at``, ``base_at``: columns of the first component of ``tip_offset`` and of
            ``base_misalignment`` (translation, rotation), −1 for none.
    """

    def __init__(self, joints: list[dict[str, Any]], tip: dict[str, Any], tip_at: int, base_at: int) -> None:
        super().__init__()
        steps = [*joints, tip]
        for name, rows in (("rotation", joints), ("axis", joints), ("centre", joints), ("shift", steps)):
            self.register_buffer(name, torch.tensor([row[name] for row in rows], dtype=torch.float64))
        self.rotation: Tensor
        self.axis: Tensor
        self.centre: Tensor
        self.shift: Tensor
        self.length_at, self.length = [int(s["length_at"]) for s in steps], [float(s["length"]) for s in steps]
        self.prismatic = [bool(j["prismatic"]) for j in joints]
        self.index = [int(j["axis_index"]) for j in joints]
        self.ratio, self.offset = [float(j["ratio"]) for j in joints], [float(j["offset"]) for j in joints]
        self.mass, self.count = [float(j["mass"]) for j in joints], len(joints)
        self.tip_at, self.base_at, self.gravity = tip_at, base_at, GRAVITY

    def forward(self, q: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Joints of the structure (N, A) → end effector (N, 3) [m] and gravity loads (N, A) [N·m or N]."""
        n = q.shape[0]
        turn = torch.eye(3, dtype=q.dtype, device=q.device)[None].repeat(n, 1, 1)
        place = torch.zeros(n, 3, dtype=q.dtype, device=q.device)
        axes: list[Tensor] = []
        origins: list[Tensor] = []
        moments: list[Tensor] = []
        for j in range(self.count):
            place = place + applied(turn, self.shifted(j, theta))
            turn = torch.matmul(turn, self.rotation[j])
            axis = torch.matmul(turn, self.axis[j])
            value = q[:, self.index[j]] * self.ratio[j] + self.offset[j]
            axes.append(axis)
            origins.append(place)
            if self.prismatic[j]:
                place = place + value[:, None] * axis
            else:
                turn = torch.bmm(turned(axis, value), turn)
            moments.append(self.mass[j] * (place + torch.matmul(turn, self.centre[j])))
        return self.measured(place + applied(turn, self.shifted(self.count, theta)), theta), self.loads(
            q, axes, origins, moments
        )

    def shifted(self, j: int, theta: Tensor) -> Tensor:
        """Translation of frame j (N, 3), the tip's for j = ``count``."""
        longer = torch.ones_like(theta[:, 0])
        if self.length_at[j] >= 0:
            longer = 1.0 + theta[:, self.length_at[j]] / self.length[j]
        found = longer[:, None] * self.shift[j][None]
        if j == self.count and self.tip_at >= 0:
            found = found + theta[:, self.tip_at : self.tip_at + 3]
        return found

    def measured(self, place: Tensor, theta: Tensor) -> Tensor:
        """Model frame → measured frame."""
        if self.base_at < 0:
            return place
        rotation = theta[:, self.base_at + 3 : self.base_at + 6]
        angle = torch.sqrt((rotation**2).sum(dim=1))
        axis = rotation / torch.where(angle > 0.0, angle, torch.ones_like(angle))[:, None]
        return applied(turned(axis, angle), place) + theta[:, self.base_at : self.base_at + 3]

    def loads(self, q: Tensor, axes: list[Tensor], origins: list[Tensor], moments: list[Tensor]) -> Tensor:
        load, mass = torch.zeros_like(q), 0.0
        moment = torch.zeros_like(origins[0])
        for back in range(self.count):
            k = self.count - 1 - back
            mass += self.mass[k]
            moment = moment + moments[k]
            lever = moment - mass * origins[k]
            axis = axes[k]
            own = mass * axis[:, 2] if self.prismatic[k] else axis[:, 0] * lever[:, 1] - axis[:, 1] * lever[:, 0]
            load[:, self.index[k]] += self.gravity * own * self.ratio[k]
        return load


class GripperSway(nn.Module):
    """The hanging tool; ``at``: length, damping_ratio. ``parts``: sub-steps.

    State: place (2) and speed (2) of the bob, place (3) and speed (3) of the pivot.
    """

    def __init__(self, dt: float, at: int, parts: int) -> None:
        super().__init__()
        self.dt, self.at, self.parts, self.width, self.gravity = dt, at, parts, 10, GRAVITY

    def forward(self, pivot: Tensor, state: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """Tip (N, 3) → tool (N, 3), and the state."""
        new = torch.isnan(state[:, :1])
        rest = torch.cat([pivot[:, :2], torch.zeros_like(pivot[:, :2]), pivot, torch.zeros_like(pivot)], dim=1)
        state = torch.where(new, rest, state)
        bob, speed, before, pivot_speed = state[:, :2], state[:, 2:4], state[:, 4:7], state[:, 7:10]
        square, h = theta[:, self.at] ** 2, self.dt / self.parts
        going = (pivot - before) / self.dt
        at, away = before[:, :2], bob - before[:, :2]
        drop = torch.sqrt(torch.maximum(square - (away**2).sum(dim=1), 1e-4 * square))
        jump = going - pivot_speed
        along = ((away * jump[:, :2]).sum(dim=1) - drop * jump[:, 2]) / square
        speed = speed + away * along[:, None]
        for _ in range(self.parts):
            pull = self.pull(bob - at, speed - going[:, :2], h, theta)
            half, ahead = speed + 0.5 * h * pull, speed + h * pull
            bob, at = bob + h * half, at + h * going[:, :2]
            speed = half + 0.5 * h * self.pull(bob - at, ahead - going[:, :2], h, theta)
            over = ((bob - at) ** 2).sum(dim=1) / (0.9999 * square)
            thrown = (over > 1.0)[:, None]
            shrink = torch.sqrt(torch.clamp(over, min=1.0))[:, None]
            bob = torch.where(thrown, at + (bob - at) / shrink, bob)
            speed = torch.where(thrown, going[:, :2], speed)
        away = bob - pivot[:, :2]
        height = pivot[:, 2] - torch.sqrt(torch.relu(square - (away**2).sum(dim=1)))
        return torch.cat([bob, height[:, None]], dim=1), torch.cat([bob, speed, pivot, going], dim=1)

    def pull(self, away: Tensor, speed: Tensor, h: float, theta: Tensor) -> Tensor:
        """Acceleration for a horizontal deflection and a speed relative to the pivot."""
        length, damping = theta[:, self.at], theta[:, self.at + 1]
        drop = torch.sqrt(torch.maximum(length**2 - (away**2).sum(dim=1), 1e-4 * length**2))
        fall = -(away * speed).sum(dim=1) / drop
        tension = (self.gravity * drop / length + ((speed**2).sum(dim=1) + fall**2) / length) / length
        tension = torch.clamp(tension, max=1.0 / h**2)
        return -tension[:, None] * away - 2.0 * (damping * torch.sqrt(self.gravity / length))[:, None] * speed
