"""Adjusted inertial parameters in an MJCF: bodies, rotors and force constants of a whole arm at once.

They hold together only, so that all of them are written or none. The body of a joint gets the mass, centre and inertia of all
that moves with it; bodies fixed to it keep none. Where an axis has a force constant, its actuator makes so much less of its
control, and armature, damping, dry friction and constant load, which were found in the unit of the commands, are divided by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.gap.adapters.mujoco.force_axes import force_drives, moved_bodies
from sysid.gap.adapters.mujoco.native import Change
from sysid.machine import KnownEffect, Machine
from sysid.machine.sources.mjcf_actuator import Drive
from sysid.machine.sources.mjcf_model import body_name, joint_name, joints_of, mujoco_library
from sysid.plant import Plant, compile_plant
from sysid.plant.arm_inertia import Inertial, arm_inertia

Array = npt.NDArray[np.float64]

#: The effect that states them, and those that are written with it.
ADJUSTED, TOGETHER = "inertial_error", ("inertial_error", "link_mass_error", "inertia_error")
#: Relative difference of a mass of the model and of the plant.
SAME = 1e-6


def write_inertials(spec: Any, model: Any, plant: Plant, source: str) -> list[Change] | None:
    """Write the inertial parameters of a plant into ``spec``, in which its friction and loads have been written.

    Args:
        model: compiled from the model before any change, of which ``plant`` is the repaired one.

    Returns:
        What was written; None, and nothing is changed, where the model has no place for a part of it.
    """
    drives = force_drives(model, plant.machine, source)
    found = arm_inertia(plant)
    bodies = _bodies(model, plant, found.bodies)
    armatures = dict(zip(plant.machine.axis_names, found.armatures, strict=True))
    scales = dict(zip(plant.machine.axis_names, found.scales, strict=True))
    rotors = {axis: _joint_armature(model, drives[axis], value) for axis, value in armatures.items()}
    if bodies is None or any(value < 0.0 for value in rotors.values()):
        return None
    if any(scales[axis] != 1.0 and not _scalable(model, drive) for axis, drive in drives.items()):
        return None
    for root, own in bodies.items():
        _write_body(spec, model, root, own)
    for axis, drive in drives.items():
        joint, actuator, scale = spec.joints[drive.joint], spec.actuators[drive.actuator], float(scales[axis])
        joint.armature = rotors[axis]
        if scale != 1.0:
            joint.damping[0] /= scale
            joint.frictionloss /= scale
            actuator.gainprm[0] /= scale
            actuator.biasprm[0] /= scale
    return [Change(item, _place(model, plant.machine, drives, item)) for item in plant.effects if item.name in TOGETHER]


def in_command_units(plant: Plant, adjusted: Sequence[KnownEffect]) -> Plant:
    """The plant of the written model for the commands that were recorded before its force constants changed.

    Args:
        plant: of the written model, loaded again; ``adjusted``: the :data:`ADJUSTED` effects in it.
    """
    for item in adjusted:
        scale = float(np.asarray(item.parameters["scale"]))
        for own in [e for e in plant.effects if e.target == item.target and e.name in _FORCES]:
            plant = plant.with_effect(replace(own, parameters={key: scale * float(v) for key, v in own.parameters.items()}))  # type: ignore[arg-type]
        axis = plant.machine.axis(item.target)
        values: dict[str, float | list[float]] = {"mass": 0.0, "first_moment": [0.0] * 3, "inertia": [0.0] * 6, "scale": scale}
        values["rotor"] = (scale - 1.0) * (axis.inertia or 0.0)
        plant = plant.with_effect(KnownEffect(ADJUSTED, item.target, values))
    return plant


_FORCES = ("viscous_friction", "coulomb_friction", "load_bias")


def _bodies(model: Any, plant: Plant, found: Mapping[str, Inertial]) -> dict[int, Inertial] | None:
    """Body of each joint that carries a mass → its inertial, in the axes and about the origin of the body."""
    rigid = compile_plant(plant).rigid
    assert rigid is not None
    joints = {joint_name(model, k): k for k in range(model.njnt)}
    out: dict[int, Inertial] = {}
    for name, nominal in zip(rigid.names, rigid.nominal, strict=True):
        own = found[name]
        if own.mass == 0.0 and not nominal.any():
            continue
        joint = joints.get(name)
        if joint is None:
            return None
        body = int(model.jnt_bodyid[joint])
        mass = float(sum(model.body_mass[k] for k in moved_bodies(model, joint)))
        # The link of a body with several joints has its origin at the anchor of the last one and carries the mass.
        if joint != joints_of(model, body)[-1] or abs(mass - nominal[0]) > SAME * max(mass, nominal[0]):
            return None
        out[body] = replace(own, centre=own.centre + np.asarray(model.jnt_pos[joint]))
    return out


def _write_body(spec: Any, model: Any, root: int, own: Inertial) -> None:
    values, axes = np.linalg.eigh(own.moments)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    turn = np.zeros(4)
    mujoco_library().mju_mat2Quat(turn, np.ascontiguousarray(axes).ravel())
    joint = joints_of(model, root)[-1]
    for body in moved_bodies(model, joint):
        element = spec.bodies[body]
        element.explicitinertial, element.fullinertia = True, np.full(6, np.nan)
        if body == root:
            element.mass, element.ipos, element.iquat, element.inertia = own.mass, own.centre, turn, values
        else:
            element.mass, element.inertia = 0.0, np.zeros(3)
            element.ipos, element.iquat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])


def _joint_armature(model: Any, drive: Drive, armature: float) -> float:
    """What the joint has of an armature, beside the actuator."""
    gear = float(model.actuator_gear[int(model.actuator_outadr[drive.actuator]), 0])
    return float(armature) - float(model.actuator_armature[drive.actuator]) * gear**2


def _scalable(model: Any, drive: Drive) -> bool:
    """Whether the actuator adds no inertia or damping of its own, which would have another constant."""
    own = float(model.actuator_armature[drive.actuator]), float(model.actuator_damping[drive.actuator]), drive.damping
    return not any(own)


def _place(model: Any, machine: Machine, drives: Mapping[str, Drive], item: KnownEffect) -> str:
    drive = drives[item.target]
    joint = joint_name(model, drive.joint)
    if item.name == "inertia_error":
        return f"joint {joint}: armature"
    names = [body_name(model, k) for k in moved_bodies(model, drive.joint) if model.body_mass[k] > 0.0]
    places = [f"inertial of {', '.join(names)}"] if names else []
    if item.name == ADJUSTED:
        places.append(f"armature of joint {joint}")
        if item.parameters["scale"] != 1.0:
            places.append(f"gain of its actuator divided by {float(np.asarray(item.parameters['scale'])):.6g}")
    return ", ".join(places)
