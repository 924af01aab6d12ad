"""The plant, step by step: commands of all axes → drives, joints, end effector and tool.

After ``reset`` the state is that of sample 0; a step with the commands of sample k leads to sample k + 1 (position axes: with
the command of sample k + 1). Units are SI.

:func:`assemble` makes the model from its data (JSON).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects.joint_compliance import step as joint_compliance_step
from sysid.effects.pump_flow_limit import share as pump_flow_limit_share
from sysid.export.standalone.parts import (
    REMEMBERED,
    SPEED,
    Backlash,
    GripperSway,
    Kinematics,
    Linkage,
    Part,
    SensorReading,
    axis_parameters,
)
from sysid.plant.chain import force_stage as chain_force_stage

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """The machine at one sample.

    Args:
        drive: what the commands move, cylinder [m] or joint [rad or m], (A,).
        joints: at the joint sensors; ``structure``: behind the backlash and offset of the sensors, (A,) [rad or m].
        ee, tool: end effector and hanging tool in the measured frame, (3,) [m]; NaN without kinematics.
        load: gravity load on every joint, (A,) [N·m or N].
    """

    drive: Array
    joints: Array
    structure: Array
    ee: Array
    tool: Array
    load: Array


class Drive:
    """What a command moves: its position, between end stops."""

    def __init__(self, dt: float, low: float | None, high: float | None) -> None:
        self.dt, self.low, self.high = dt, -math.inf if low is None else low, math.inf if high is None else high
        self.position = math.nan

    def begin(self, position: float, speed: float) -> None:
        self.position = min(max(position, self.low), self.high)

    def hold(self, command: float, load: float) -> None:
        """The command was held for a long time before the first step."""

    def demand(self, command: float, load: float) -> float:
        raise NotImplementedError

    def move(self, demand: float) -> None:
        self.position = min(max(self.position + self.dt * demand, self.low), self.high)


class ChainDrive(Drive):
    """The command passes through ``parts``; ``values``: their outputs in the last step, ``sense``: sign of the load."""

    def __init__(self, dt: float, low: float | None, high: float | None, parts: list[Part], sense: float = 1.0) -> None:
        super().__init__(dt, low, high)
        self.parts, self.sense = parts, sense
        self.values: list[float] = []

    def begin(self, position: float, speed: float) -> None:
        super().begin(position, speed)
        for part in self.parts:
            part.reset()

    def hold(self, command: float, load: float) -> None:
        self.values = []
        for part in self.parts:
            command = part.hold(command, self.sense * load)
            self.values.append(command)

    def demand(self, command: float, load: float) -> float:
        self.values = []
        for part in self.parts:
            command = part.step(command, self.sense * load)
            self.values.append(command)
        return command


class VelocityDrive(ChainDrive):
    """The command is an opening, the demand a mean speed. ``sense``: −1 where the joint falls as the drive extends."""

    def __init__(self, dt: float, low: float | None, high: float | None, parts: list[Part], gain: float, sense: float) -> None:
        super().__init__(dt, low, high, parts, sense)
        self.gain = gain


class PositionDrive(ChainDrive):
    """Command and demand are positions."""

    def move(self, demand: float) -> None:
        self.position = min(max(demand, self.low), self.high)


class ForceDrive(Drive):
    """The command is a force, the demand a mean speed: of one mass [kg or kg·m²], or of motor and load on a spring.

    ``effects``: friction, constant load and spring, each with its numbers.
    """

    def __init__(
        self, dt: float, low: float | None, high: float | None, mass: float, effects: dict[str, dict[str, float]]
    ) -> None:  # fmt: skip
        super().__init__(dt, low, high)
        self.mass, self.p = mass, axis_parameters(effects)

    def begin(self, position: float, speed: float) -> None:
        super().begin(position, speed)
        self.s = [math.nan] * REMEMBERED
        self.s[SPEED] = speed

    def demand(self, command: float, load: float) -> float:
        return float(chain_force_stage(command, self.p, 0, self.s, 0, self.mass, self.dt))

    def move(self, demand: float) -> None:
        moved = self.position + self.dt * demand
        super().move(demand)
        if moved > self.high:
            self.s[SPEED] = min(self.s[SPEED], 0.0)
        elif moved < self.low:
            self.s[SPEED] = max(self.s[SPEED], 0.0)


@dataclass
class Axis:
    """Drive, linkage and joint of one axis; compliances in rad/(N·m) or m/N, ``offset`` in rad or m."""

    drive: Drive
    linkage: Linkage | None
    drive_backlash: Backlash
    structure_backlash: Backlash
    drive_compliance: float
    structure_compliance: float
    offset: float
    servo: Any  # the second-order lag of a position axis, through which its sag follows the load, or None

    def joint(self, load: float) -> float:
        x = self.drive.position if self.linkage is None else self.linkage.joint(self.drive.position)
        deflecting = load if self.servo is None else self.servo.sag_load(load)
        return float(joint_compliance_step(self.drive_backlash.step(x), [self.drive_compliance], 0, deflecting))

    def structure(self, joint: float, load: float) -> float:
        q = self.structure_backlash.step(joint) + self.offset
        return float(joint_compliance_step(q, [self.structure_compliance], 0, load))


class DriveModel:
    """All axes of a machine.

    Args:
        dt: length of a sample [s].
        names: of the axes; ``signals``: what their commands move.
        pump_limit: largest sum over the velocity axes of |speed|/gain; infinite without one.
        sensors: signal → its reading; other signals are ideal.
    """

    #: Steps in which a machine at rest settles under the load of its deflected posture.
    SETTLING = 20

    def __init__(
        self, dt: float, names: list[str], signals: list[str], axes: list[Axis], pump_limit: float,
        kinematics: Kinematics | None, sway: GripperSway | None, sensors: dict[str, SensorReading],
    ) -> None:  # fmt: skip
        self.dt, self.names, self.signals, self.axes, self.pump_limit = dt, names, signals, axes, pump_limit
        self.kinematics, self.sway, self.sensors = kinematics, sway, sensors
        self.load = np.zeros(len(axes))

    def reset(
        self, joints: Any, drive: Any = None, commands: Any = None, speed: Any = None, load: Any = None
    ) -> State:  # fmt: skip
        """Put the machine at rest and return its state.

        Args:
            joints: at the sensors (A,) [rad or m].
            drive: positions of the drives (A,); else those of the joints, in the middle of a backlash.
            commands: held for a long time before (A,), zero by default; those of position axes are their positions.
            speed: of force axes (A,), zero by default.
            load: gravity loads (A,) where a simulator knows them better.
        """
        straight, zeros = self._without_sag(np.array(joints, dtype=np.float64)), np.zeros(len(self.axes))
        held, speeds = zeros if commands is None else np.asarray(commands), zeros if speed is None else np.asarray(speed)
        for i, axis in enumerate(self.axes):
            inverse = straight[i] if axis.linkage is None else axis.linkage.displacement(float(straight[i]))
            axis.drive.begin(float(inverse if drive is None else drive[i]), float(speeds[i]))
            axis.drive_backlash.reset(float(straight[i]))
            axis.structure_backlash.reset(math.nan)
        if self.sway is not None:
            self.sway.reset()
        self.load = zeros if load is None else np.array(load, dtype=np.float64)
        soft = any(axis.drive_compliance or axis.structure_compliance for axis in self.axes)
        for _ in range(self.SETTLING if soft and load is None else 1):  # until the machine rests under the load of its posture
            self._place(load)
            for axis in self.axes:
                axis.structure_backlash.reset(math.nan)
        state = self._state(load)
        for i, axis in enumerate(self.axes):
            command = axis.drive.position if isinstance(axis.drive, PositionDrive) else float(held[i])
            axis.drive.hold(command, float(self.load[i]))
        return state

    def step(self, commands: Any, load: Any = None) -> State:
        """Hold ``commands`` (A,) for one step and return the state after it."""
        demands = [axis.drive.demand(float(commands[i]), float(self.load[i])) for i, axis in enumerate(self.axes)]
        flow = sum(abs(d) / a.drive.gain for d, a in zip(demands, self.axes, strict=True) if isinstance(a.drive, VelocityDrive))
        share = pump_flow_limit_share(flow, [self.pump_limit], 0)
        for demand, axis in zip(demands, self.axes, strict=True):
            axis.drive.move(share * demand if isinstance(axis.drive, VelocityDrive) else demand)
        return self._state(load)

    def readings(self, state: State) -> dict[str, float]:
        """Signals as their sensors read them: ``<axis>.cylinder``, ``<axis>.joint``, ``ee.x`` …, ``tool.x`` …."""
        found = {signal: float(state.drive[i]) for i, signal in enumerate(self.signals)}
        found |= {f"{name}.joint": float(state.joints[i]) for i, name in enumerate(self.names)}
        for point, place in (("ee", state.ee), ("tool", state.tool)):
            found |= {f"{point}.{axis}": float(place[k]) for k, axis in enumerate("xyz") if not math.isnan(place[k])}
        return {name: self.sensors[name].read(value) if name in self.sensors else value for name, value in found.items()}

    def _place(self, load: Any) -> tuple[Array, Array, Array]:
        """Joints and structure (A,) and tip (3,) of the drives' positions; the load there is kept for the next step."""
        before = [float(value) for value in self.load]
        joints = np.array([axis.joint(before[i]) for i, axis in enumerate(self.axes)])
        structure = np.array([axis.structure(float(joints[i]), before[i]) for i, axis in enumerate(self.axes)])
        tip = np.full(3, np.nan)
        if self.kinematics is not None:
            tip, self.load = self.kinematics.pose(structure.tolist())
        if load is not None:
            self.load = np.array(load, dtype=np.float64)
        return joints, structure, tip

    def _state(self, load: Any) -> State:
        joints, structure, tip = self._place(load)
        drive = np.array([axis.drive.position for axis in self.axes])
        return State(drive, joints, structure, tip, tip if self.sway is None else self.sway.step(tip), self.load.copy())

    def _without_sag(self, joints: Array) -> Array:
        """Joints without the sag of their drives."""
        compliance = np.array([axis.drive_compliance for axis in self.axes])
        if self.kinematics is None or not compliance.any():
            return joints
        structure, load = np.array([axis.structure_compliance for axis in self.axes]), np.zeros(len(joints))
        offset = np.array([axis.offset for axis in self.axes])
        for _ in range(self.SETTLING if structure.any() else 1):
            load = self.kinematics.pose((joints + offset - structure * load).tolist())[1]
        return joints + compliance * load


