"""Kinds of ``[transport]``; further kinds are entries of :data:`TRANSPORTS`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.config import Strict, parse_settings
from sysid.errors import SettingsError, nearest
from sysid.plant import plant_from_files
from sysid.registry import Registry
from sysid_rl.run.assemble import Assembly
from sysid_rl.run.simulated import SimulatedTransport
from sysid_rl.run.transport import Transport


@dataclass(frozen=True)
class OpenTransport:
    """A transport and its properties.

    Args:
        simulated: a simulated machine, whose switches a program may set.
        wired: it has a bus, on which signals may be swapped, reversed or wrongly scaled.
        remarks: what the machine cannot check, one sentence each.
    """

    transport: Transport
    simulated: bool
    wired: bool = True
    remarks: tuple[str, ...] = ()


Build = Callable[[dict[str, Any], Assembly, Registry], OpenTransport]

#: ``module:function``, imported on demand.
TRANSPORTS: dict[str, str] = {
    "simulated": "sysid_rl.run.transports:simulated",
    "can": "sysid_rl.run.transports:can",
    "slcan": "sysid_rl.run.transports:slcan",
}


def connect(assembly: Assembly, registry: Registry) -> OpenTransport:
    """The transport of a recipe, not yet open.

    Raises:
        SettingsError: an unknown kind, invalid settings of that kind, or a transport that does not fit the machine.
    """
    values = dict(assembly.recipe.transport)
    kind = str(values.pop("kind"))
    if kind not in TRANSPORTS:
        raise SettingsError("transport.kind", repr(kind), nearest(kind, TRANSPORTS))
    module, _, name = TRANSPORTS[kind].partition(":")
    build: Build = getattr(importlib.import_module(module), name)
    line = build(values, assembly, registry)
    assembly.check_transport(line.transport)
    return line


@dataclass(frozen=True)
class SimulatedSettings(Strict):
    """``[transport] kind = "simulated"``.

    Args:
        plant: version that simulates the machine; by default the controller's.
        joints: initial ones [rad or m]; by default the start of the path, or the middle of the limits.
        noise: sensors have the noise of the machine's description; ``seed`` of it.
    """

    plant: str = ""
    joints: tuple[float, ...] = ()
    noise: bool = True
    seed: int = 0


def simulated(values: dict[str, Any], assembly: Assembly, registry: Registry) -> OpenTransport:
    """The simulated machine."""
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
    """A machine on a CAN bus; with a control pipe, the simulated test bench."""
    from sysid_rl.run.can import CanSettings, CanTransport

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
    """A machine on a CAN bus, through an adapter on a serial line."""
    return can(values | {"interface": "slcan"}, assembly, registry)
