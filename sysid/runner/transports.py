"""Kinds of ``[transport]``: a name in the recipe → what builds it. Further kinds are entries of :data:`TRANSPORTS`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.config import STRICT, parse_settings
from sysid.errors import SettingsError, nearest
from sysid.plant import plant_from_files
from sysid.registry import Registry
from sysid.runner.assemble import Assembly
from sysid.runner.simulated import SimulatedTransport
from sysid.runner.transport import Transport


@dataclass(frozen=True)
class OpenTransport:
    """A transport, and whether nobody can be hurt at its other end: a simulated machine with switches of ours.

    Args:
        wired: there is a bus between, on which something may be swapped, turned round or out of scale.
        remarks: what the machine's side cannot check, a sentence each.
    """

    transport: Transport
    simulated: bool
    wired: bool = True
    remarks: tuple[str, ...] = ()


Build = Callable[[dict[str, Any], Assembly, Registry], OpenTransport]

#: ``module:function``, imported when it is asked for.
TRANSPORTS: dict[str, str] = {
    "simulated": "sysid.runner.transports:simulated",
    "can": "sysid.runner.transports:can",
    "slcan": "sysid.runner.transports:slcan",
}


def connect(assembly: Assembly, registry: Registry) -> OpenTransport:
    """The line of a recipe, not yet open.

    Raises:
        SettingsError: an unknown kind, or what that kind objects to.
    """
    values = dict(assembly.recipe.transport)
    kind = str(values.pop("kind"))
    if kind not in TRANSPORTS:
        raise SettingsError("transport.kind", repr(kind), nearest(kind, TRANSPORTS))
    module, _, name = TRANSPORTS[kind].partition(":")
    build: Build = getattr(importlib.import_module(module), name)
    return build(values, assembly, registry)


@dataclass(frozen=True)
class SimulatedSettings:
    """``[transport] kind = "simulated"``.

    Args:
        plant: version that plays the machine; else the one that the controller knows.
        joints: where it stands at first [rad or m]; else in the middle, or where the path begins.
        noise: sensors have that of the machine's description; ``seed`` of it.
    """

    __pydantic_config__ = STRICT

    plant: str = ""
    joints: tuple[float, ...] = ()
    noise: bool = True
    seed: int = 0


def simulated(values: dict[str, Any], assembly: Assembly, registry: Registry) -> OpenTransport:
    """The machine in process."""
    settings = parse_settings(values, SimulatedSettings, "transport")
    plant = assembly.loaded.plant
    if settings.plant:
        version = registry.load(settings.plant)
        if version.kind != "plant":
            raise SettingsError("transport.plant", f"{version.reference} is of kind {version.kind!r}", "a plant")
        plant = plant_from_files(version.files, version.reference)
    joints = np.array(settings.joints) if settings.joints else assembly.middle
    if joints.shape != (len(plant.machine.axes),):
        raise SettingsError("transport.joints", f"{len(joints)} values", f"{len(plant.machine.axes)}")
    return OpenTransport(
        SimulatedTransport(plant, joints, noise=settings.noise, seed=settings.seed), simulated=True, wired=False
    )


def can(values: dict[str, Any], assembly: Assembly, registry: Registry) -> OpenTransport:
    """A machine on a CAN bus; one with a control pipe is the simulated test bench, whose switches the pipe holds."""
    from sysid.runner.can import CanSettings, CanTransport

    where = "transport"
    settings = parse_settings(values, CanSettings, where)
    axes = assembly.machine.axis_names
    if sorted(settings.valves) != sorted(axes):
        raise SettingsError(f"{where}.valves", ", ".join(settings.valves) or "none", f"one each for {', '.join(axes)}")
    settings = replace(
        settings,
        database=assembly.folder / settings.database,
        control=assembly.folder / settings.control if settings.control is not None else None,
        valves={axis: settings.valves[axis] for axis in axes},
    )
    transport = CanTransport(settings, where)
    return OpenTransport(transport, simulated=settings.control is not None, remarks=transport.remarks)


def slcan(values: dict[str, Any], assembly: Assembly, registry: Registry) -> OpenTransport:
    """The same through an adapter on a serial line."""
    return can(values | {"interface": "slcan"}, assembly, registry)
