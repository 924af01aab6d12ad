"""The shipped drive model: one Python file that needs NumPy alone and contains the parts of one plant, and its data."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from sysid.export.drive_data import SPOOL
from sysid.export.standalone import assembly, command_parts, force_parts, joint_parts, model, oscillator
from sysid.files import json_text

#: Names of the two files.
MODULE, DATA = "drive_model.py", "drive_model.json"
#: Name in the data → class.
PARTS: Mapping[str, Any] = {
    "valve_hysteresis": command_parts.ValveHysteresis,
    "valve_deadband": command_parts.ValveDeadband,
    "gain_curve": command_parts.GainCurve,
    "flow_saturation": command_parts.FlowSaturation,
    "input_delay": command_parts.InputDelay,
    "command_rate_limit": command_parts.CommandRateLimit,
    "first_order_lag": command_parts.FirstOrderLag,
    "sticking_spool": command_parts.StickingSpool,
    "gain_error": command_parts.GainError,
    "asymmetric_gain": command_parts.AsymmetricGain,
    "temperature_drift": command_parts.TemperatureDrift,
    "load_dependent_flow": command_parts.LoadDependentFlow,
    "nominal_gain": command_parts.NominalGain,
    "internal_leakage": command_parts.InternalLeakage,
    "stiction": command_parts.Stiction,
    "oil_compressibility": command_parts.OilCompressibility,
    "second_order_lag": command_parts.SecondOrderLag,
    "viscous_friction": force_parts.ViscousFriction,
    "coulomb_friction": force_parts.CoulombFriction,
    "stribeck_friction": force_parts.StribeckFriction,
    "smooth_coulomb_friction": force_parts.SmoothCoulombFriction,
    "rigid_drive": force_parts.RigidDrive,
    "flexible_drive": force_parts.FlexibleDrive,
}
#: Frame of the model, in the order in which its classes refer to each other.
_FRAME = (
    joint_parts.Linkage, joint_parts.Backlash, joint_parts.Kinematics, joint_parts.turned, joint_parts.SensorReading,
    joint_parts.GripperSway, model.State, model.Drive, model.ChainDrive, model.VelocityDrive, model.PositionDrive,
    model.ForceDrive, model.Axis, model.DriveModel, assembly.assemble, assembly._axis, assembly._drive,
)  # fmt: skip

#: Names of the machine, its plant and its axes are in the data alone: no text of a file becomes source code.
_HEAD = '''"""Drive model of the machine of {data}: commands → drives, joints, end effector and tool. Needs NumPy alone.

>>> model = load("{data}")
>>> state = model.reset(joints)          # joints at the sensors, (A,) [rad or m]
>>> state = model.step(commands)         # every {dt!r} s; commands (A,) as in machine.toml
>>> model.readings(state)                # signals as the sensors read them

Axes are in the order of ``model.names``. SI units; the base frame of the URDF, gravity along −z.
"""

from __future__ import annotations

import json
import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
#: Standard gravity [m/s²], along −z of the base.
GRAVITY = {gravity}
'''

_TAIL = '''#: Name in the data → class.
PARTS = {{
{parts}
}}


def load(path: str | Path = Path(__file__).with_name("{data}")) -> DriveModel:
    """The model of a data file; by default that beside this file."""
    return assemble(json.loads(Path(path).read_text("utf-8")), PARTS)
'''


def module_text(data: Mapping[str, Any]) -> str:
    """The module for :func:`sysid.export.drive_data.drive_data`, with the parts that these data name."""
    used = used_parts(data)
    classes: list[Any] = [oscillator.oscillation, command_parts.Part, force_parts.Friction, force_parts.RigidDrive]
    classes += [PARTS[name] for name in PARTS if name in used and PARTS[name] not in classes]
    absent = _absent(data)
    head = _HEAD.format(data=DATA, dt=float(data["dt"]), gravity=joint_parts.GRAVITY)
    tail = _TAIL.format(parts="\n".join(f'    "{name}": {PARTS[name].__name__},' for name in PARTS if name in used), data=DATA)
    sources = (inspect.getsource(entry) for entry in [*classes, *_FRAME] if entry not in absent)
    return "\n\n".join([head, *sources, tail])


def _absent(data: Mapping[str, Any]) -> set[Any]:
    """Classes that these data do not need."""
    absent: set[Any] = set()
    if data["sway"] is None:
        absent.add(joint_parts.GripperSway)
    if data["kinematics"] is None:
        absent |= {joint_parts.Kinematics, joint_parts.turned}
    if all(axis["linkage"] is None for axis in data["axes"]):
        absent.add(joint_parts.Linkage)
    if all(axis["actuation"] != "force" for axis in data["axes"]):
        absent |= {model.ForceDrive, force_parts.Friction, force_parts.RigidDrive}
    if not used_parts(data) & {"oil_compressibility", "second_order_lag", "flexible_drive"}:
        absent.add(oscillator.oscillation)
    return absent


def used_parts(data: Mapping[str, Any]) -> set[str]:
    """Names of the parts of the data."""
    used = {name for axis in data["axes"] for name, _ in axis["command"]}
    used |= set(SPOOL) if "sticking_spool" in used else set()
    for axis in data["axes"]:
        if axis["actuation"] == "force":
            used |= {axis["rotor"], *(name for name, _ in axis["frictions"])}
    return used


def data_text(data: Mapping[str, Any]) -> str:
    """The data as JSON."""
    return json_text(data)
