"""The files that are shipped with an export: the drive model, one Python file that needs NumPy alone and contains the parts of
one plant, its data, and ``effects.csv``, every number of the effects of a plant, for formats that have no place for them.

Shipped Python files are executed from where they were written.
"""

from __future__ import annotations

import csv
import importlib.util
import inspect
import sys
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects.units import parameter_unit
from sysid.export.drive_data import SPOOL, drive_data
from sysid.export.standalone import command_parts, mechanical_parts, model
from sysid.export.target import Start
from sysid.files import json_text
from sysid.plant import Plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

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
    "viscous_friction": mechanical_parts.ViscousFriction,
    "coulomb_friction": mechanical_parts.CoulombFriction,
    "stribeck_friction": mechanical_parts.StribeckFriction,
    "smooth_coulomb_friction": mechanical_parts.SmoothCoulombFriction,
    "rigid_drive": mechanical_parts.RigidDrive,
    "flexible_drive": mechanical_parts.FlexibleDrive,
}
#: Frame of the model, in the order in which its classes refer to each other.
_FRAME = (
    mechanical_parts.Linkage, mechanical_parts.Backlash, mechanical_parts.Kinematics, mechanical_parts.turned,
    mechanical_parts.SensorReading, mechanical_parts.GripperSway, model.State, model.Drive, model.ChainDrive,
    model.VelocityDrive, model.PositionDrive, model.ForceDrive, model.Axis, model.DriveModel, model.assemble, model._axis,
    model._drive,
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
    classes: list[Any] = [command_parts.oscillation, command_parts.Part, mechanical_parts.Friction, mechanical_parts.RigidDrive]
    classes += [PARTS[name] for name in PARTS if name in used and PARTS[name] not in classes]
    absent = _absent(data)
    head = _HEAD.format(data=DATA, dt=float(data["dt"]), gravity=mechanical_parts.GRAVITY)
    tail = _TAIL.format(parts="\n".join(f'    "{name}": {PARTS[name].__name__},' for name in PARTS if name in used), data=DATA)
    sources = (inspect.getsource(entry) for entry in [*classes, *_FRAME] if entry not in absent)
    return "\n\n".join([head, *sources, tail])


def _absent(data: Mapping[str, Any]) -> set[Any]:
    """Classes that these data do not need."""
    absent: set[Any] = set()
    if data["sway"] is None:
        absent.add(mechanical_parts.GripperSway)
    if data["kinematics"] is None:
        absent |= {mechanical_parts.Kinematics, mechanical_parts.turned}
    if all(axis["linkage"] is None for axis in data["axes"]):
        absent.add(mechanical_parts.Linkage)
    if all(axis["actuation"] != "force" for axis in data["axes"]):
        absent |= {model.ForceDrive, mechanical_parts.Friction, mechanical_parts.RigidDrive}
    if not used_parts(data) & {"oil_compressibility", "second_order_lag", "flexible_drive"}:
        absent.add(command_parts.oscillation)
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


def write_drive_model(plant: Plant, rate_hz: float, folder: Path) -> tuple[str, str]:
    """Write the drive model of a plant; returns the names of its two files."""
    data = drive_data(plant, rate_hz)
    (folder / MODULE).write_text(module_text(data), "utf-8")
    (folder / DATA).write_text(data_text(data), "utf-8")
    return MODULE, DATA


def load_module(path: Path) -> Any:
    """A Python file as a module under a name of its own."""
    name = f"sysid_export_{path.stem}_{uuid.uuid4().hex[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their annotations up there
    spec.loader.exec_module(module)
    return module


class DriveModelSimulation:
    """The shipped drive model as the simulation of an export."""

    def __init__(self, plant: Plant, model: Any) -> None:
        self.plant, self.model = plant, model

    def reset(self, start: Start) -> Mapping[str, float]:
        return true_signals(self.plant, self.model.reset(start.joints, start.drive, start.commands, start.speeds))

    def step(self, commands: Array) -> Mapping[str, float]:
        return true_signals(self.plant, self.model.step(commands))


def true_signals(plant: Plant, state: Any) -> dict[str, float]:
    """Signals of a state of the drive model, without sensors."""
    found = {}
    for i, axis in enumerate(plant.machine.axes):
        found[axis.driven] = float(state.drive[i])
        if axis.drives == "joint" or axis.name in plant.linkages:
            found[axis_signal(axis.name, "joint")] = float(state.joints[i])
    for point in ("ee", "tool"):
        for k, signal in enumerate(point_signals(point)):
            found[signal] = float(getattr(state, point)[k])
    return {signal: value for signal, value in found.items() if np.isfinite(value)}


EFFECTS = "effects.csv"


def write_effect_table(plant: Plant, folder: Path) -> str:
    """Write the table; returns its name."""
    with (folder / EFFECTS).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("effect", "target", "side", "parameter", "component", "value", "unit"))
        for item in plant.effects:
            for name, value in item.parameters.items():
                unit = parameter_unit(item.name, name, item.target, plant.machine)
                for k, number in enumerate(np.atleast_1d(np.asarray(value, dtype=np.float64))):
                    writer.writerow((item.name, item.target, item.side or "", name, k, repr(float(number)), unit))
    return EFFECTS
