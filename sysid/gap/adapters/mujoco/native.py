"""Where effects have their place in an MJCF: actuators for input effects; joints, actuators and bodies for those of force axes.

Input effects act before everything inside the model, in the order of the catalogue. An effect may move into the actuator if all
that act after it on the same axis move too; a delay moves in any case, since it commutes with time-invariant effects.

Friction loss is MuJoCo's dry friction; damping acts beside what an actuator without a controller brakes by itself.

Adjusted inertial parameters are those of bodies, rotors and force constants of a whole arm. They hold together only, so that
all of them are written or none. The body of a joint gets the mass, centre and inertia of all that moves with it; bodies fixed
to it keep none. Where an axis has a force constant, its actuator makes so much less of its control, and armature, damping, dry
friction and constant load, which were found in the unit of the commands, are divided by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import CATALOGUE, effect_named, payload
from sysid.gap.adapters.mujoco.simulator import drives_of, gear_of
from sysid.machine import KnownEffect, Machine
from sysid.machine.sources.mjcf_actuator import Drive
from sysid.machine.sources.mjcf_model import body_name, joint_name, joints_of, mujoco_library
from sysid.plant import Plant, compile_plant
from sysid.plant.arm_inertia import Inertial, arm_inertia

Array = npt.NDArray[np.float64]

#: Interpolation of a delayed control between the samples of its history: linear, so that a delay need not be whole steps.
LINEAR = 1
#: The effect that states adjusted inertial parameters, those that are written with it, and those in the unit of the commands.
ADJUSTED, TOGETHER = "inertial_error", ("inertial_error", "link_mass_error", "inertia_error")
FORCES = ("viscous_friction", "coulomb_friction", "load_bias")
#: Relative difference of a mass of the model and of the plant.
SAME = 1e-6


@dataclass(frozen=True)
class Change:
    """An effect that was written into the model, and the attribute that holds it now."""

    effect: KnownEffect
    where: str


@dataclass(frozen=True)
class Place:
    """Where an effect of an axis goes: the ``drive`` of the axis in ``spec``, from which ``model`` is compiled."""

    spec: Any
    model: Any
    machine: Machine
    drive: Drive
    item: KnownEffect

    @property
    def actuator(self) -> Any:
        return self.spec.actuators[self.drive.actuator]

    @property
    def joint(self) -> Any:
        return self.spec.joints[self.drive.joint]

    @property
    def gear(self) -> float:
        return gear_of(self.model, self.drive.actuator)

    @property
    def name(self) -> str:
        """Of the actuator, or its number."""
        return str(self.actuator.name or self.drive.actuator)

    def value(self, key: str) -> float:
        return value_of(self.item, key)

    def with_armature(self, armature: float) -> str | None:
        """Write an armature; None where the actuator alone has more."""
        value = joint_armature(self.model, self.drive, armature)
        if value < 0.0:
            return None
        self.joint.armature = value
        return f'joint {self.joint.name}: armature="{value:.6g}"'


def write_native(
    spec: Any, model: Any, machine: Machine, effects: Sequence[KnownEffect], source: str
) -> tuple[list[Change], list[KnownEffect]]:
    """Write what has a native place at the inputs of ``spec``; ``model`` is compiled from it.

    Returns:
        What was written, and the effects that remain beside the model.
    """
    order, drives = {effect.name: k for k, effect in enumerate(CATALOGUE)}, drives_of(model, machine, source)
    written, beside = list[Change](), [item for item in effects if item.target not in drives]
    for axis, drive in drives.items():
        own, open_end = sorted((item for item in effects if item.target == axis), key=lambda item: order[item.name]), True
        for item in reversed(own):
            writer, place = INPUT_WRITERS.get(item.name), Place(spec, model, machine, drive, item)
            moves = open_end or item.name == "input_delay"
            where = writer(place) if writer is not None and moves else None
            if where is not None:
                written.append(Change(item, f"{place.name}: {where}"))
                continue
            beside.append(item)
            open_end = open_end and effect_named(item.name).stage != "command"
    return written, sorted(beside, key=lambda item: order[item.name])


def _delay(place: Place) -> str | None:
    actuator, step = place.actuator, float(place.spec.option.timestep)
    delay = float(actuator.delay) + place.value("delay")
    if delay < step:  # between the last two controls MuJoCo takes the older one: a whole step
        return None
    actuator.delay = delay
    actuator.interp = LINEAR
    actuator.nsample = max(int(actuator.nsample), math.ceil(actuator.delay / step) + 2)
    return f'delay="{actuator.delay:.6g}"'


def _lag(place: Place) -> str | None:
    mujoco, actuator = mujoco_library(), place.actuator
    if actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE or actuator.gaintype != mujoco.mjtGain.mjGAIN_FIXED:
        return None
    actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
    actuator.dynprm[0] = place.value("time_constant")
    actuator.actearly = True  # otherwise the filter acts a step late, which is a dead time beside the lag
    return f'dyntype="filterexact" dynprm="{actuator.dynprm[0]:.6g}" actearly="true"'


def _gain(place: Place) -> str | None:
    if place.drive.control != "speed":
        return None
    actuator = place.actuator
    actuator.gainprm[0] = float(actuator.gainprm[0]) * place.value("ratio")
    return f'gainprm="{actuator.gainprm[0]:.6g}"'


#: Writes an effect; returns the attribute that holds it, None where the model has no place for it.
Writer = Callable[[Place], str | None]
#: Effect → writer of its place in an actuator.
INPUT_WRITERS: Mapping[str, Writer] = {"input_delay": _delay, "first_order_lag": _lag, "gain_error": _gain}


def write_inside(
    spec: Any, model: Any, machine: Machine, effects: Sequence[KnownEffect], source: str
) -> tuple[list[Change], list[KnownEffect]]:
    """Write the effects of force axes into ``spec``; ``model`` is compiled from it.

    Returns:
        What was written, and the effects for which MJCF has no place.
    """
    drives, written, left = drives_of(model, machine, source), list[Change](), list[KnownEffect]()
    for item in effects:
        where = None
        if item.name == payload.EFFECT.name:
            where = _payload(spec, machine, item)
        elif item.name in FORCE_WRITERS and item.target in drives:
            where = FORCE_WRITERS[item.name](Place(spec, model, machine, drives[item.target], item))
        if where is None:
            left.append(item)
        else:
            written.append(Change(item, where))
    return written, left


def _damping(place: Place) -> str | None:
    coefficient, drive = _both_ways(place.item, "coefficient"), place.drive
    if coefficient is None:
        return None
    own = float(place.model.actuator_damping[drive.actuator]) * place.gear**2
    own += drive.damping if drive.control == "force" else 0.0  # of a servo it is that of the controller
    value = coefficient - own
    if value < 0.0:
        return None
    place.joint.damping[0] = value
    return f'joint {place.joint.name}: damping="{value:.6g}"'


def _friction(place: Place) -> str | None:
    force = _both_ways(place.item, "force")
    if force is None:
        return None
    place.joint.frictionloss = force
    return f'joint {place.joint.name}: frictionloss="{place.joint.frictionloss:.6g}"'


def _bias(place: Place) -> str | None:
    actuator = place.actuator
    actuator.biastype = mujoco_library().mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = -place.value("force") / place.gear
    return f'actuator {actuator.name}: biasprm="{actuator.biasprm[0]:.6g}"'


def _armature(place: Place) -> str | None:
    inertia = place.machine.axis(place.item.target).inertia
    return None if inertia is None else place.with_armature(place.value("ratio") * inertia)


def _mass(place: Place) -> str | None:
    model, ratio, names = place.model, place.value("ratio"), []
    for body in moved_bodies(model, place.drive.joint):
        if model.body_mass[body] > 0.0:
            own = place.spec.bodies[body]
            own.explicitinertial, own.mass = True, ratio * float(model.body_mass[body])
            own.ipos, own.iquat = np.array(model.body_ipos[body]), np.array(model.body_iquat[body])
            own.inertia, own.fullinertia = ratio * np.array(model.body_inertia[body]), np.full(6, np.nan)
            names.append(body_name(model, body))
    return f"inertial of {', '.join(names)}: {ratio:.6g} times" if names else None


def _payload(spec: Any, machine: Machine, item: KnownEffect) -> str | None:
    sites = {site.name: site for site in spec.sites}
    bodies = {body.name: body for body in spec.bodies}
    mass, centre = value_of(item, "mass"), np.asarray(item.parameters["centre"], dtype=np.float64)
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


#: Effect → writer of its place at a force axis.
FORCE_WRITERS: Mapping[str, Writer] = {
    "viscous_friction": _damping,
    "coulomb_friction": _friction,
    "load_bias": _bias,
    "inertia_error": _armature,
    "link_mass_error": _mass,
}
#: Effects that :func:`write_inside` has a place for.
INSIDE = (*FORCE_WRITERS, payload.EFFECT.name)


def write_inertials(spec: Any, model: Any, plant: Plant, source: str) -> list[Change] | None:
    """Write the inertial parameters of a plant into ``spec``, in which its friction and loads have been written.

    Args:
        model: compiled from the model before any change, of which ``plant`` is the repaired one.

    Returns:
        What was written; None, and nothing is changed, where the model has no place for a part of it.
    """
    drives, found = drives_of(model, plant.machine, source), arm_inertia(plant)
    bodies = _bodies(model, plant, found.bodies)
    scales = dict(zip(drives, found.scales, strict=True))
    rotors = {axis: joint_armature(model, drives[axis], own) for axis, own in zip(drives, found.armatures, strict=True)}
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
    return [Change(item, _place(model, drives[item.target], item)) for item in plant.effects if item.name in TOGETHER]


def in_command_units(plant: Plant, adjusted: Sequence[KnownEffect]) -> Plant:
    """The plant of the written model for the commands that were recorded before its force constants changed.

    Args:
        plant: of the written model, loaded again; ``adjusted``: the :data:`ADJUSTED` effects in it.
    """
    for item in adjusted:
        scale = value_of(item, "scale")
        for own in [e for e in plant.effects if e.target == item.target and e.name in FORCES]:
            plant = plant.with_effect(replace(own, parameters={key: scale * float(v) for key, v in own.parameters.items()}))  # type: ignore[arg-type]
        axis = plant.machine.axis(item.target)
        values: dict[str, float | list[float]] = {"mass": 0.0, "first_moment": [0.0] * 3, "inertia": [0.0] * 6, "scale": scale}
        values["rotor"] = (scale - 1.0) * (axis.inertia or 0.0)
        plant = plant.with_effect(KnownEffect(ADJUSTED, item.target, values))
    return plant


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


def _scalable(model: Any, drive: Drive) -> bool:
    """Whether the actuator adds no inertia or damping of its own, which would have another constant."""
    return not any((model.actuator_armature[drive.actuator], model.actuator_damping[drive.actuator], drive.damping))


def _place(model: Any, drive: Drive, item: KnownEffect) -> str:
    joint = joint_name(model, drive.joint)
    if item.name == "inertia_error":
        return f"joint {joint}: armature"
    names = [body_name(model, k) for k in moved_bodies(model, drive.joint) if model.body_mass[k] > 0.0]
    places = [f"inertial of {', '.join(names)}"] if names else []
    if item.name == ADJUSTED:
        places.append(f"armature of joint {joint}")
        if item.parameters["scale"] != 1.0:
            places.append(f"gain of its actuator divided by {value_of(item, 'scale'):.6g}")
    return ", ".join(places)


def moved_bodies(model: Any, joint: int) -> Sequence[int]:
    """Bodies that move with a joint and no further one."""
    root = int(model.jnt_bodyid[joint])
    found = [root]
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in found and model.body_jntnum[body] == 0:
            found.append(body)
    return found


def _both_ways(item: KnownEffect, key: str) -> float | None:
    """A value that holds for both directions; None where they differ, which a joint of MuJoCo cannot express."""
    values = {float(np.asarray(item.parameters[name])) for name in (key, "positive", "negative") if name in item.parameters}
    return values.pop() if len(values) == 1 else None


def value_of(item: KnownEffect, key: str) -> float:
    return float(np.asarray(item.parameters[key]))


def joint_armature(model: Any, drive: Drive, armature: float) -> float:
    """What the joint has of an armature, beside the actuator."""
    return float(armature) - float(model.actuator_armature[drive.actuator]) * gear_of(model, drive.actuator) ** 2