def assemble(data: dict[str, Any], parts: dict[str, Any]) -> DriveModel:
    """The model that ``data`` describes; ``parts``: name → class of its effects."""
    dt, names = data["dt"], [axis["name"] for axis in data["axes"]]
    signals = [f"{axis['name']}.{axis['drives']}" for axis in data["axes"]]
    kinematics = None if data["kinematics"] is None else Kinematics(**data["kinematics"])
    sway = None if data["sway"] is None else GripperSway(dt, **data["sway"])
    sensors = {signal: SensorReading(**values) for signal, values in data["sensors"].items()}
    limit = math.inf if data["pump_limit"] is None else data["pump_limit"]
    axes = [_axis(dt, axis, parts) for axis in data["axes"]]
    return DriveModel(dt, names, signals, axes, limit, kinematics, sway, sensors)


def _axis(dt: float, axis: dict[str, Any], parts: dict[str, Any]) -> Axis:
    command = [parts[name](dt, **values) for name, values in axis["command"]]
    servo = next((part for part in command if hasattr(part, "sag_load")), None)
    linkage = None if axis["linkage"] is None else Linkage(**axis["linkage"])
    return Axis(
        _drive(dt, axis, command, parts),
        linkage,
        Backlash(axis["drive_backlash"]),
        Backlash(axis["structure_backlash"]),
        axis["drive_compliance"],
        axis["structure_compliance"],
        axis["offset"],
        servo,
    )


def _drive(dt: float, axis: dict[str, Any], command: list[Any], parts: dict[str, Any]) -> Drive:
    ends = axis["low"], axis["high"]
    if axis["actuation"] == "velocity":
        return VelocityDrive(dt, *ends, command, axis["gain"], axis["sense"])
    if axis["actuation"] == "position":
        return PositionDrive(dt, *ends, command)
    effects = {**dict(axis["frictions"]), "load_bias": {"force": axis["bias"]}}
    if axis["rotor"] == "flexible_drive":
        effects["flexible_drive"] = axis["spring"]
    return ForceDrive(dt, *ends, axis["mass"], effects)
