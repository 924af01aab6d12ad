"""Networks ↔ files of a model version: numbers in safetensors, structure in JSON; nothing in them is executed on reading."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from sysid.errors import StoreError, nearest
from sysid.machine.kinematics import Kinematics
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork
from sysid.networks.along_files import put_memories, put_motions, take_memories, take_motions
from sysid.networks.calibration import Calibration
from sysid.networks.chain import FittedChain, products
from sysid.networks.forward import ForwardNetwork
from sysid.networks.geometry import Geometry
from sysid.networks.history import HistoryNetwork, statics
from sysid.networks.member import LearningCurve
from sysid.networks.mlp import Mlp, Normalisation, Rectifier
from sysid.networks.motion import MotionNetwork
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
        tensors |= {"low": model.low, "high": model.high} | (model.trust.tensors("trust") if model.trust is not None else {})
        structure = {
            "joints": list(model.joints),
            "revolute": list(model.revolute),
            "members": [len(member.weights) for member in model.members],
            "rectifier": model.members[0].rectifier if model.members else "relu",
            "courses": [course.to_json() for course in model.courses],
        }
        if isinstance(model, ForwardNetwork):
            structure["features"] = model.features
        else:
            own, structure["structure"] = _put_structure(model)
            tensors |= {f"structure.{name}": values for name, values in own.items()} | {"bound": np.array([model.bound])}
    elif motions := motion_networks(model):
        kind = "motion"
        structure = {"axes": put_motions(motions, lambda prefix, mlp: put_mlp(tensors, prefix, mlp))}
    else:
        kind = "actuator"
        axes = {}
        for axis, network in static_networks(model).items():
            put_mlp(tensors, f"{axis}.to_joint", network.to_joint)
            put_mlp(tensors, f"{axis}.to_cylinder", network.to_cylinder)
            for direction, trust in network.trust.items():
                tensors |= trust.tensors(f"{axis}.{direction}.trust")
            axes[axis] = {
                "layers": {direction: len(getattr(network, direction).weights) for direction in DIRECTIONS},
                "rectifier": network.to_joint.rectifier,
                "displacements": list(network.displacements),
                "joints": list(network.joints),
                "courses": {direction: course.to_json() for direction, course in network.courses.items()},
            }
        structure = {"axes": axes}
        if histories := history_networks(model):
            kind = "history"
            structure["memories"] = put_memories(histories, tensors)
    text = json.dumps({"schema": 1, "kind": kind, **structure}, sort_keys=True, indent=1)
    return kind, {WEIGHTS: save(tensors), STRUCTURE: text.encode("utf-8")}


def from_files(files: Mapping[str, bytes], where: object) -> Model:
    """The model whose :func:`to_files` these are.

    Args:
        where: the model version, for messages.

    Raises:
        StoreError: a file is missing, is not what it should be, or the layers do not fit together.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    for name in (WEIGHTS, STRUCTURE):
        if name not in files:
            raise StoreError(where, f"no file {name}", f"{WEIGHTS} and {STRUCTURE}", "Is it a network?")
    try:
        structure = parse_json(files[STRUCTURE])
        tensors = load(files[WEIGHTS])
        if structure["schema"] != 1:
            raise StoreError(f"{where}: {STRUCTURE}", f"schema {structure['schema']!r}", "schema 1", "Update the toolkit.")
        if structure["kind"] == "forward":
            return _forward(structure, tensors, where)
        if structure["kind"] == "motion":
            return take_motions(
                structure["axes"], lambda prefix, count: take_mlp(tensors, prefix, count, where), _course, where
            )
        static = {axis: _actuator(axis, entry, tensors, where) for axis, entry in structure["axes"].items()}
        return take_memories(structure["memories"], static, tensors, where) if structure["kind"] == "history" else static
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, SafetensorError) as error:
        raise StoreError(where, f"not a network ({type(error).__name__}: {error})", f"{WEIGHTS} and {STRUCTURE}") from None


def motion_networks(model: Model) -> dict[str, MotionNetwork]:
    """The model, where it is command → motion; else nothing."""
    if isinstance(model, ForwardNetwork | StructuredForward):
        return {}
    return {axis: network for axis, network in model.items() if isinstance(network, MotionNetwork)}


def history_networks(model: Model) -> dict[str, HistoryNetwork]:
    """The model, where it is actuators with history; else nothing."""
    if isinstance(model, ForwardNetwork | StructuredForward):
        return {}
    return {axis: network for axis, network in model.items() if isinstance(network, HistoryNetwork)}


def static_networks(model: Model) -> dict[str, ActuatorNetwork]:
    """The static maps between cylinders and joints: actuators themselves, or the static parts of those with history."""
    if isinstance(model, ForwardNetwork | StructuredForward):
        return {}
    return statics({axis: network for axis, network in model.items() if not isinstance(network, MotionNetwork)})


