"""A machine drafted from an MJCF: axes, their drives, what the model says of friction, lag and sag, and its URDF.

A servo of stiffness k and damping d on an inertia J follows its setpoint with a second-order lag of time constant √(J/k)
and damping ratio d/(2·√(k·J)), and sags by 1/k for each N·m of load (Siciliano et al., Robotics, 2009, §8.3). A speed loop
of damping d follows with the time constant J/d. J is the diagonal of the mass matrix at the model's reference pose.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import SettingsError
from sysid.foreign import shown
from sysid.machine.description import KnownEffect
from sysid.machine.sources.draft import WITHOUT_STOPS, AxisDraft, MachineDraft, axis_names, summarised
from sysid.machine.sources.mjcf_actuator import Drive, drive_of
from sysid.machine.sources.mjcf_chain import Chain, crossed_joints, find_chain, named_point
from sysid.machine.sources.mjcf_model import actuator_name, joint_name, load_mjcf, mujoco_library, path_to
from sysid.machine.sources.mjcf_urdf import write_urdf

#: A kind of part that ``machine.toml`` does not contain, and the name of one.
Note = tuple[str, str]
#: A loop with a larger damping ratio follows as a first-order lag.
_OSCILLATES = 0.6
#: Bounds of the damping ratio of a second-order lag, and of its time constant [s].
_RATIOS, _SLOWEST = (0.03, 4.0), 0.5
#: Share of gravity below which a body counts as weightless, and that may act sideways: a tenth of what a force is compared to.
_WEIGHTLESS = 1e-3


def mjcf_draft(path: Path, tip: str | None = None, tool: str | None = None) -> MachineDraft:
    """The machine that an MJCF describes.

    Args:
        tip: site or body of the end effector; else the end of the longest driven chain.
        tool: site or body of a hanging tool.

    Raises:
        InputError: not a file that MuJoCo compiles.
        SettingsError: what ``machine.toml`` cannot express.
    """
    model, source = load_mjcf(path), path.name
    chain = find_chain(model, source, tip)
    drives = [drive_of(model, joint.actuator, source) for joint in chain.driven if joint.actuator is not None]
    names = axis_names([joint_name(model, drive.joint) for drive in drives], source)
    hanging = None if tool is None else named_point(model, tool, f"{source}: tool")
    if hanging is not None and chain.bodies[0] not in path_to(model, hanging[0]):
        raise SettingsError(
            f"{source}: tool", f"{shown(tool or '')} does not hang on the chain", "a site or body that it moves"
        )
    urdf, (link, hung), notes = write_urdf(model, chain, path.stem, hanging)
    axes, beyond = [], list[Note]()
    for drive in drives:
        axis, missing = _axis(model, drive, names[joint_name(model, drive.joint)])
        axes.append(axis)
        beyond += missing
    beyond += _beside(model, chain)
    notes = [*_gravity_notes(model, chain, drives, source), *notes, *summarised(beyond)]
    return MachineDraft(source, tuple(axes), urdf, link, hung, tuple(notes))


def _axis(model: Any, drive: Drive, name: str) -> tuple[AxisDraft, list[Note]]:
    joint, dof = drive.joint, int(model.jnt_dofadr[drive.joint])
    its = joint_name(model, joint)
    straight = int(model.jnt_type[joint]) == mujoco_library().mjtJoint.mjJNT_SLIDE
    damping, friction = float(model.dof_damping[dof] + _actuators(model, drive, "damping")), float(model.dof_frictionloss[dof])
    limits, notes = None, list[Note]()
    actuator = actuator_name(model, drive.actuator)
    if not model.jnt_limited[joint]:
        most = WITHOUT_STOPS["prismatic" if straight else "revolute"]
        limits = (-most, most)
    notes += [("spring of", its)] if model.jnt_stiffness[joint] or np.any(model.jnt_stiffnesspoly[joint]) else []
    notes += [("damping above first order of", its)] if np.any(model.dof_dampingpoly[dof]) else []
    notes += [("force limit of", its)] if model.actuator_forcelimited[drive.actuator] or model.jnt_actfrclimited[joint] else []
    inertia = None
    effects: list[KnownEffect] = []
    if drive.actuation == "force":
        armature = float(model.dof_armature[dof] + _actuators(model, drive, "armature"))
        inertia = armature or None
        braked = damping + drive.damping
        effects += [KnownEffect("viscous_friction", name, {"coefficient": braked})] if braked > 0.0 else []
        effects += [KnownEffect("coulomb_friction", name, {"force": friction})] if friction > 0.0 else []
        effects += [KnownEffect("load_bias", name, {"force": -drive.bias})] if drive.bias else []
        notes += [("delay of actuator", actuator)] if drive.delay else []
        notes += [("filter of actuator", actuator)] if drive.filter else []
    else:
        effects += [KnownEffect("input_delay", name, {"delay": drive.delay})] if drive.delay > 0.0 else []
        effects += [KnownEffect("command_rate_limit", name, {"rate": drive.rate})] if drive.rate > 0.0 else []
        found, missing = _loop(model, drive, name, damping)
        effects += found
        notes += missing
        notes += [("friction loss inside the control loop of", its)] if friction > 0.0 else []
        notes += [("constant force of actuator", actuator)] if drive.bias else []
    gain = drive.speed * (drive.damping / (drive.damping + damping) if drive.control == "speed" else 1.0)
    about = f"actuator {actuator} ({drive.control} control)"
    return AxisDraft(name, its, drive.actuation, about, gain, inertia, limits, tuple(effects)), notes


def _loop(model: Any, drive: Drive, name: str, damping: float) -> tuple[list[KnownEffect], list[Note]]:
    """Lag and sag of a control loop on the inertia at the reference pose, for a joint ``damping`` beside its own."""
    inertia = float(model.dof_M0[model.jnt_dofadr[drive.joint]])
    effects, notes = list[KnownEffect](), list[Note]()
    lags = [drive.filter] if drive.filter > 0.0 else []
    braked = drive.damping + damping
    if drive.control == "speed":
        lags.append(inertia / braked)
    elif drive.stiffness > 0.0:
        time, ratio = math.sqrt(inertia / drive.stiffness), braked / (2.0 * math.sqrt(drive.stiffness * inertia))
        if drive.control == "position":
            if _RATIOS[0] <= ratio <= _RATIOS[1] and time <= _SLOWEST:
                effects.append(KnownEffect("second_order_lag", name, {"time_constant": time, "damping_ratio": ratio}))
            elif ratio > _RATIOS[1]:
                lags.append(2.0 * ratio * time)
            else:
                notes.append((f"a resonance (damping ratio {ratio:.2g}, time constant {time:.2g} s) of", name))
            if not drive.integral and _loaded(model, drive.joint):
                effects.append(KnownEffect("joint_compliance", name, {"compliance": 1.0 / drive.stiffness}, "drive"))
        elif ratio < _OSCILLATES:
            frequency = 1.0 / (2.0 * math.pi * time)
            effects.append(
                KnownEffect("oil_compressibility", name, {"frequency": frequency, "damping_ratio": max(ratio, 0.005)})
            )
        else:
            lags.append(2.0 * ratio * time)
    if drive.integral:
        notes.append(("integral action of", name))
    if lags:
        effects.append(KnownEffect("first_order_lag", name, {"time_constant": sum(lags)}))
    return effects, notes


def _actuators(model: Any, drive: Drive, key: str) -> float:
    """Damping or armature that the actuator adds to its joint: ``value·gear²``."""
    gear = float(model.actuator_gear[int(model.actuator_outadr[drive.actuator]), 0])
    return float(getattr(model, f"actuator_{key}")[drive.actuator]) * gear**2


def _loaded(model: Any, joint: int) -> bool:
    """Whether bodies that the joint moves have weight."""
    if float(np.linalg.norm(model.opt.gravity)) < _WEIGHTLESS:
        return False
    root = int(model.jnt_bodyid[joint])
    for body in range(root, model.nbody):
        above = body
        while above > root:
            above = int(model.body_parentid[above])
        if above == root and abs(1.0 - float(model.body_gravcomp[body])) > _WEIGHTLESS and model.body_mass[body] > 0.0:
            return True
    return False


def _gravity_notes(model: Any, chain: Chain, drives: list[Drive], source: str) -> list[str]:
    """What differs from gravity along −z of the world.

    Raises:
        SettingsError: forces include weight that the model does not have.
    """
    gravity = np.asarray(model.opt.gravity, dtype=np.float64)
    down = gravity[2] < 0.0 and abs(gravity[:2]).max() < _WEIGHTLESS * abs(gravity[2])
    bodies = [body for body in range(chain.bodies[0], model.nbody) if model.body_mass[body] > 0.0]
    compensated = any(abs(float(model.body_gravcomp[body])) > _WEIGHTLESS for body in bodies)
    if down and not compensated:
        return []
    found = "gravity compensation of its bodies" if down else f"gravity {gravity.tolist()} m/s²"
    turning = [drive for drive in drives if int(model.jnt_type[drive.joint]) == mujoco_library().mjtJoint.mjJNT_HINGE]
    if any(drive.actuation == "force" for drive in drives) and (turning or not down):
        expected = "gravity along −z of the world, which the nominal plant has, and no compensation"
        remedy = "Turn the model so that z points up, and let the controller compensate the weight."
        raise SettingsError(f"{source}: {shown('option')}", found, expected, remedy)
    return [f"{found}: the nominal plant has weight along −z"]


def _beside(model: Any, chain: Chain) -> list[Note]:
    """Actuators and tendons that are not part of the axes."""
    own, joints = {joint.actuator for joint in chain.driven}, [joint.joint for joint in chain.joints]
    notes = [("actuators beside the chain:", actuator_name(model, k)) for k in range(model.nactuator) if k not in own]
    for tendon in range(model.ntendon):
        if crossed_joints(model, tendon, joints):
            notes.append(("tendons across its joints:", str(model.tendon(tendon).name) or str(tendon)))
    return notes
