"""Networks ↔ files of a model version: arrays in safetensors, structure in JSON; reading executes nothing."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from sysid.errors import StoreError, nearest
from sysid.machine.kinematics import Kinematics
from sysid.networks import cell
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork
from sysid.networks.calibration import Calibration, put_result, take_result
from sysid.networks.chain import FittedChain, products
from sysid.networks.forward import ForwardNetwork
from sysid.networks.geometry import Geometry
from sysid.networks.history import HistoryNetwork, static_maps
from sysid.networks.history_correction import HistoryCorrection
from sysid.networks.member import LearningCurve
from sysid.networks.mlp import Mlp, Normalisation, Rectifier
from sysid.networks.motion import InputCandidate, MotionNetwork
from sysid.networks.motion_inputs import MotionBounds, Window
from sysid.networks.structured import StructuredForward
from sysid.networks.uncertainty import NetworkUncertainty
from sysid.parse import parse_json

WEIGHTS, STRUCTURE = "weights.safetensors", "network.json"
#: Arrays of a :class:`FittedChain`.
CHAIN = ("mean", "scale", "weights", "level", "covariance", "noise")

Model = (
    Mapping[str, ActuatorNetwork]
    | Mapping[str, HistoryNetwork]
    | Mapping[str, MotionNetwork]
    | ForwardNetwork
    | StructuredForward
)
Tensors = dict[str, npt.NDArray[Any]]


def to_files(model: Model) -> tuple[str, dict[str, bytes]]:
    """Kind and files of a fitted model, for ``Registry.register``; equal networks give equal bytes."""
    from safetensors.numpy import save

    tensors: Tensors = {}
    structure: dict[str, Any]
    if isinstance(model, ForwardNetwork | StructuredForward):
        kind = "forward"
        for number, member in enumerate(model.members):
            put_mlp(tensors, f"member.{number}", member)
        tensors |= {"low": model.low, "high": model.high} | (
            model.uncertainty.tensors("trust") if model.uncertainty is not None else {}
        )
        structure = {
            "joints": list(model.joints),
            "revolute": list(model.revolute),
            "members": [len(member.weights) for member in model.members],
            "rectifier": model.members[0].rectifier if model.members else "relu",
            "courses": [curve.to_json() for curve in model.learning_curves],
        }
        if isinstance(model, ForwardNetwork):
            structure["features"] = model.features
        else:
            own, structure["structure"] = _put_structure(model)
            tensors |= {f"structure.{name}": values for name, values in own.items()} | {"bound": np.array([model.bound])}
    elif motions := motion_networks(model):
        kind = "motion"
        structure = {"axes": _put_motions(motions, tensors)}
    else:
        kind = "actuator"
        axes = {}
        for axis, network in static_networks(model).items():
            put_mlp(tensors, f"{axis}.to_joint", network.to_joint)
            put_mlp(tensors, f"{axis}.to_cylinder", network.to_cylinder)
            for direction, uncertainty in network.uncertainty.items():
                tensors |= uncertainty.tensors(f"{axis}.{direction}.trust")
            axes[axis] = {
                "layers": {direction: len(getattr(network, direction).weights) for direction in DIRECTIONS},
                "rectifier": network.to_joint.rectifier,
                "displacements": list(network.displacements),
                "joints": list(network.joints),
                "courses": {direction: curve.to_json() for direction, curve in network.learning_curves.items()},
            }
        structure = {"axes": axes}
        if histories := history_networks(model):
            kind = "history"
            structure["memories"] = _put_corrections(histories, tensors)
    text = json.dumps({"schema": 1, "kind": kind, **structure}, sort_keys=True, indent=1)
    return kind, {WEIGHTS: save(tensors), STRUCTURE: text.encode("utf-8")}


def from_files(files: Mapping[str, bytes], where: object) -> Model:
    """Inverse of :func:`to_files`.

    Args:
        where: the model version, for messages.

    Raises:
        StoreError: a file is missing or invalid, or the layers do not fit together.
    """
    with reading(files, where, "a network") as (structure, tensors):
        if structure["schema"] != 1:
            raise StoreError(f"{where}: {STRUCTURE}", f"schema {structure['schema']!r}", "schema 1", "Update the toolkit.")
        if structure["kind"] == "forward":
            return _forward(structure, tensors, where)
        if structure["kind"] == "motion":
            return _take_motions(structure["axes"], tensors, where)
        static = {axis: _actuator(axis, entry, tensors, where) for axis, entry in structure["axes"].items()}
        return _take_corrections(structure["memories"], static, tensors, where) if structure["kind"] == "history" else static


@contextmanager
def reading(files: Mapping[str, bytes], where: object, what: str) -> Iterator[tuple[dict[str, Any], Tensors]]:
    """Structure and tensors of a version; errors of their content, also in the body of the ``with``, become StoreErrors.

    Args:
        what: the expected content with its article, for messages.

    Raises:
        StoreError: a file is missing or invalid.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    for name in (WEIGHTS, STRUCTURE):
        if name not in files:
            raise StoreError(where, f"no file {name}", f"{WEIGHTS} and {STRUCTURE}", f"Is it {what}?")
    try:
        yield parse_json(files[STRUCTURE]), load(files[WEIGHTS])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, SafetensorError) as error:
        raise StoreError(where, f"not {what} ({type(error).__name__}: {error})", f"{WEIGHTS} and {STRUCTURE}") from None