def _put_structure(model: StructuredForward) -> tuple[Tensors, dict[str, Any]]:
    """Tensors of a structure, and what they do not say; parameters are named for people who read the file."""
    found = model.structure
    if isinstance(found, FittedChain):
        return {key: getattr(found, key) for key in CHAIN}, {"kind": "chain"}
    kinematics = found.geometry.kinematics
    return {"values": found.values, "covariance": found.covariance, "noise": np.array([found.noise])}, {
        "kind": "calibration",
        "urdf": model.urdf,
        "actuated": list(kinematics.actuated),
        "tip": kinematics.tip,
        "open": [[list(part) for part in combination] for combination in found.open_combinations],
        "parameters": [parameter.key for parameter in found.geometry.parameters],
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
    geometry = Geometry(Kinematics.from_urdf(entry["urdf"], tuple(entry["actuated"]), entry["tip"]))
    count = len(geometry.parameters)
    same = [parameter.key for parameter in geometry.parameters] == entry["parameters"]
    if not same or own["values"].shape != (count,) or own["covariance"].shape != (count, count):
        found = f"a geometry of {own['values'].shape} and {own['covariance'].shape} for {len(entry['parameters'])} parameters"
        raise StoreError(where, found, f"the {count} parameters of its URDF", "Fit it again.")
    combinations = tuple(tuple((str(key), float(weight)) for key, weight in part) for part in entry["open"])
    return Calibration(geometry, own["values"], own["covariance"], float(own["noise"][0]), combinations)


def _structured(structure: dict[str, Any], tensors: Tensors, where: object) -> StructuredForward:
    revolute = tuple(structure["revolute"])
    layers = enumerate(structure["members"])
    rectifier = _rectifier(structure, where)
    return StructuredForward(
        joints=tuple(structure["joints"]),
        revolute=revolute,
        structure=_take_structure(structure["structure"], revolute, tensors, where),
        urdf=structure["structure"].get("urdf", ""),
        members=tuple(take_mlp(tensors, f"member.{number}", count, where, rectifier) for number, count in layers),
        bound=float(tensors["bound"][0]),
        low=tensors["low"],
        high=tensors["high"],
        courses=tuple(_course(course) for course in structure["courses"]),
        trust=NetworkUncertainty.from_tensors(tensors, "trust", len(structure["joints"]), 3, where),
    )


def _forward(structure: dict[str, Any], tensors: Tensors, where: object) -> ForwardNetwork | StructuredForward:
    if "structure" in structure:
        return _structured(structure, tensors, where)
    layers = enumerate(structure["members"])
    rectifier = _rectifier(structure, where)
    return ForwardNetwork(
        joints=tuple(structure["joints"]),
        revolute=tuple(structure["revolute"]),
        features=structure["features"],
        members=tuple(take_mlp(tensors, f"member.{number}", count, where, rectifier) for number, count in layers),
        low=tensors["low"],
        high=tensors["high"],
        courses=tuple(_course(course) for course in structure["courses"]),
        trust=NetworkUncertainty.from_tensors(tensors, "trust", len(structure["joints"]), 3, where),
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
        courses={direction: _course(course) for direction, course in entry["courses"].items()},
        trust={
            direction: trust
            for direction in DIRECTIONS
            if (trust := NetworkUncertainty.from_tensors(tensors, f"{axis}.{direction}.trust", 1, 1, where)) is not None
        },
    )


def _course(entry: dict[str, Any]) -> LearningCurve:
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
    return LearningCurve(**values)


def put_mlp(tensors: Tensors, prefix: str, mlp: Mlp) -> None:
    """Numbers of a perceptron, by names that begin with ``prefix``."""
    for layer, (weight, bias) in enumerate(zip(mlp.weights, mlp.biases, strict=True)):
        # float32 is what training produced: nothing is lost.
        tensors[f"{prefix}.weight.{layer}"] = weight.astype(np.float32)
        tensors[f"{prefix}.bias.{layer}"] = bias.astype(np.float32)
    for role, scaler in (("inputs", mlp.inputs), ("outputs", mlp.outputs)):
        tensors[f"{prefix}.{role}.mean"] = scaler.mean
        tensors[f"{prefix}.{role}.scale"] = scaler.scale


def _rectifier(entry: dict[str, Any], where: object) -> Rectifier:
    """Files of before there was a choice do not name theirs."""
    name: Rectifier = entry.get("rectifier", "relu")
    if name not in get_args(Rectifier):
        raise StoreError(where, f"rectifier {name!r}", nearest(str(name), get_args(Rectifier)), "Update the toolkit.")
    return name


def take_mlp(tensors: Tensors, prefix: str, layers: int, where: object, rectifier: Rectifier = "relu") -> Mlp:
    """What :func:`put_mlp` put, between whose layers stands ``rectifier``, which tensors do not say.

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
