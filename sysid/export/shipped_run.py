"""Shipped Python files, executed from where they were written."""

from __future__ import annotations

import importlib.util
import sys
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.export.drive_data import drive_data
from sysid.export.drive_module import DATA, MODULE, data_text, module_text
from sysid.export.target import Start
from sysid.plant import Plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


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
