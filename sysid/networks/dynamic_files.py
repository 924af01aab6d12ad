"""Files of networks with a state: corrections of actuator networks with history, and command → motion networks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import StoreError
from sysid.networks import cell
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork
from sysid.networks.history import HistoryNetwork
from sysid.networks.history_correction import HistoryCorrection
from sysid.networks.member import LearningCurve
from sysid.networks.mlp import Mlp
from sysid.networks.motion import InputCandidate, MotionNetwork
from sysid.networks.motion_inputs import Window
from sysid.networks.rollout import MotionBounds

Array = npt.NDArray[np.float64]
Tensors = dict[str, npt.NDArray[Any]]


def put_memories(model: Mapping[str, HistoryNetwork], tensors: Tensors) -> dict[str, Any]:
    """Weights of the corrections into ``tensors``; returns their structure for JSON."""
    structure: dict[str, Any] = {}
    for axis, network in model.items():
        structure[axis] = {}
        for direction in DIRECTIONS:
            memory: HistoryCorrection = getattr(network, direction)
            tensors |= {f"{axis}.{direction}.memory.{name}": memory.weights[name] for name in cell.TENSORS}
            tensors[f"{axis}.{direction}.memory.widths"] = memory.widths
            loss = memory.loss if math.isfinite(memory.loss) else None
            structure[axis][direction] = {
                "interval": memory.interval,
                "bound": memory.bound,
                "loss": loss,
                "epochs": memory.epochs,
            }
    return structure


def take_memories(
    structure: Mapping[str, Any], static: Mapping[str, ActuatorNetwork], tensors: Tensors, where: object
) -> dict[str, HistoryNetwork]:
    """Networks with history from their static parts and the output of :func:`put_memories`.

    Raises:
        StoreError: arrays of inconsistent shapes.
        KeyError: an entry is missing.
    """
    found = {}
    for axis, network in static.items():
        memories = {}
        for direction in DIRECTIONS:
            prefix, entry = f"{axis}.{direction}.memory", structure[axis][direction]
            weights = {name: np.asarray(tensors[f"{prefix}.{name}"], dtype=np.float64) for name in cell.TENSORS}
            widths = np.asarray(tensors[f"{prefix}.widths"], dtype=np.float64)
            F, H = 2 + len(widths), len(weights["w"])
            shapes = {"mean": (F,), "scale": (F,), "W": (4 * H, F), "U": (4 * H, H), "b": (4 * H,), "w": (H,), "w0": (1,)}
            for name, shape in shapes.items():
                if weights[name].shape != shape or not np.isfinite(weights[name]).all():
                    raise StoreError(f"{where}: {prefix}.{name}", f"shape {weights[name].shape}", f"finite numbers of {shape}")
            loss = math.nan if entry["loss"] is None else float(entry["loss"])
            memories[direction] = HistoryCorrection(entry["interval"], entry["bound"], widths, weights, loss, entry["epochs"])
        found[axis] = HistoryNetwork(network, **memories)
    return found


def put_motions(model: Mapping[str, MotionNetwork], put: Callable[[str, Mlp], None]) -> dict[str, Any]:
    """Networks through ``put``; returns their structure for JSON."""
    axes = {}
    for axis, network in model.items():
        for number, mlp in enumerate(network.members):
            put(f"{axis}.{number}", mlp)
        axes[axis] = {
            "command": network.command,
            "driven": network.driven,
            "unit": network.unit,
            "window": asdict(network.window),
            "members": [len(mlp.weights) for mlp in network.members],
            "bounds": asdict(network.bounds),
            "commands": list(network.commands),
            "courses": [curve.to_json() for curve in network.learning_curves],
            "candidates": [asdict(candidate) for candidate in network.candidates],
        }
    return axes


def take_motions(
    axes: Mapping[str, Any], take: Callable[[str, int], Mlp], curve: Callable[[dict[str, Any]], LearningCurve], where: object
) -> dict[str, MotionNetwork]:
    """Networks from the output of :func:`put_motions`.

    Raises:
        StoreError: a network whose inputs are not those of its window.
        KeyError: an entry is missing.
    """
    found = {}
    for axis, entry in axes.items():
        window = Window(**{key: _tuple(value) for key, value in entry["window"].items()})
        members = tuple(take(f"{axis}.{number}", layers) for number, layers in enumerate(entry["members"]))
        count = len(window.names("", ""))
        for mlp in members:
            if len(mlp.inputs.mean) != count or len(mlp.outputs.mean) != 1:
                shape = f"{len(mlp.inputs.mean)} inputs and {len(mlp.outputs.mean)} outputs"
                raise StoreError(f"{where}: {axis}", shape, f"{count} inputs and one output, as its window has")
        if not members:
            raise StoreError(f"{where}: {axis}", "no network", "at least one")
        found[axis] = MotionNetwork(
            axis=axis,
            command=entry["command"],
            driven=entry["driven"],
            unit=entry["unit"],
            window=window,
            members=members,
            bounds=MotionBounds(**{key: _tuple(value) for key, value in entry["bounds"].items()}),
            commands=_tuple(entry["commands"]),
            learning_curves=tuple(curve(item) for item in entry["courses"]),
            candidates=tuple(InputCandidate(**candidate) for candidate in entry["candidates"]),
        )
    return found


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