def motion_networks(model: Model) -> dict[str, MotionNetwork]:
    """Axis → command → motion network; empty for other models."""
    return {axis: network for axis, network in _by_axis(model).items() if isinstance(network, MotionNetwork)}


def history_networks(model: Model) -> dict[str, HistoryNetwork]:
    """Axis → actuator network with history; empty for other models."""
    return {axis: network for axis, network in _by_axis(model).items() if isinstance(network, HistoryNetwork)}


def static_networks(model: Model) -> dict[str, ActuatorNetwork]:
    """Axis → static map of cylinder and joint: actuator networks, or the static parts of those with history."""
    return static_maps({axis: network for axis, network in _by_axis(model).items() if not isinstance(network, MotionNetwork)})


def _by_axis(model: Model) -> Mapping[str, ActuatorNetwork | HistoryNetwork | MotionNetwork]:
    return {} if isinstance(model, ForwardNetwork | StructuredForward) else model


def _put_structure(model: StructuredForward) -> tuple[Tensors, dict[str, Any]]:
    """Tensors of a structure, and its entries for JSON; parameter names are for readers of the file."""
    found = model.structure
    if isinstance(found, FittedChain):
        return {key: getattr(found, key) for key in CHAIN}, {"kind": "chain"}
    geometry = found.geometry
    tensors = {"values": found.values, "covariance": found.covariance, "noise": np.array([found.noise])}
    tensors |= {"frame": geometry.frame, "offsets": geometry.offsets_of_points}
    return tensors, {
        "kind": "calibration",
        "urdf": model.urdf,
        "actuated": list(geometry.kinematics.actuated),
        "tip": geometry.kinematics.tip,
        "markers": geometry.markers,
        "parameters": [parameter.key for parameter in geometry.parameters],
        **put_result(found),
    }


