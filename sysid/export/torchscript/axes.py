"""Axes of a machine, batched: drive between end stops, linkage, backlash and compliance of the joint.

State of an axis: position of the drive, state of its drive, output of the backlash before and behind the joint's sensor.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from sysid.export.torchscript.command_parts import CommandStage
from sysid.export.torchscript.force_parts import RigidDrive
from sysid.export.torchscript.joint_parts import Linkage, backlash
from sysid.export.torchscript.oscillator import parameter

Step = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class JointColumns:
    """Columns of the joint's parameters, −1 where the plant does not have the effect."""

    offset: int
    drive_backlash: int
    structure_backlash: int
    drive_compliance: int
    structure_compliance: int


class Axis(nn.Module):
    """What all axes have.

    Args:
        low, high: end stops of the drive [m or rad], infinite for none.
        inner: numbers that the drive remembers beside its position.
        sag_at: column of the load that the servo follows, in the state of the axis, −1 for none.
    """

    def __init__(
        self, dt: float, low: float, high: float, inner: int, linkage: Linkage | None, columns: JointColumns, sag_at: int = -1
    ) -> None:  # fmt: skip
        super().__init__()
        self.dt, self.low, self.high, self.inner, self.sag_at = dt, low, high, inner, sag_at
        self.linked, self.linkage = linkage is not None, linkage or Linkage(0.0, 1.0, [0.0, 1.0])
        self.offset_at, self.drive_backlash_at = columns.offset, columns.drive_backlash
        self.structure_backlash_at = columns.structure_backlash
        self.drive_compliance_at, self.structure_compliance_at = columns.drive_compliance, columns.structure_compliance
        self.width, self.gain, self.servo = 3 + inner, math.inf, False
        # What the drive remembers at the start, as a share of the speed: NaN where it begins with its first command.
        self.register_buffer("moving", torch.full((inner,), math.nan, dtype=torch.float64))
        self.moving: Tensor

    def begin(self, position: Tensor, straight: Tensor, speed: Tensor) -> Tensor:
        """State (N, width) in the middle of the backlash; ``speed`` of a force axis (N,)."""
        position = torch.clamp(position, self.low, self.high)
        unknown = torch.full_like(position, math.nan)
        inner = speed[:, None] * self.moving[None]
        return torch.cat([position[:, None], inner, straight[:, None], unknown[:, None]], dim=1)

    def demand(self, command: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return command, state

    def move(self, demand: Tensor, state: Tensor) -> Tensor:
        position = torch.clamp(state[:, 0] + self.dt * demand, self.low, self.high)
        return torch.cat([position[:, None], state[:, 1:]], dim=1)

    def joint(self, load: Tensor, state: Tensor, theta: Tensor) -> Step:
        """Value at the joint's sensor and the state."""
        x = self.linkage(state[:, 0]) if self.linked else state[:, 0]
        y = backlash(state[:, 1 + self.inner], x, parameter(theta, self.drive_backlash_at, 0.0))
        if self.sag_at >= 0:
            load = torch.where(torch.isnan(state[:, self.sag_at]), load, state[:, self.sag_at])
        found = y - parameter(theta, self.drive_compliance_at, 0.0) * load
        return found, torch.cat([state[:, : 1 + self.inner], y[:, None], state[:, 2 + self.inner :]], dim=1)

    def structure(self, joint: Tensor, load: Tensor, state: Tensor, theta: Tensor) -> Step:
        """Value behind backlash and offset of the sensor, and the state."""
        y = backlash(state[:, 2 + self.inner], joint, parameter(theta, self.structure_backlash_at, 0.0))
        found = y + parameter(theta, self.offset_at, 0.0) - parameter(theta, self.structure_compliance_at, 0.0) * load
        return found, torch.cat([state[:, : 2 + self.inner], y[:, None]], dim=1)

    def inverse(self, joint: Tensor) -> Tensor:
        """Position of the drive for a joint without sag."""
        return self.linkage.displacement(joint) if self.linked else joint


class VelocityAxis(Axis):
    """The command is an opening, the demand a mean speed. ``sense``: −1 where the joint falls as the drive extends."""

    def __init__(
        self, dt: float, low: float, high: float, stage: CommandStage, gain: float, sense: float, linkage: Linkage | None,
        columns: JointColumns,
    ) -> None:  # fmt: skip
        super().__init__(dt, low, high, stage.width, linkage, columns)
        self.stage, self.gain, self.sense = stage, gain, sense

    def demand(self, command: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        speed, inner = self.stage(command, self.sense * load, state[:, 1 : 1 + self.inner], theta, hold)
        return speed, torch.cat([state[:, :1], inner, state[:, 1 + self.inner :]], dim=1)


class PositionAxis(Axis):
    """Command and demand are positions."""

    def __init__(
        self, dt: float, low: float, high: float, stage: CommandStage, sag_at: int, linkage: Linkage | None,
        columns: JointColumns,
    ) -> None:  # fmt: skip
        super().__init__(dt, low, high, stage.width, linkage, columns, sag_at)
        self.stage, self.servo = stage, True

    def demand(self, command: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        place, inner = self.stage(command, load, state[:, 1 : 1 + self.inner], theta, hold)
        return place, torch.cat([state[:, :1], inner, state[:, 1 + self.inner :]], dim=1)

    def move(self, demand: Tensor, state: Tensor) -> Tensor:
        return torch.cat([torch.clamp(demand, self.low, self.high)[:, None], state[:, 1:]], dim=1)


class ForceAxis(Axis):
    """The command is a force, the demand a mean speed."""

    def __init__(
        self, dt: float, low: float, high: float, rotor: RigidDrive, linkage: Linkage | None, columns: JointColumns
    ) -> None:  # fmt: skip
        super().__init__(dt, low, high, rotor.width, linkage, columns)
        self.rotor = rotor
        self.moving = torch.zeros_like(self.moving)  # motor, twist of its spring, load
        self.moving[0] = self.moving[-1] = 1.0

    def demand(self, command: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        if hold:
            return torch.zeros_like(command), state
        speed, inner = self.rotor(command, state[:, 1 : 1 + self.inner], theta)
        return speed, torch.cat([state[:, :1], inner, state[:, 1 + self.inner :]], dim=1)

    def move(self, demand: Tensor, state: Tensor) -> Tensor:
        """An end stop takes the speed towards it."""
        moved, speed = state[:, 0] + self.dt * demand, state[:, 1]
        speed = torch.where(moved > self.high, torch.clamp(speed, max=0.0), speed)
        speed = torch.where(moved < self.low, torch.clamp(speed, min=0.0), speed)
        return torch.cat([torch.clamp(moved, self.low, self.high)[:, None], speed[:, None], state[:, 2:]], dim=1)
