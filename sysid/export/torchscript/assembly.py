"""Plant → TorchScript module of its drive chain, with the parameters of its effects by name.

PyTorch deprecates TorchScript, which Isaac Lab loads: its warnings are not those of a user's mistake.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from sysid.effects import effect_named, stiction
from sysid.export.drive_data import EDGE, WITHOUT_PART, drive_data
from sysid.export.standalone.mechanical_parts import GRAVITY
from sysid.export.torchscript import command_parts, mechanical_parts
from sysid.export.torchscript.model import Axis, DriveModel, ForceAxis, JointColumns, PositionAxis, VelocityAxis
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.layout import signals_of, slot_indices
from sysid.plant.machine_arrays import GAIN, LENGTH, ORDER, PASSIVE, SHIFT

Array = npt.NDArray[np.float64]

_jit: Any = torch.jit


@contextmanager
def deprecation_known() -> Iterator[None]:
    """Without the warning that TorchScript is deprecated."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"`torch\.jit\..*", DeprecationWarning)
        yield


def scripted(module: torch.nn.Module) -> Any:
    """A module as a script."""
    with deprecation_known():
        return _jit.script(module.eval())


def save_script(module: Any, path: Path) -> None:
    """Write a script to a file."""
    with deprecation_known():
        _jit.save(module, str(path))


def load_script(path: Path) -> Any:
    """The script of a file, on the CPU."""
    with deprecation_known():
        return _jit.load(str(path), map_location="cpu")


#: Parts with further arguments are made one by one, the others by their class.
_COMMAND: dict[str, Any] = {
    "valve_hysteresis": command_parts.ValveHysteresis,
    "valve_deadband": command_parts.ValveDeadband,
    "gain_curve": command_parts.GainCurve,
    "flow_saturation": command_parts.FlowSaturation,
    "gain_error": command_parts.GainError,
    "asymmetric_gain": command_parts.AsymmetricGain,
    "temperature_drift": command_parts.TemperatureDrift,
    "load_dependent_flow": command_parts.LoadDependentFlow,
    "internal_leakage": command_parts.InternalLeakage,
    "oil_compressibility": command_parts.OilCompressibility,
    "second_order_lag": command_parts.SecondOrderLag,
}
#: The place of a spool's parameters among those of ``stiction``.
SPOOL_SLOT = [slot.name for slot in stiction.EFFECT.slots].index("spool_breakaway")
_FRICTION: dict[str, Any] = {
    "viscous_friction": mechanical_parts.ViscousFriction,
    "coulomb_friction": mechanical_parts.CoulombFriction,
    "stribeck_friction": mechanical_parts.StribeckFriction,
    "smooth_coulomb_friction": mechanical_parts.SmoothCoulombFriction,
}


def parameter_columns(plant: Plant) -> dict[str, int]:
    """``effect.target[.side].slot`` → its index in the plant's vector, for all effects that the drive model has."""
    found = {}
    for item in plant.effects:
        effect = effect_named(item.name)
        if effect.name not in WITHOUT_PART:
            place = ".".join(filter(None, (item.name, item.target, item.side)))
            for slot in effect.slots:
                index = slot_indices(plant.machine.axis_names, effect, item.target, item.side, slot.name)[0]
                found[f"{place}.{slot.name}"] = index
    return found


def script_of(plant: Plant, rate_hz: float, thetas: Array | None = None) -> Any:
    """The module, scripted, for steps of 1/``rate_hz``.

    Args:
        thetas: parameter vectors of the plant (count, N) that it must also run with: its longest delays.
    """
    module = _Assembly(plant, rate_hz, plant.vector()[None] if thetas is None else thetas).model()
    return scripted(module)


class _Assembly:
    """The columns of the parameters, and the parts that read them."""

    def __init__(self, plant: Plant, rate_hz: float, thetas: Array) -> None:
        self.plant, self.dt = plant, 1.0 / rate_hz
        self.data, self.compiled = drive_data(plant, rate_hz), compile_plant(plant)
        self.index = parameter_columns(plant)
        self.column = {name: k for k, name in enumerate(self.index)}
        self.longest = {name: float(thetas[:, at].max()) for name, at in self.index.items()}

    def at(self, effect: str, target: str, side: str | None = None) -> int:
        """Column of the first slot of an effect, −1 where the plant does not have it."""
        place = ".".join(filter(None, (effect, target, side)))
        return self.column.get(f"{place}.{effect_named(effect).slots[0].name}", -1)

    def model(self) -> DriveModel:
        theta = self.plant.vector()
        values = {name: float(theta[at]) for name, at in self.index.items()}
        names = [axis["name"] for axis in self.data["axes"]]
        pump = self.at("pump_flow_limit", "machine")
        made = [self.axis(axis) for axis in self.data["axes"]]
        return DriveModel(self.dt, names, values, made, pump, self.kinematics(self.compiled), self.sway(), self.readings())

    def axis(self, axis: dict[str, Any]) -> Axis:
        name, link = axis["name"], axis["linkage"]
        low, high = (math.copysign(math.inf, s) if axis[k] is None else axis[k] for k, s in (("low", -1.0), ("high", 1.0)))
        linkage = None if link is None else mechanical_parts.Linkage(link["low"], link["step"], link["joints"])
        sides = [self.at(effect, name, side) for effect in ("backlash", "joint_compliance") for side in ("drive", "structure")]
        columns = JointColumns(self.at("joint_offset", name), *sides)
        if axis["actuation"] == "force":
            return ForceAxis(self.dt, low, high, self.rotor(axis), linkage, columns)
        parts = [self.part(part, values, axis) for part, values in axis["command"]]
        stage = command_parts.CommandStage(parts)
        if axis["actuation"] == "velocity":
            return VelocityAxis(self.dt, low, high, stage, axis["gain"], axis["sense"], linkage, columns)
        kinds = [part for part, _ in axis["command"]]
        sag = -1
        if "second_order_lag" in kinds:
            sag = 1 + sum(part.width for part in parts[: kinds.index("second_order_lag")]) + 2
        return PositionAxis(self.dt, low, high, stage, sag, linkage, columns)

    def part(self, part: str, values: dict[str, Any], axis: dict[str, Any]) -> command_parts.Part:
        name = axis["name"]
        if part == "nominal_gain":
            return command_parts.NominalGain(self.dt, values["gain"])
        if part == "sticking_spool":
            return self.sticking_spool(values, axis)
        at = self.at(part, name)
        if part == "input_delay":
            return self.delay(name)
        if part == "first_order_lag":
            return command_parts.FirstOrderLag(self.dt, at, bool(values.get("at_end", False)))
        if part == "command_rate_limit":
            lag = self.at("first_order_lag", name) if "at_end" in values else -1
            return command_parts.CommandRateLimit(self.dt, at, "at_end" in values, lag)
        if part == "stiction":
            return command_parts.Stiction(self.dt, at, values["least"], values["gain"])
        made: command_parts.Part = _COMMAND[part](self.dt, at)
        return made

    def delay(self, name: str) -> command_parts.InputDelay:
        longest = self.longest.get(f"input_delay.{name}.delay", 0.0)
        return command_parts.InputDelay(self.dt, self.at("input_delay", name), math.floor(longest / self.dt + 1e-9) + 2)

    def sticking_spool(self, values: dict[str, Any], axis: dict[str, Any]) -> command_parts.StickingSpool:
        name = axis["name"]
        edges = [self.part(part, has, axis) for part, has in axis["command"] if part in EDGE]
        return command_parts.StickingSpool(
            self.dt,
            self.at("stiction", name) + SPOOL_SLOT,
            self.at("valve_deadband", name),
            stiction.REST,
            self.delay(name),
            command_parts.CommandRateLimit(self.dt, self.at("command_rate_limit", name)),
            command_parts.FirstOrderLag(self.dt, self.at("first_order_lag", name)),
            edges,
        )

    def rotor(self, axis: dict[str, Any]) -> mechanical_parts.RigidDrive:
        name = axis["name"]
        laws = [_FRICTION[law](self.at(law, name)) for law, _ in axis["frictions"]]
        inertia = float(self.compiled.arrays.axes[self.plant.machine.axis_names.index(name), GAIN])
        constant, ratio, bias = (self.at(effect, name) for effect in ("force_constant_error", "inertia_error", "load_bias"))
        common = (self.dt, inertia, constant, ratio, bias, laws)
        if axis["rotor"] == "rigid_drive":
            return mechanical_parts.RigidDrive(*common)
        spring = axis["spring"]
        count = max(1, math.ceil(2.0 * math.pi * spring["frequency"] * math.sqrt(1.0 + spring["inertia_ratio"]) * self.dt))
        return mechanical_parts.FlexibleDrive(*common, self.at("flexible_drive", name), count)

    def kinematics(self, model: Model) -> mechanical_parts.Kinematics | None:
        data, links = self.data["kinematics"], model.arrays.links
        if data is None:
            return None
        steps = []
        for j in range(len(links)):
            step = {"shift": links[j, SHIFT : SHIFT + 3].tolist(), "length_at": -1, "length": 1.0}
            if j > 0 and links[j - 1, PASSIVE] == 0.0 and links[j, LENGTH] > 1e-9:
                owner = self.plant.machine.axis_names[int(links[j - 1, ORDER])]
                step |= {"length_at": self.at("link_length_error", owner), "length": float(links[j, LENGTH])}
            steps.append((data["joints"][j] if j < len(data["joints"]) else {}) | step)
        return mechanical_parts.Kinematics(
            steps[:-1], steps[-1], self.at("tip_offset", "ee"), self.at("base_misalignment", "base")
        )

    def sway(self) -> mechanical_parts.GripperSway | None:
        sway = self.data["sway"]
        if sway is None:
            return None
        rate = math.sqrt(GRAVITY / sway["length"])
        return mechanical_parts.GripperSway(self.dt, self.at("gripper_sway", "tool"), max(1, math.ceil(self.dt * rate / 0.1)))

    def readings(self) -> dict[str, tuple[str, list[int]]]:
        names, posed = self.plant.machine.axis_names, self.data["kinematics"] is not None
        found = {}
        for signal in signals_of(names):
            owner, kind = signal.split(".")
            if owner in ("ee", "tool"):
                place = (owner, "xyz".index(kind)) if posed else None
            else:
                k = names.index(owner)
                place = ("joints", k) if kind == "joint" else ("drive", k) if kind == self.data["axes"][k]["drives"] else None
            if place is not None:
                sensors = [self.at(f"sensor_{what}", signal) for what in ("scale", "bias", "quantisation")]
                found[signal] = (place[0], [place[1], *sensors])
        return found
