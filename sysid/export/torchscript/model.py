"""The machine: commands of all axes → drives, joints, end effector and tool, for a batch of N machines.

An axis moves between end stops, with linkage, backlash and compliance of the joint. Its state: position of the drive, state of
its drive, output of the backlash before and behind the joint's sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from sysid.export.torchscript.command_parts import CommandStage, parameter
from sysid.export.torchscript.mechanical_parts import GripperSway, Kinematics, Linkage, RigidDrive, backlash

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


Signals = dict[str, Tensor]
#: Steps in which a machine at rest settles under the load of its deflected posture.
SETTLING = 20


class DriveModel(nn.Module):
    """All axes of a machine.

    Args:
        parameters: names (``effect.target[.side].slot``) and values (P,) of the parameters of one machine.
        pump_at: column of the limit of the pump, −1 for none.
        readings: signal → its source (``drive``, ``joints``, ``ee``, ``tool``), its column there, and the columns of scale,
            bias and step of its sensor, −1 for an ideal one.
    """

    def __init__(
        self, dt: float, names: list[str], parameters: dict[str, float], axes: list[Axis], pump_at: int,
        kinematics: Kinematics | None, sway: GripperSway | None, readings: dict[str, tuple[str, list[int]]],
    ) -> None:  # fmt: skip
        super().__init__()
        self.dt, self.names, self.count = dt, names, len(axes)
        self.parameter_names = [*parameters, "none"]
        self.register_buffer("values", torch.tensor([*parameters.values(), 0.0], dtype=torch.float64))
        self.values: Tensor
        self.axes: Any = nn.ModuleList(axes)
        self.pump_at = pump_at
        self.posed, self.kinematics = kinematics is not None, kinematics or _no_kinematics(len(axes))
        self.swings, self.sway = sway is not None, sway or GripperSway(dt, 0, 1)
        soft = any(axis.drive_compliance_at >= 0 or axis.structure_compliance_at >= 0 for axis in axes)
        self.settling = SETTLING if soft else 1
        self.signals = list(readings)
        self.sources, self.columns = [source for source, _ in readings.values()], [at for _, at in readings.values()]
        self.inner = sum(axis.width for axis in axes)
        self.width = self.inner + len(axes) + 10

    @torch.jit.export
    def theta(self, count: int) -> Tensor:
        """The parameters of ``count`` machines (N, P), all those of the plant; the last column is not used."""
        return self.values[None].repeat(count, 1)

    @torch.jit.export
    def drives(self, theta: Tensor, joints: Tensor) -> Tensor:
        """Positions of the drives (N, A) for joints at their sensors (N, A)."""
        straight = self.without_sag(theta, joints)
        found: list[Tensor] = []
        for k, axis in enumerate(self.axes):
            found.append(axis.inverse(straight[:, k]))
        return torch.stack(found, dim=1)

    @torch.jit.export
    def begin(
        self, theta: Tensor, joints: Tensor, drives: Tensor, commands: Tensor, speeds: Tensor | None = None
    ) -> tuple[Tensor, Signals]:  # fmt: skip
        """Joints at their sensors, drives, the commands held for a long time before, and speeds of force axes, (N, A) each.

        Without ``speeds`` they are at rest.
        """
        moving = torch.zeros_like(drives) if speeds is None else speeds
        straight = self.without_sag(theta, joints)
        rows: list[Tensor] = []
        for k, axis in enumerate(self.axes):
            rows.append(axis.begin(drives[:, k], straight[:, k], moving[:, k]))
        state = torch.cat(
            [torch.cat(rows, dim=1), torch.zeros_like(joints), joints.new_full((joints.shape[0], 10), math.nan)], dim=1
        )
        load = torch.zeros_like(joints)
        for _ in range(self.settling):  # until the machine rests under the load of its posture
            settled, _ = self.place(torch.cat([state[:, : self.inner], load, state[:, -10:]], dim=1), theta)
            load = settled[:, self.inner : self.inner + self.count]
        state, signals = self.place(torch.cat([state[:, : self.inner], load, state[:, -10:]], dim=1), theta)
        state = torch.cat([self.demands(commands, state, theta, True)[1], state[:, self.inner :]], dim=1)
        return state, signals

    def forward(self, theta: Tensor, state: Tensor, commands: Tensor) -> tuple[Tensor, Signals]:
        """Hold ``commands`` (N, A) for one sample: the state after it, and the signals.

        Signals: ``drive``, ``joints`` at their sensors, ``structure`` behind them, ``load`` (N, A); ``ee``, ``tool`` (N, 3) in
        the measured frame, NaN without kinematics.
        """
        demands, inner = self.demands(commands, state, theta, False)
        flow = torch.zeros_like(demands[0])
        for k, axis in enumerate(self.axes):
            if not math.isinf(axis.gain):
                flow = flow + torch.abs(demands[k]) / axis.gain
        limit = parameter(theta, self.pump_at, math.inf)
        share = torch.where(flow > limit, limit / torch.where(flow > limit, flow, torch.ones_like(flow)), torch.ones_like(flow))
        rows: list[Tensor] = []
        first = 0
        for k, axis in enumerate(self.axes):
            demand = demands[k] if math.isinf(axis.gain) else share * demands[k]
            rows.append(axis.move(demand, inner[:, first : first + axis.width]))
            first += axis.width
        return self.place(torch.cat([torch.cat(rows, dim=1), state[:, self.inner :]], dim=1), theta)

    @torch.jit.export
    def readings(self, theta: Tensor, signals: Signals) -> Signals:
        """Signals as their sensors read them, (N,) each: ``<axis>.cylinder``, ``<axis>.joint``, ``ee.x`` …, ``tool.x`` …."""
        found: dict[str, Tensor] = {}
        for k in range(len(self.signals)):
            at = self.columns[k]
            y = signals[self.sources[k]][:, at[0]]
            y = parameter(theta, at[1], 1.0) * y + parameter(theta, at[2], 0.0)
            step = parameter(theta, at[3], 0.0)
            even = torch.where(step > 0.0, step, torch.ones_like(step))
            found[self.signals[k]] = torch.where(step > 0.0, even * torch.floor(y / even + 0.5), y)
        return found

    def demands(self, commands: Tensor, state: Tensor, theta: Tensor, hold: bool) -> tuple[list[Tensor], Tensor]:
        """Demand of each axis (N,), and the state of the axes."""
        demands: list[Tensor] = []
        rows: list[Tensor] = []
        first = 0
        for k, axis in enumerate(self.axes):
            own = state[:, first : first + axis.width]
            command = own[:, 0] if hold and axis.servo else commands[:, k]
            demand, after = axis.demand(command, state[:, self.inner + k], own, theta, hold)
            demands.append(demand)
            rows.append(after)
            first += axis.width
        return demands, torch.cat(rows, dim=1)

    def place(self, state: Tensor, theta: Tensor) -> tuple[Tensor, Signals]:
        """Joints, end effector and tool of the drives' positions; the load there is kept for the next step."""
        before = state[:, self.inner : self.inner + self.count]
        drives: list[Tensor] = []
        joints: list[Tensor] = []
        structures: list[Tensor] = []
        rows: list[Tensor] = []
        first = 0
        for k, axis in enumerate(self.axes):
            own = state[:, first : first + axis.width]
            joint, own = axis.joint(before[:, k], own, theta)
            structure, own = axis.structure(joint, before[:, k], own, theta)
            drives.append(own[:, 0])
            joints.append(joint)
            structures.append(structure)
            rows.append(own)
            first += axis.width
        q = torch.stack(structures, dim=1)
        load, ee, hanging = before, q.new_full((q.shape[0], 3), math.nan), state[:, -10:]
        if self.posed:
            ee, load = self.kinematics(q, theta)
        tool = ee
        if self.swings:
            tool, hanging = self.sway(ee, hanging, theta)
        found = {"drive": torch.stack(drives, dim=1), "joints": torch.stack(joints, dim=1), "structure": q, "load": load}
        found["ee"] = ee
        found["tool"] = tool
        return torch.cat([torch.cat(rows, dim=1), load, hanging], dim=1), found

    def without_sag(self, theta: Tensor, joints: Tensor) -> Tensor:
        """Joints without the sag of their drives."""
        if not self.posed:
            return joints
        compliances: list[Tensor] = []
        structures: list[Tensor] = []
        offsets: list[Tensor] = []
        for axis in self.axes:
            compliances.append(parameter(theta, axis.drive_compliance_at, 0.0))
            structures.append(parameter(theta, axis.structure_compliance_at, 0.0))
            offsets.append(parameter(theta, axis.offset_at, 0.0))
        compliance, structure = torch.stack(compliances, dim=1), torch.stack(structures, dim=1)
        straight, load = joints + torch.stack(offsets, dim=1), torch.zeros_like(joints)
        for _ in range(self.settling):
            load = self.kinematics(straight - structure * load, theta)[1]
        return joints + compliance * load


def _no_kinematics(axes: int) -> Kinematics:
    """A stand-in that is never called: every submodule of a script has a value."""
    none = {
        "rotation": [[0.0] * 3] * 3,
        "axis": [0.0] * 3,
        "centre": [0.0] * 3,
        "shift": [0.0] * 3,
        "length_at": -1,
        "length": 1.0,
    }
    joint = {**none, "prismatic": False, "axis_index": axes - 1, "ratio": 1.0, "offset": 0.0, "mass": 0.0}
    return Kinematics([joint], none, -1, -1)
