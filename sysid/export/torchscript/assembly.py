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

from sysid.effects import effect_named
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.torchscript.equations import Equations
from sysid.export.torchscript.model import DriveModel
from sysid.plant import Plant
from sysid.plant.layout import slot_indices
from sysid.plant.settled_pose import SETTLING

Array = npt.NDArray[np.float64]

_jit: Any = torch.jit


@contextmanager
def deprecation_known() -> Iterator[None]:
    """Without the warning that TorchScript is deprecated."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"`torch\.jit\..*", DeprecationWarning)
        yield


def save_script(module: Any, path: Path) -> None:
    """Write a script to a file."""
    with deprecation_known():
        _jit.save(module, str(path))


def load_script(path: Path) -> Any:
    """The script of a file, on the CPU."""
    with deprecation_known():
        return _jit.load(str(path), map_location="cpu")


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
    reached = plant.vector()[None] if thetas is None else thetas
    index = parameter_columns(plant)
    longest = {}
    for i, name in enumerate(plant.machine.axis_names):
        if (at := index.get(f"input_delay.{name}.delay")) is not None:
            longest[i] = math.floor(float(reached[:, at].max()) * rate_hz + 1e-9) + 2
    equations = Equations(plant, rate_hz, {at: column for column, at in enumerate(index.values())}, longest)
    soft = [name for name in index if name.startswith("joint_compliance.")] if equations.arrays.posed else []
    settling = (SETTLING if soft else 1) if equations.arrays.posed else 0
    sagging = SETTLING if any(".drive." in name for name in soft) else 0
    values = {name: float(plant.vector()[at]) for name, at in index.items()}
    with deprecation_known():
        functions = equations.script()
        loads = equations.count if equations.arrays.posed else 0
        model = DriveModel(values, functions, loads, settling, sagging, list(equations.signals))
        return _jit.script(model.eval())
