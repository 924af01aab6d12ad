"""``isaaclab``: the drive model as a TorchScript module, with the actuator, articulation and event of Isaac Lab that run it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_data import drive_data
from sysid.export.names import MachineNames, Names, identifier
from sysid.export.posterior import indices_of, posterior
from sysid.export.target import Simulation, Support, Target
from sysid.export.urdf import COMPOSED, FIXED_WORLD, urdf_names, urdf_of, urdf_simulation, xml_text
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
FILE, ABOUT, MODEL, URDF = "isaaclab_machine.py", "isaaclab_machine.json", "drive_model.pt", "robot.urdf"


class IsaacLabTarget(Target):
    """Isaac Lab 2.x."""

    name = "isaaclab"
    title = "TorchScript for Isaac Lab"
    modules = ("torch", "mujoco")
    composed: Mapping[str, str] = {effect: f"`{URDF}`: {how}" for effect, how in COMPOSED.items()}
    notes = (
        f"Isaac Lab was not run here. `{FILE}` follows the documentation of Isaac Lab 2.x (actuators, events, URDF assets).",
        f"For the replay `{MODEL}` is loaded and moves the joints, and MuJoCo reads `{URDF}` and computes the end effector.",
        "The module is batched: its state and its parameters, a row for each environment, are inputs. It computes in float64.",
        "Events draw whole rows of `posterior_samples.csv`. The geometry of the asset is the same in every environment.",
    )

    def names(self, plant: Plant) -> MachineNames:
        """Those of USD, into which Isaac Lab converts the URDF."""
        return urdf_names(plant, Names([FIXED_WORLD], identifier), Names(form=identifier))

    def otherwise(self, effect: Effect) -> Support:
        return Support("plugin", f"`{MODEL}`, which the drives of the joints follow")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        from sysid.export.torchscript.model import parameter_columns, save_script, script_of

        data, written = drive_data(plant, rate_hz), self.names(plant)
        names = list(parameter_columns(plant))
        save_script(script_of(plant, rate_hz, reachable(plant)), folder / MODEL)
        about = {
            "plant": plant.reference,
            "sample": 1.0 / rate_hz,
            "axes": [
                {
                    "axis": axis.name,
                    "joint": written.joint(axis.name),
                    "actuation": axis.actuation,
                    "offset": values["offset"],
                    "offset_column": names.index(name) if (name := f"joint_offset.{axis.name}.offset") in names else -1,
                }
                for axis, values in zip(plant.machine.axes, data["axes"], strict=True)
            ],
            "parameters": names,
            "posterior_columns": posterior_columns(plant, parameter_columns(plant)),
        }
        (folder / ABOUT).write_text(json.dumps(about, indent=1), "utf-8")
        (folder / URDF).write_text(xml_text(urdf_of(plant, written)), "utf-8")
        source = Path(__file__).parent / "standalone" / FILE
        (folder / FILE).write_text(source.read_text("utf-8"), "utf-8")
        return FILE, ABOUT, MODEL, URDF

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        offsets = [axis["offset"] for axis in json.loads((folder / ABOUT).read_text("utf-8"))["axes"]]
        return urdf_simulation(plant, TorchModel(folder / MODEL, offsets), folder / URDF, self.names(plant))


def posterior_columns(plant: Plant, columns: dict[str, int]) -> dict[str, list[int]]:
    """Column of ``posterior_samples.csv`` → columns of the module's parameters, none for those that it does not have."""
    order = {index: k for k, index in enumerate(columns.values())}
    found = {}
    for name, place in zip(posterior(plant, 1, 0).columns, plant.uncertainty.places, strict=True):
        found[name] = [order[index] for index in indices_of(plant, place) if index in order]
    return found


def reachable(plant: Plant) -> Array:
    """Parameter vectors (2, N) whose largest values contain the draws: the plant's, and with six standard deviations more."""
    thetas = np.tile(plant.vector(), (2, 1))
    for place, variance in zip(plant.uncertainty.places, np.diag(plant.uncertainty.covariance), strict=True):
        thetas[1, indices_of(plant, place)] += 6.0 * np.sqrt(variance)
    return thetas


class TorchModel:
    """A written module with the methods of the drive model, for one machine."""

    def __init__(self, path: Path, offsets: list[float]) -> None:
        import torch

        from sysid.export.torchscript.model import load_script

        self.torch: Any = torch
        self.module = load_script(path)
        self.axes = [SimpleNamespace(offset=offset) for offset in offsets]
        self.theta, self.state = self.module.theta(1), None

    def reset(self, joints: Array, drive: Array, commands: Array, speeds: Array) -> Any:
        with self.torch.jit.optimized_execution(False), self.torch.inference_mode():
            start = (joints, drive, commands, speeds)
            rows = (self.torch.tensor(np.asarray(values, dtype=np.float64))[None] for values in start)
            self.state, signals = self.module.begin(self.theta, *rows)
        return _state(signals)

    def step(self, commands: Array) -> Any:
        with self.torch.jit.optimized_execution(False), self.torch.inference_mode():
            row = self.torch.tensor(np.asarray(commands, dtype=np.float64))[None]
            self.state, signals = self.module(self.theta, self.state, row)
        return _state(signals)


def _state(signals: Any) -> Any:
    return SimpleNamespace(**{name: values[0].numpy() for name, values in signals.items()})
