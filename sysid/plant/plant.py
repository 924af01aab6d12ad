"""A plant: machine, linkages and a list of effects. Immutable; a repaired plant is a new one."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from sysid.config import parse_settings
from sysid.effects import Parameter, effect_named
from sysid.effects.described import check_known_effect, side_of
from sysid.errors import SettingsError, StoreError
from sysid.foreign import shown
from sysid.machine import (
    Convention,
    CylinderJointMap,
    EffectKey,
    KnownEffect,
    Machine,
    TabulatedLinkage,
    TriangleLinkage,
    machine_from_files,
    tabulate,
)
from sysid.networks.history import HistoryNetwork
from sysid.parse import parse_json
from sysid.plant.layout import AT, AXIS_WIDTH, Streams, neutral_vector, parameter_indices
from sysid.plant.residual import FILE, Residual, check_residual, from_files, to_tensors
from sysid.plant.uncertainty import NONE, PlantNumber, Uncertainty, uncertainty_from
from sysid.quoting import toml_key, toml_value

Array = npt.NDArray[np.float64]
Value = float | Sequence[float]

#: What is expected where a cylinder has no linkage.
LINKAGE = "geometry in machine.toml or a fitted actuator network (sysid fit actuator)"


@dataclass(frozen=True)
class Plant:
    """The simulation model that is compared with the machine.

    Args:
        linkages: axis → cylinder ↔ joint table, for axes that drive a cylinder.
        effects: one instance per (name, target, side).
        streams: stream (file stem) → its signals, for the effects of clocks.
        uncertainty: joint distribution of its parameters.
        origin: lineage (dataset and plant versions, linkage models, evidence).
        reference: ``name@version`` once registered.
        residuals: networks for errors that no effect explains (:mod:`sysid.plant.residual`).
    """

    machine: Machine
    linkages: Mapping[str, TabulatedLinkage]
    effects: tuple[KnownEffect, ...]
    streams: Streams = field(default_factory=dict)
    uncertainty: Uncertainty = NONE
    origin: Mapping[str, Any] = field(default_factory=dict)
    reference: str = ""
    residuals: tuple[Residual, ...] = ()

    def __post_init__(self) -> None:
        seen = set()
        for item in self.effects:
            key = effect_key(item)
            if key in seen:
                raise SettingsError(f"plant of {self.machine.name}", f"{item.name} on {item.target} twice", "one instance")
            seen.add(key)
            check_known_effect(self.machine, item, tuple(self.streams))
        for residual in self.residuals:
            check_residual(self.machine, tuple(self.linkages), residual)

    def vector(self) -> Array:
        """The flat parameter vector of the compiled chain."""
        theta = neutral_vector(len(self.machine.axes)).copy()
        for i, axis in enumerate(self.machine.axes):  # the limit of a controller is the nominal value of its effect
            if axis.servo is not None and isinstance(axis.servo.force_limit, float):
                theta[i * AXIS_WIDTH + AT.force_limit] = axis.servo.force_limit
        for item in self.effects:
            for name, value in item.parameters.items():
                places = parameter_indices(self.machine.axis_names, item.name, item.target, item.side, name, self.streams)
                for group, component in zip(places, np.atleast_1d(np.asarray(value, dtype=np.float64)), strict=True):
                    theta[group] = component
        return theta

    def effect(self, name: str, target: str, side: str | None = None) -> KnownEffect | None:
        """The instance, or None."""
        side = side_of(effect_named(name), side)
        for item in self.effects:
            if effect_key(item) == (name, target, side):
                return item
        return None

    def with_effect(self, item: KnownEffect) -> Plant:
        """A plant with ``item`` added, which replaces an instance with the same name, target and side."""
        rest = tuple(known for known in self.effects if effect_key(known) != effect_key(item))
        known = self.uncertainty.without({effect_key(item)})
        return replace(self, effects=(*rest, item), uncertainty=known, reference="")

    def with_uncertainty(self, uncertainty: Uncertainty) -> Plant:
        """A plant with this uncertainty of these parameters; that of the others is kept.

        Raises:
            SettingsError: a parameter that the plant does not have.
        """
        for place in uncertainty.places:
            self._value(place)
        return replace(self, uncertainty=self.uncertainty.joined(uncertainty), reference="")

    def sample(self, count: int, seed: int) -> Array:
        """``count`` parameter vectors drawn from the uncertainty, (count, N); all the same without an uncertainty.

        They are the ``thetas`` of a :class:`sysid.plant.stepper.Stepper`, one lane each.
        """
        places = self.uncertainty.places
        thetas = np.tile(self.vector(), (count, 1))
        if not places:
            return thetas
        bounds = [_parameter(place).bounds for place in places]
        drawn = self.uncertainty.draw(np.array([self._value(place) for place in places]), bounds, count, seed)
        names = self.machine.axis_names
        for place, values in zip(places, drawn.T, strict=True):
            groups = parameter_indices(names, place.effect, place.target, place.side, place.parameter, self.streams)
            for at in groups[place.component]:
                thetas[:, at] = values
        return thetas

    def _value(self, place: PlantNumber) -> float:
        item = self.effect(place.effect, place.target, place.side)
        if item is None or place.parameter not in item.parameters:
            found = f"uncertainty of {place.effect} on {place.target}: {place.parameter}"
            raise SettingsError(f"plant of {self.machine.name}", found, "a parameter that the plant has")
        return float(np.atleast_1d(np.asarray(item.parameters[place.parameter], dtype=np.float64))[place.component])

    def without_effect(self, name: str, target: str, side: str | None = None) -> Plant:
        """A plant without that instance."""
        key = (name, target, side_of(effect_named(name), side))
        rest = tuple(known for known in self.effects if effect_key(known) != key)
        return replace(self, effects=rest, uncertainty=self.uncertainty.without({key}), reference="")

    def with_residual(self, item: Residual) -> Plant:
        """A plant with this residual network, which replaces that of the same stage.

        Raises:
            SettingsError: the stage cannot have one.
        """
        rest = self.without_residual(*item.key)
        return replace(rest, residuals=(*rest.residuals, item), reference="")

    def without_residual(self, stage: str, target: str) -> Plant:
        """A plant without a residual network at that stage."""
        rest = tuple(item for item in self.residuals if item.key != (stage, target))
        return self if len(rest) == len(self.residuals) else replace(self, residuals=rest, reference="")

    def to_files(self) -> dict[str, bytes]:
        """Files for a registry: JSON, the machine's files, the linkage tables."""
        from safetensors.numpy import save

        content = {
            "schema": 1,
            "effects": [
                {
                    "name": e.name,
                    "target": e.target,
                    "side": e.side,
                    "parameters": {k: _plain(v) for k, v in e.parameters.items()},
                }
                for e in sorted(self.effects, key=lambda e: (e.target, e.name, e.side or ""))
            ],
            "machine_files": self.machine.files(),
            "streams": {stream: list(signals) for stream, signals in self.streams.items()},
            "uncertainty": self.uncertainty.plain(),
            "origin": dict(self.origin),
        }
        if self.residuals:  # another schema, so that no reader ignores them
            content |= {"schema": 2, "residuals": [item.to_json() for item in self.residuals]}
        if self.machine.convention is not None:
            content |= {"schema": 3, "convention": self.machine.convention}
        files = {"plant.json": json.dumps(content, indent=1, sort_keys=True).encode()}
        if self.residuals:
            files[FILE] = to_tensors(self.residuals)
        if self.linkages:
            tables = {}
            for axis in sorted(self.linkages):
                tables[f"{axis}.displacements"] = np.ascontiguousarray(self.linkages[axis].displacements)
                tables[f"{axis}.joints"] = np.ascontiguousarray(self.linkages[axis].joints)
            files["linkages.safetensors"] = save(tables)
        return files


