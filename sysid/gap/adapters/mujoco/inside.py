"""Where an effect of a force axis has its place in an MJCF: joint, actuator, bodies.

Friction loss is MuJoCo's dry friction; damping acts beside what the actuator brakes by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sysid.gap.adapters.mujoco.force_axes import force_drives, moved_bodies
from sysid.gap.adapters.mujoco.native import Change
from sysid.machine import KnownEffect, Machine
from sysid.machine.sources.mjcf_actuator import Drive
from sysid.machine.sources.mjcf_model import body_name, mujoco_library


def write_inside(
    spec: Any, model: Any, machine: Machine, effects: Sequence[KnownEffect], source: str
) -> tuple[list[Change], list[KnownEffect]]:
    """Write the effects of force axes into ``spec``; ``model`` is compiled from it.

    Returns:
        What was written, and the effects for which MJCF has no place.
    """
    drives, written, left = force_drives(model, machine, source), list[Change](), list[KnownEffect]()
    for item in effects:
        writer = WRITERS.get(item.name)
        drive = drives.get(item.target)
        place = writer(spec, model, machine, drive, item) if writer is not None else None
        if place is None:
            left.append(item)
        else:
            written.append(Change(item, place))
    return written, left


def _value(item: KnownEffect, key: str) -> float:
    value = item.parameters[key]
    assert isinstance(value, float)
    return value


def _gear(model: Any, drive: Drive) -> float:
    return float(model.actuator_gear[int(model.actuator_outadr[drive.actuator]), 0])


def _damping(spec: Any, model: Any, machine: Machine, drive: Drive | None, item: KnownEffect) -> str | None:
    if drive is None or "coefficient" not in item.parameters:
        return None
    own = drive.damping + float(model.actuator_damping[drive.actuator]) * _gear(model, drive) ** 2
    value = _value(item, "coefficient") - own
    if value < 0.0:
        return None
    joint = spec.joints[drive.joint]
    joint.damping[0] = value
    return f'joint {joint.name}: damping="{value:.6g}"'


def _friction(spec: Any, model: Any, machine: Machine, drive: Drive | None, item: KnownEffect) -> str | None:
    if drive is None or "force" not in item.parameters:
        return None
    joint = spec.joints[drive.joint]
    joint.frictionloss = _value(item, "force")
    return f'joint {joint.name}: frictionloss="{joint.frictionloss:.6g}"'


def _bias(spec: Any, model: Any, machine: Machine, drive: Drive | None, item: KnownEffect) -> str | None:
    if drive is None:
        return None
    mujoco, actuator = mujoco_library(), spec.actuators[drive.actuator]
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = -_value(item, "force") / _gear(model, drive)
    return f'actuator {actuator.name}: biasprm="{actuator.biasprm[0]:.6g}"'


def _armature(spec: Any, model: Any, machine: Machine, drive: Drive | None, item: KnownEffect) -> str | None:
    inertia = machine.axis(item.target).inertia
    if drive is None or inertia is None:
        return None
    value = _value(item, "ratio") * inertia - float(model.actuator_armature[drive.actuator]) * _gear(model, drive) ** 2
    if value < 0.0:
        return None
    joint = spec.joints[drive.joint]
    joint.armature = value
    return f'joint {joint.name}: armature="{value:.6g}"'


def _mass(spec: Any, model: Any, machine: Machine, drive: Drive | None, item: KnownEffect) -> str | None:
    if drive is None:
        return None
    ratio, names = _value(item, "ratio"), []
    for body in moved_bodies(model, drive.joint):
        if model.body_mass[body] > 0.0:
            own = spec.bodies[body]
            own.explicitinertial, own.mass = True, ratio * float(model.body_mass[body])
            own.ipos, own.iquat = np.array(model.body_ipos[body]), np.array(model.body_iquat[body])
            own.inertia, own.fullinertia = ratio * np.array(model.body_inertia[body]), np.full(6, np.nan)
            names.append(body_name(model, body))
    return f"inertial of {', '.join(names)}: {ratio:.6g} times" if names else None


def _payload(spec: Any, model: Any, machine: Machine, drive: Drive | None, item: KnownEffect) -> str | None:
    sites = {site.name: site for site in spec.sites}
    bodies = {body.name: body for body in spec.bodies}
    mass, centre = _value(item, "mass"), np.asarray(item.parameters["centre"], dtype=np.float64)
    tip = machine.tip or ""
    if tip in sites:
        site = sites[tip]
        frame = site.parent.add_body(name="payload", pos=site.pos, quat=site.quat)
    elif tip in bodies:
        frame = bodies[tip].add_body(name="payload")
    else:
        return None
    frame.explicitinertial, frame.mass, frame.ipos = True, mass, centre
    frame.inertia = np.full(3, 1e-9)
    return f'body payload: mass="{mass:.6g}"'


#: Effect → writer of its place: ``writer(spec, model, machine, drive, effect)``; None where the model has none.
WRITERS: Mapping[str, Callable[[Any, Any, Machine, Drive | None, KnownEffect], str | None]] = {
    "viscous_friction": _damping,
    "coulomb_friction": _friction,
    "load_bias": _bias,
    "inertia_error": _armature,
    "link_mass_error": _mass,
    "payload": _payload,
}
