"""Networks ↔ files of a model version: numbers in safetensors, structure in JSON; nothing in them is executed on reading."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import StoreError
from sysid.machine.kinematics import Kinematics
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork
from sysid.networks.calibration import Calibration
from sysid.networks.forward import ForwardNetwork
from sysid.networks.geometry import Geometry
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.structured import StructuredForward
from sysid.networks.training import Course

WEIGHTS, STRUCTURE = "weights.safetensors", "network.json"

Model = Mapping[str, ActuatorNetwork] | ForwardNetwork | StructuredForward
Tensors = dict[str, npt.NDArray[Any]]


def to_files(model: Model) -> tuple[str, dict[str, bytes]]:
    """Kind and files of a fitted model, for ``Registry.register``; equal networks give equal bytes."""
    from safetensors.numpy import save

    tensors: Tensors = {}
    structure: dict[str, Any]
    if isinstance(model, ForwardNetwork | StructuredForward):
        kind = "forward"
        for number, member in enumerate(model.members):
            _put(tensors, f"member.{number}", member)
        tensors |= {"low": model.low, "high": model.high}
        structure = {
            "joints": list(model.joints),
            "revolute": list(model.revolute),
            "members": [len(member.weights) for member in model.members],
            "courses": [course.to_json() for course in model.courses],
        }
        if isinstance(model, ForwardNetwork):
            structure["features"] = model.features
        else:
            tensors |= {"geometry": model.calibration.values, "covariance": model.calibration.covariance}
            structure["calibrated"] = _calibrated(model)
    else:
        kind = "actuator"
        axes = {}
        for axis, network in model.items():
            _put(tensors, f"{axis}.to_joint", network.to_joint)
            _put(tensors, f"{axis}.to_cylinder", network.to_cylinder)
            axes[axis] = {
                "layers": {direction: len(getattr(network, direction).weights) for direction in DIRECTIONS},
                "displacements": list(network.displacements),
                "joints": list(network.joints),
                "courses": {direction: course.to_json() for direction, course in network.courses.items()},
            }
        structure = {"axes": axes}
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
        structure = json.loads(files[STRUCTURE])
        tensors = load(files[WEIGHTS])
        if structure["schema"] != 1:
            raise StoreError(f"{where}: {STRUCTURE}", f"schema {structure['schema']!r}", "schema 1", "Update the toolkit.")
        if structure["kind"] == "forward":
            return _forward(structure, tensors, where)
        return {axis: _actuator(axis, entry, tensors, where) for axis, entry in structure["axes"].items()}
    except (ValueError, KeyError, TypeError, SafetensorError) as error:
        raise StoreError(where, f"not a network ({type(error).__name__}: {error})", f"{WEIGHTS} and {STRUCTURE}") from None


def _calibrated(model: StructuredForward) -> dict[str, Any]:
    """What the tensors do not say of a calibrated geometry; its parameters stand there for people who read the file."""
    calibration = model.calibration
    kinematics = calibration.geometry.kinematics
    return {
        "urdf": model.urdf,
        "actuated": list(kinematics.actuated),
        "tip": kinematics.tip,
        "bound": model.bound,
        "noise": calibration.noise,
        "open": [[list(part) for part in combination] for combination in calibration.open_combinations],
        "parameters": [found.parameter.key for found in calibration.parameters],
    }


def _structured(structure: dict[str, Any], tensors: Tensors, where: object) -> StructuredForward:
    entry = structure["calibrated"]
    geometry = Geometry(Kinematics.from_urdf(entry["urdf"], tuple(entry["actuated"]), entry["tip"]))
    keys = [parameter.key for parameter in geometry.parameters]
    values, covariance = tensors["geometry"], tensors["covariance"]
    if keys != entry["parameters"] or values.shape != (len(keys),) or covariance.shape != (len(keys), len(keys)):
        found = f"a geometry of {values.shape} and {covariance.shape} for {len(entry['parameters'])} parameters"
        raise StoreError(where, found, f"the {len(keys)} parameters of its URDF", "Fit it again.")
    combinations = tuple(tuple((str(key), float(weight)) for key, weight in part) for part in entry["open"])
    layers = enumerate(structure["members"])
    return StructuredForward(
        joints=tuple(structure["joints"]),
        revolute=tuple(structure["revolute"]),
        urdf=entry["urdf"],
        calibration=Calibration(geometry, values, covariance, float(entry["noise"]), combinations),
        members=tuple(_take(tensors, f"member.{number}", count, where) for number, count in layers),
        bound=float(entry["bound"]),
        low=tensors["low"],
        high=tensors["high"],
        courses=tuple(_course(course) for course in structure["courses"]),
    )


def _forward(structure: dict[str, Any], tensors: Tensors, where: object) -> ForwardNetwork | StructuredForward:
    if "calibrated" in structure:
        return _structured(structure, tensors, where)
    layers = enumerate(structure["members"])
    return ForwardNetwork(
        joints=tuple(structure["joints"]),
        revolute=tuple(structure["revolute"]),
        features=structure["features"],
        members=tuple(_take(tensors, f"member.{number}", count, where) for number, count in layers),
        low=tensors["low"],
        high=tensors["high"],
        courses=tuple(_course(course) for course in structure["courses"]),
    )


def _actuator(axis: str, entry: dict[str, Any], tensors: Tensors, where: object) -> ActuatorNetwork:
    networks = {name: _take(tensors, f"{axis}.{name}", entry["layers"][name], where) for name in DIRECTIONS}
    return ActuatorNetwork(
        axis=axis,
        to_joint=networks["to_joint"],
        to_cylinder=networks["to_cylinder"],
        displacements=(float(entry["displacements"][0]), float(entry["displacements"][1])),
        joints=(float(entry["joints"][0]), float(entry["joints"][1])),
        courses={direction: _course(course) for direction, course in entry["courses"].items()},
    )


def _course(entry: dict[str, Any]) -> Course:
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
    return Course(**values)


def _put(tensors: Tensors, prefix: str, mlp: Mlp) -> None:
    for layer, (weight, bias) in enumerate(zip(mlp.weights, mlp.biases, strict=True)):
        # float32 is what training produced: nothing is lost.
        tensors[f"{prefix}.weight.{layer}"] = weight.astype(np.float32)
        tensors[f"{prefix}.bias.{layer}"] = bias.astype(np.float32)
    for role, scaler in (("inputs", mlp.inputs), ("outputs", mlp.outputs)):
        tensors[f"{prefix}.{role}.mean"] = scaler.mean
        tensors[f"{prefix}.{role}.scale"] = scaler.scale


def _take(tensors: Tensors, prefix: str, layers: int, where: object) -> Mlp:
    def get(name: str) -> npt.NDArray[np.float64]:
        return np.asarray(tensors[f"{prefix}.{name}"], dtype=np.float64)

    mlp = Mlp(
        weights=tuple(get(f"weight.{layer}") for layer in range(layers)),
        biases=tuple(get(f"bias.{layer}") for layer in range(layers)),
        inputs=Normalisation(get("inputs.mean"), get("inputs.scale")),
        outputs=Normalisation(get("outputs.mean"), get("outputs.scale")),
    )
    width = len(mlp.inputs.mean)
    for layer, (weight, bias) in enumerate(zip(mlp.weights, mlp.biases, strict=True)):
        if weight.ndim != 2 or weight.shape[0] != width or bias.shape != (weight.shape[1],):
            raise StoreError(f"{where}: {prefix}", f"layer {layer} of shape {weight.shape}", f"({width}, …) and its biases")
        width = weight.shape[1]
    if width != len(mlp.outputs.mean):
        raise StoreError(f"{where}: {prefix}", f"{width} outputs", str(len(mlp.outputs.mean)))
    return mlp