def plant_from_files(files: Mapping[str, bytes], reference: str = "") -> Plant:
    """The plant whose :meth:`Plant.to_files` these are.

    Raises:
        StoreError: the files are not a plant.
    """
    from safetensors import SafetensorError

    where = reference or "plant"
    if "plant.json" not in files:
        raise StoreError(where, "no plant.json among its files", "a plant version")
    try:
        content = parse_json(files["plant.json"])
        if content["schema"] not in (1, 2, 3):
            raise StoreError(where, f"schema {shown(content['schema'])}", "schema 1 to 3", "Update the toolkit.")
        return _plant_of(content, files, reference)
    except (ValueError, KeyError, TypeError, AttributeError, SafetensorError) as error:
        raise StoreError(where, f"not a plant ({type(error).__name__}: {error})", "a plant as it was stored") from None


def _plant_of(content: Mapping[str, Any], files: Mapping[str, bytes], reference: str) -> Plant:
    from safetensors.numpy import load

    machine = machine_from_files(content["machine_files"], where=reference or "plant")
    if (convention := content.get("convention", machine.convention)) not in (None, *get_args(Convention)):
        raise ValueError(f"convention {shown(convention)}")
    machine = replace(machine, convention=convention)
    tables = load(files["linkages.safetensors"]) if "linkages.safetensors" in files else {}
    axes = {key.rpartition(".")[0] for key in tables}
    linkages = {a: TabulatedLinkage(tables[f"{a}.displacements"], tables[f"{a}.joints"]) for a in sorted(axes)}
    effects = tuple(parse_settings(entry, KnownEffect, reference) for entry in content["effects"])
    streams = {stream: tuple(signals) for stream, signals in content.get("streams", {}).items()}
    known = uncertainty_from(content["uncertainty"]) if "uncertainty" in content else NONE
    residuals = from_files(content.get("residuals", ()), files, reference or "plant")
    return Plant(machine, linkages, effects, streams, known, content["origin"], reference, residuals)