def _take_structure(
    entry: dict[str, Any], revolute: tuple[bool, ...], tensors: Tensors, where: object
) -> Calibration | FittedChain:
    own = {key.removeprefix("structure."): value for key, value in tensors.items() if key.startswith("structure.")}
    if entry["kind"] == "chain":
        chain = FittedChain(revolute, **{key: own[key] for key in CHAIN})
        count = products(np.zeros((1, len(revolute))), revolute).shape[1]
        shapes = (chain.mean.shape, chain.scale.shape, chain.weights.shape, chain.covariance.shape)
        if shapes != ((count,), (count,), (count, 3), (count + 1, count + 1)):
            raise StoreError(where, f"a chain of shapes {shapes}", f"those of {count} products", "Fit it again.")
        return chain
    kinematics = Kinematics.from_urdf(entry["urdf"], tuple(entry["actuated"]), entry["tip"])
    geometry = Geometry(kinematics, dict(entry.get("markers", {})), own.get("frame", np.eye(4)), own.get("offsets"))
    keys, stored = [parameter.key for parameter in geometry.parameters], entry["parameters"]
    count = len(stored)
    if not set(stored) <= set(keys) or own["values"].shape != (count,) or own["covariance"].shape != (count, count):
        found = f"a geometry of {own['values'].shape} and {own['covariance'].shape} for {count} parameters"
        raise StoreError(where, found, f"the {len(keys)} parameters of its URDF", "Fit it again.")
    # A version of an earlier release has no elastic parameters.
    places = np.array([keys.index(key) for key in stored], dtype=np.intp)
    values, covariance, known = np.zeros(len(keys)), np.zeros((len(keys), len(keys))), np.zeros(len(keys), dtype=bool)
    values[places], covariance[np.ix_(places, places)], known[places] = own["values"], own["covariance"], True
    return take_result(entry, Calibration(geometry, values, covariance, float(own["noise"][0]), (), known))


def _forward(structure: dict[str, Any], tensors: Tensors, where: object) -> ForwardNetwork | StructuredForward:
    rectifier = _rectifier(structure, where)
    layers = enumerate(structure["members"])
    common: dict[str, Any] = {
        "joints": tuple(structure["joints"]),
        "revolute": tuple(structure["revolute"]),
        "members": tuple(take_mlp(tensors, f"member.{number}", count, where, rectifier) for number, count in layers),
        "low": tensors["low"],
        "high": tensors["high"],
        "learning_curves": tuple(_learning_curve(curve) for curve in structure["courses"]),
        "uncertainty": NetworkUncertainty.from_tensors(tensors, "trust", len(structure["joints"]), 3, where),
    }
    if "structure" not in structure:
        return ForwardNetwork(features=structure["features"], **common)
    return StructuredForward(
        structure=_take_structure(structure["structure"], common["revolute"], tensors, where),
        urdf=structure["structure"].get("urdf", ""),
        bound=float(tensors["bound"][0]),
        **common,
    )


def _actuator(axis: str, entry: dict[str, Any], tensors: Tensors, where: object) -> ActuatorNetwork:
    rectifier = _rectifier(entry, where)
    networks = {name: take_mlp(tensors, f"{axis}.{name}", entry["layers"][name], where, rectifier) for name in DIRECTIONS}
    return ActuatorNetwork(
        axis=axis,
        to_joint=networks["to_joint"],
        to_cylinder=networks["to_cylinder"],
        displacements=(float(entry["displacements"][0]), float(entry["displacements"][1])),
        joints=(float(entry["joints"][0]), float(entry["joints"][1])),
        learning_curves={direction: _learning_curve(curve) for direction, curve in entry["courses"].items()},
        uncertainty={
            direction: uncertainty
            for direction in DIRECTIONS
            if (uncertainty := NetworkUncertainty.from_tensors(tensors, f"{axis}.{direction}.trust", 1, 1, where)) is not None
        },
    )


def _put_corrections(model: Mapping[str, HistoryNetwork], tensors: Tensors) -> dict[str, Any]:
    """Weights of the corrections into ``tensors``; returns their structure for JSON."""
    structure: dict[str, Any] = {}
    for axis, network in model.items():
        structure[axis] = {}
        for direction in DIRECTIONS:
            correction: HistoryCorrection = getattr(network, direction)
            tensors |= {f"{axis}.{direction}.memory.{name}": correction.weights[name] for name in cell.TENSORS}
            tensors[f"{axis}.{direction}.memory.widths"] = correction.widths
            loss = correction.loss if math.isfinite(correction.loss) else None
            structure[axis][direction] = {
                "interval": correction.interval,
                "bound": correction.bound,
                "loss": loss,
                "epochs": correction.epochs,
            }
    return structure


