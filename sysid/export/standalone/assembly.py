"""Data of a drive model (JSON) → the model."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from sysid.export.standalone.joint_parts import Backlash, GripperSway, Kinematics, Linkage, SensorReading
from sysid.export.standalone.model import Axis, Drive, DriveModel, ForceDrive, PositionDrive, VelocityDrive


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


def read_model(path: str | Path, parts: dict[str, Any]) -> DriveModel:
    """The model of a JSON file."""
    return assemble(json.loads(Path(path).read_text("utf-8")), parts)


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
    frictions = [parts[name](**values) for name, values in axis["frictions"]]
    rotor = parts[axis["rotor"]](dt, axis["mass"], axis["bias"], frictions, **axis["spring"])
    return ForceDrive(dt, *ends, rotor)