def nominal_plant(
    machine: Machine,
    linkages: Mapping[str, CylinderJointMap] | None = None,
    streams: Streams | None = None,
    **origin: Any,
) -> Plant:
    """The plant that ``machine.toml`` describes.

    Args:
        linkages: fitted actuator networks by axis, for axes whose description has no linkage geometry.
        streams: signals of each stream of a dataset (``dataset.streams``), for effects of its clock.

    Raises:
        SettingsError: a linkage that depends on the past.
    """
    tables: dict[str, TabulatedLinkage] = {}
    for axis in machine.axes:
        if axis.drives != "cylinder" or axis.stroke is None:
            continue
        if axis.linkage is not None:
            tables[axis.name] = tabulate(TriangleLinkage(axis.linkage), axis.stroke)
        elif linkages is not None and axis.name in linkages:
            tables[axis.name] = tabulate(_static(machine, axis.name, linkages[axis.name]), axis.stroke)
    return Plant(machine, tables, machine.effects, streams or {}, NONE, origin)


def _static(machine: Machine, axis: str, found: CylinderJointMap) -> CylinderJointMap:
    """A linkage is a static map of positions; a dependence on the past is an effect of the plant (backlash)."""
    if isinstance(found, HistoryNetwork):
        remedy = "Hand over its `static` part; a plant has history as effects."
        where = f"machine {machine.name}: linkage of {axis}"
        raise SettingsError(where, "a network with history, whose joint depends on the past", "a static map", remedy)
    return found


def _parameter(place: PlantNumber) -> Parameter:
    forms = effect_named(place.effect).forms
    return next(p for form in forms for p in form.parameters if p.name == place.parameter)


def effect_key(item: KnownEffect) -> EffectKey:
    """Key of an instance: name, target, side."""
    return item.name, item.target, side_of(effect_named(item.name), item.side)


def effects_toml(effects: Sequence[KnownEffect]) -> str:
    """The ``[[effects]]`` part of a ``machine.toml``."""
    parts = []
    for item in effects:
        values = ", ".join(f"{toml_key(key)} = {_toml(value)}" for key, value in item.parameters.items())
        keys = {"name": item.name, "target": item.target} | ({"side": item.side} if item.side else {})
        lines = ["[[effects]]", *(f"{key} = {toml_value(text)}" for key, text in keys.items()), f"parameters = {{ {values} }}"]
        parts.append("\n".join(lines) + "\n")
    text = "\n".join(parts)
    tomllib.loads(text)
    return text


def _plain(value: Value) -> float | list[float]:
    array = np.asarray(value, dtype=np.float64)
    return float(array) if array.ndim == 0 else [float(x) for x in array]


def _toml(value: Value) -> str:
    array = np.asarray(value, dtype=np.float64)
    return f"{float(array):.6g}" if array.ndim == 0 else "[" + ", ".join(f"{x:.6g}" for x in array) + "]"