def _take_corrections(
    structure: Mapping[str, Any], static: Mapping[str, ActuatorNetwork], tensors: Tensors, where: object
) -> dict[str, HistoryNetwork]:
    found = {}
    for axis, network in static.items():
        corrections = {}
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
            corrections[direction] = HistoryCorrection(
                entry["interval"], entry["bound"], widths, weights, loss, entry["epochs"]
            )
        found[axis] = HistoryNetwork(network, **corrections)
    return found


def _put_motions(model: Mapping[str, MotionNetwork], tensors: Tensors) -> dict[str, Any]:
    """Weights of the networks into ``tensors``; returns their structure for JSON."""
    axes = {}
    for axis, network in model.items():
        for number, mlp in enumerate(network.members):
            put_mlp(tensors, f"{axis}.{number}", mlp)
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


def _take_motions(axes: Mapping[str, Any], tensors: Tensors, where: object) -> dict[str, MotionNetwork]:
    found = {}
    for axis, entry in axes.items():
        window = Window(**{key: _tupled(value) for key, value in entry["window"].items()})
        members = tuple(take_mlp(tensors, f"{axis}.{number}", layers, where) for number, layers in enumerate(entry["members"]))
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
            bounds=MotionBounds(**{key: _tupled(value) for key, value in entry["bounds"].items()}),
            commands=_tupled(entry["commands"]),
            learning_curves=tuple(_learning_curve(item) for item in entry["courses"]),
            candidates=tuple(InputCandidate(**candidate) for candidate in entry["candidates"]),
        )
    return found


def _learning_curve(entry: dict[str, Any]) -> LearningCurve:
    return LearningCurve(**{key: _tupled(value) for key, value in entry.items()})


def _tupled(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def put_mlp(tensors: Tensors, prefix: str, mlp: Mlp) -> None:
    """Arrays of a perceptron, with names that begin with ``prefix``."""
    for layer, (weight, bias) in enumerate(zip(mlp.weights, mlp.biases, strict=True)):
        # Training produces float32.
        tensors[f"{prefix}.weight.{layer}"] = weight.astype(np.float32)
        tensors[f"{prefix}.bias.{layer}"] = bias.astype(np.float32)
    for role, scaler in (("inputs", mlp.inputs), ("outputs", mlp.outputs)):
        tensors[f"{prefix}.{role}.mean"] = scaler.mean
        tensors[f"{prefix}.{role}.scale"] = scaler.scale


def _rectifier(entry: dict[str, Any], where: object) -> Rectifier:
    """``relu`` where the file has no entry (earlier releases)."""
    name: Rectifier = entry.get("rectifier", "relu")
    if name not in get_args(Rectifier):
        raise StoreError(where, f"rectifier {name!r}", nearest(str(name), get_args(Rectifier)), "Update the toolkit.")
    return name


def take_mlp(tensors: Tensors, prefix: str, layers: int, where: object, rectifier: Rectifier = "relu") -> Mlp:
    """Inverse of :func:`put_mlp`; the tensors do not contain ``rectifier``.

    Raises:
        StoreError: the layers do not fit together.
        KeyError: one is missing.
    """

    def get(name: str) -> npt.NDArray[np.float64]:
        return np.asarray(tensors[f"{prefix}.{name}"], dtype=np.float64)

    mlp = Mlp(
        weights=tuple(get(f"weight.{layer}") for layer in range(layers)),
        biases=tuple(get(f"bias.{layer}") for layer in range(layers)),
        inputs=Normalisation(get("inputs.mean"), get("inputs.scale")),
        outputs=Normalisation(get("outputs.mean"), get("outputs.scale")),
        rectifier=rectifier,
    )
    width = len(mlp.inputs.mean)
    for layer, (weight, bias) in enumerate(zip(mlp.weights, mlp.biases, strict=True)):
        if weight.ndim != 2 or weight.shape[0] != width or bias.shape != (weight.shape[1],):
            raise StoreError(f"{where}: {prefix}", f"layer {layer} of shape {weight.shape}", f"({width}, …) and its biases")
        width = weight.shape[1]
    if width != len(mlp.outputs.mean):
        raise StoreError(f"{where}: {prefix}", f"{width} outputs", str(len(mlp.outputs.mean)))
    return mlp
