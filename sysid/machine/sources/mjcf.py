"""A machine drafted from an MJCF: axes, their drives, what the model says of friction, lag and sag, and its URDF.

A servo of stiffness k and damping d on an inertia J follows its setpoint with a second-order lag of time constant √(J/k)
and damping ratio d/(2·√(k·J)), and sags by 1/k for each N·m of load (Siciliano et al., Robotics, 2009, §8.3). A speed loop
of damping d follows with the time constant J/d. J is the diagonal of the mass matrix at the model's reference pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import SettingsError, UnknownDriveError
from sysid.foreign import shown
from sysid.machine.description import Actuation, KnownEffect
from sysid.machine.kinematics import GRAVITY
from sysid.machine.sources.draft import (
    RESPONSE,
    AxisDraft,
    MachineDraft,
    axis_names,
    draft_of,
    known_effects,
    limit_notes,
    stops,
    summarised,
)
from sysid.machine.sources.mjcf_actuator import (
    Drive,
    dead_time,
    drive_of,
    gear_of,
    servo_law,
    setpoint_lag,
    why_no_servo,
)
from sysid.machine.sources.mjcf_chain import (
    Chain,
    ChainJoint,
    Chains,
    crossed_joints,
    equalities_off,
    joint_equalities,
    named_point,
)
from sysid.machine.sources.mjcf_model import (
    actuator_name,
    backlash_of,
    joint_name,
    joints_of,
    mujoco_library,
    path_to,
    read_mjcf,
)
from sysid.machine.sources.mjcf_urdf import write_urdf
from sysid.names import listed
from sysid.numbers import end_stops

#: A kind of part that ``machine.toml`` does not contain, and the name of one.
Note = tuple[str, str]
#: Number of the actuator of a joint without one.
NO_ACTUATOR = -1
#: A loop with a larger damping ratio follows as a first-order lag.
_OSCILLATES = 0.6
#: Bounds of the damping ratio of a second-order lag, and of its time constant [s].
_RATIOS, _SLOWEST = (0.03, 4.0), 0.5
#: Share of gravity below which a body counts as weightless, and that may act sideways: a tenth of what a force is compared to.
_WEIGHTLESS = 1e-3
#: Difference of a setpoint limit and an end stop that counts as none [rad or m].
_SAME = 1e-3
#: Smallest and largest gravity that is weight [m/s²]: from that of small bodies to that of giant planets.
_GRAVITY = (1e-3, 100.0)


def mjcf_draft(
    path: Path,
    tip: str | None = None,
    tool: str | None = None,
    kind: str | None = None,
    base: str | None = None,
    assets: Sequence[Path] | None = (),
) -> MachineDraft:
    """The machine that an MJCF describes.

    Args:
        tip: site or body of the end effector; else the end of the longest driven chain.
        tool: site or body of a hanging tool.
        kind: how joints without an actuator are commanded, of :data:`~sysid.machine.sources.draft.KINDS`; or ``RESPONSE``:
            servos are described by their responses.
        base: body that is held still at its reference pose.
        assets: folders beside that of the model whose files may be opened.

    Raises:
        InputError: not a file that MuJoCo compiles.
        SettingsError: what ``machine.toml`` cannot express.
    """
    read, source = read_mjcf(path, assets), path.name
    by_response, kind = kind == RESPONSE, None if kind == RESPONSE else kind
    model = read.model
    switched_off = _switch_off(model)
    chains = Chains(model, source, base, undriven=kind is not None)
    if kind is None and not chains.ends:
        chains = Chains(model, source, base, undriven=True)
    made = draft_of(
        [chains.at(tip)] if tip is not None else chains.ends,
        lambda choice, its_kind: _draft(model, chains.chain(choice), source, path.stem, tool, its_kind, by_response),
        chains.at,
        source,
        kind,
    )
    return replace(made, left_out=(*read.left_out, *switched_off, *made.left_out))


def _draft(
    model: Any, chain: Chain, source: str, stem: str, tool: str | None, kind: str | None, by_response: bool
) -> MachineDraft:
    drives = [_drive(model, joint, source, kind) for joint in chain.driven]
    names = axis_names([joint_name(model, drive.joint) for drive in drives])
    hanging = None if tool is None else named_point(model, tool, f"{source}: tool")
    if hanging is not None and chain.bodies[0] not in path_to(model, hanging[0]):
        raise SettingsError(
            f"{source}: tool", f"{shown(tool or '')} does not hang on the chain", "a site or body that it moves"
        )
    urdf, (link, hung), notes = write_urdf(model, chain, stem, hanging)
    axes, beyond = [], list[Note]()
    servos, reasons = _servos(model, chain, drives, by_response)
    for drive in drives:
        axis, missing = _axis(model, drive, names[joint_name(model, drive.joint)], servos)
        axes.append(axis)
        beyond += missing
    beyond += _beside(model, chain)
    notes = [*_gravity_notes(model, chain, drives, source), *notes, *reasons, *summarised(beyond)]
    gravity = -float(model.opt.gravity[2]) if _has_weight(model, chain)[1] else GRAVITY
    assumed = tuple(line for axis in axes for line in axis.assumed)
    return MachineDraft(source, tuple(axes), urdf, link, hung, tuple(notes), assumed, gravity)


def _servos(model: Any, chain: Chain, drives: Sequence[Drive], by_response: bool) -> tuple[bool, list[str]]:
    """Whether the axes are drafted as servos with their controllers, all of them or none; and why not."""
    led = [drive for drive in drives if drive.control == "position" and drive.actuator != NO_ACTUATOR]
    if by_response or not led:
        return False, []
    reasons = [reason for drive in drives if (reason := why_no_servo(model, drive))]
    if not _has_weight(model, chain)[0]:
        reasons.append("the model has no gravity along −z of the world, or compensates it")
    if not reasons:
        return True, []
    names = listed([joint_name(model, drive.joint) for drive in led])
    return False, [f"controllers of {names}, which are described by their responses: {reasons[0]}"]


def _switch_off(model: Any) -> list[str]:
    """Set what the flags of a model switch off to nothing; returns the flags."""
    bits, flags, found = mujoco_library().mjtDisableBit, int(model.opt.disableflags), []
    without: dict[str, tuple[int, tuple[Any, ...]]] = {
        "gravity": (bits.mjDSBL_GRAVITY, (model.opt.gravity,)),
        "damper": (bits.mjDSBL_DAMPER, (model.dof_damping, model.dof_dampingpoly)),
        "spring": (bits.mjDSBL_SPRING, (model.jnt_stiffness, model.jnt_stiffnesspoly)),
        "frictionloss": (bits.mjDSBL_FRICTIONLOSS, (model.dof_frictionloss,)),
        "limit": (bits.mjDSBL_LIMIT, (model.jnt_limited,)),
        "clampctrl": (bits.mjDSBL_CLAMPCTRL, (model.actuator_ctrllimited,)),
        "constraint": (bits.mjDSBL_CONSTRAINT, (model.dof_frictionloss, model.jnt_limited)),
        "equality": (bits.mjDSBL_EQUALITY, ()),
        "actuation": (bits.mjDSBL_ACTUATION, ()),
    }
    for name, (bit, arrays) in without.items():
        if flags & int(bit):
            found.append(f'what the model switches off by <flag {name}="disable">')
            for array in arrays:
                array[:] = 0
    return found


def _drive(model: Any, joint: ChainJoint, source: str, kind: str | None) -> Drive:
    """What drives a joint of the chain.

    Raises:
        UnknownDriveError: it has no actuator, and ``kind`` is None.
        SettingsError: as :func:`drive_of`.
    """
    if joint.actuator is not None:
        return drive_of(model, joint.actuator, source)
    if kind is None:
        where = f"{source}: joint {shown(joint_name(model, joint.joint))}"
        raise UnknownDriveError(where, "no actuator states how it is commanded", "an actuator on each joint")
    control = {"servo": "position", "hydraulic": "speed", "force": "force"}[kind]
    return Drive(NO_ACTUATOR, joint.joint, control, 1.0)


def _axis(model: Any, drive: Drive, name: str, servo: bool) -> tuple[AxisDraft, list[Note]]:
    joint, dof = drive.joint, int(model.jnt_dofadr[drive.joint])
    its, driven = joint_name(model, joint), drive.actuator != NO_ACTUATOR
    straight = int(model.jnt_type[joint]) == mujoco_library().mjtJoint.mjJNT_SLIDE
    damping, friction = float(model.dof_damping[dof] + _actuators(model, drive, "damping")), float(model.dof_frictionloss[dof])
    low, high = (float(end) for end in model.jnt_range[joint]) if model.jnt_limited[joint] else (-math.inf, math.inf)
    low, high = end_stops(low, high)
    (limits, assumed), notes = stops(name, low, high, straight), list[Note]()
    actuator = actuator_name(model, drive.actuator) if driven else ""
    notes += [("spring of", its)] if model.jnt_stiffness[joint] or np.any(model.jnt_stiffnesspoly[joint]) else []
    notes += [("damping above first order of", its)] if np.any(model.dof_dampingpoly[dof]) else []
    notes += [] if servo else limit_notes(its, ("force", _force_limit(model, drive), "N" if straight else "N·m"))
    controls = _controls(model, drive) if drive.control == "position" else None
    if controls is not None and (controls[0] > low + _SAME or controls[1] < high - _SAME):
        unit = "m" if straight else "rad"
        notes.append((f"setpoint limit {controls[0]:.6g} to {controls[1]:.6g} {unit} of", its))
    notes += [("activation limit of actuator", actuator)] if driven and model.actuator_actlimited[drive.actuator] else []
    inertia, effects, law = None, list[KnownEffect](), None
    if (width := backlash_of(model, joint)) > 0.0:
        effects.append(KnownEffect("backlash", name, {"width": width}, "drive"))
        behind = dof + 1
        if model.dof_damping[behind] or model.dof_frictionloss[behind] or model.dof_armature[behind]:
            notes.append(("damping, friction and armature behind the backlash of", its))
    armature = float(model.dof_armature[dof] + _actuators(model, drive, "armature"))
    if servo:
        inertia, law = armature or None, servo_law(model, drive)
        late, lag = dead_time(model, drive), setpoint_lag(model, drive)
        effects += known_effects(name, ("input_delay", "delay", late), ("first_order_lag", "time_constant", lag))
        effects += _friction(name, damping, friction)
    elif drive.actuation == "force":
        inertia = armature or None
        effects += _friction(name, damping + drive.damping, friction)
        effects += [KnownEffect("load_bias", name, {"force": -drive.bias})] if drive.bias else []
        notes += [("delay of actuator", actuator)] if drive.delay else []
        notes += [("filter of actuator", actuator)] if drive.filter else []
    else:
        effects += known_effects(name, ("input_delay", "delay", drive.delay), ("command_rate_limit", "rate", drive.rate))
        if driven:
            found, missing = _loop(model, drive, name, damping)
            effects += found
            notes += missing
        notes += [("friction loss inside the control loop of", its)] if friction > 0.0 else []
        notes += [("constant force of actuator", actuator)] if drive.bias else []
    gain = drive.speed
    if driven and drive.control == "speed":
        gain *= drive.damping / (drive.damping + damping)
    if not driven and drive.actuation == "velocity":
        assumed += (f"speed of {name} at full command: 1 {'m' if straight else 'rad'}/s",)
    if driven and abs(drive.scale - 1.0) > 1e-9:
        units = {"position": ("rad", "m"), "velocity": ("shares of the full speed",) * 2, "force": ("N·m", "N")}
        unit = units[drive.actuation][straight]
        assumed += (f"command of {name} in {unit}: the control of {actuator} is {drive.scale:.6g} times that",)
    about = f"actuator {actuator} ({drive.control} control)" if driven else "no actuator in the model"
    actuation: Actuation = "servo" if servo else drive.actuation
    return AxisDraft(name, its, actuation, about, gain, inertia, limits, tuple(effects), assumed, law), notes


def _friction(axis: str, damping: float, force: float) -> list[KnownEffect]:
    return known_effects(axis, ("viscous_friction", "coefficient", damping), ("coulomb_friction", "force", force))


def _force_limit(model: Any, drive: Drive) -> float:
    """The smallest limit of the force of a joint, of its actuator and of its control, at the joint [N·m or N]; 0 for none."""
    ends, actuator = list[float](), drive.actuator
    if model.jnt_actfrclimited[drive.joint]:
        ends.append(float(np.abs(model.jnt_actfrcrange[drive.joint]).max()))
    if actuator != NO_ACTUATOR and model.actuator_forcelimited[actuator]:
        ends.append(float(np.abs(model.actuator_forcerange[actuator]).max()) * abs(gear_of(model, actuator)))
    if drive.control == "force" and (controls := _controls(model, drive)) is not None:
        ends.append(max(map(abs, controls)))
    return min(ends, default=0.0)


def _controls(model: Any, drive: Drive) -> tuple[float, float] | None:
    """Ends of the range of a control in the unit of the command; None where it is not limited."""
    if drive.actuator == NO_ACTUATOR or not model.actuator_ctrllimited[drive.actuator]:
        return None
    low, high = sorted(
        float(end) / drive.scale for end in model.actuator_ctrlrange[int(model.actuator_ctrladr[drive.actuator])]
    )
    return low, high


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
    if drive.actuator == NO_ACTUATOR:
        return 0.0
    return float(getattr(model, f"actuator_{key}")[drive.actuator]) * gear_of(model, drive.actuator) ** 2


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
    has_weight, down = _has_weight(model, chain)
    if has_weight:
        return []
    gravity = np.asarray(model.opt.gravity, dtype=np.float64)
    turning = [drive for drive in drives if int(model.jnt_type[drive.joint]) == mujoco_library().mjtJoint.mjJNT_HINGE]
    if down:
        found = "gravity compensation of its bodies"
        remedy = "Remove gravcomp from its bodies: what compensates the weight is part of the command then."
    elif int(model.opt.disableflags) & int(mujoco_library().mjtDisableBit.mjDSBL_GRAVITY):
        found, remedy = 'no gravity (<flag gravity="disable">)', 'Remove <flag gravity="disable">, if the machine has weight.'
    else:
        found = f"gravity {gravity.tolist()} m/s²"
        remedy = 'Write <option gravity="0 0 -9.81">, in a model in SI units whose z points up, if the machine has weight.'
    if any(drive.actuation == "force" for drive in drives) and (turning or not down):
        expected = "gravity along −z of the world, which the nominal plant has, and no compensation"
        raise SettingsError(f"{source}: {shown('option')}", found, expected, remedy)
    return [f"{found} (the nominal plant has gravity along −z)"]


def _has_weight(model: Any, chain: Chain) -> tuple[bool, bool]:
    """Whether the bodies have their weight along −z, and whether gravity alone is that."""
    gravity = np.asarray(model.opt.gravity, dtype=np.float64)
    down = bool(_GRAVITY[0] <= -gravity[2] <= _GRAVITY[1] and abs(gravity[:2]).max() < _WEIGHTLESS * abs(gravity[2]))
    bodies = [body for body in range(chain.bodies[0], model.nbody) if model.body_mass[body] > 0.0]
    compensated = any(abs(float(model.body_gravcomp[body])) > _WEIGHTLESS for body in bodies)
    return down and not compensated, down


def _beside(model: Any, chain: Chain) -> list[Note]:
    """Joints, actuators and tendons that are not part of the axes."""
    own, joints = {joint.actuator for joint in chain.driven}, [joint.joint for joint in chain.joints]
    notes = [("actuators beside the chain:", actuator_name(model, k)) for k in range(model.nactuator) if k not in own]
    bodies = [body for body in range(1, model.nbody) if chain.bodies[0] in path_to(model, body)]
    hanging = [joint for body in bodies for joint in joints_of(model, body) if joint not in joints]
    base = [] if chain.base is None else path_to(model, chain.base)
    for joint in hanging:
        if int(model.jnt_bodyid[joint]) not in base:
            notes.append(("joints beside or behind the chain, which are rigid at their reference:", joint_name(model, joint)))
    for body in base:
        notes += [("joints that are held still:", joint_name(model, joint)) for joint in joints_of(model, body)]
    leading = {joint.joint for joint in chain.driven}
    for pair in joint_equalities(model):
        if {*pair} <= leading:
            notes.append(("coupling of two driven joints:", listed([joint_name(model, joint) for joint in pair])))
    for k in () if equalities_off(model) else range(model.neq):
        locks = int(model.eq_type[k]) == mujoco_library().mjtEq.mjEQ_JOINT and int(model.eq_obj2id[k]) < 0
        if locks and model.eq_active0[k] and int(model.eq_obj1id[k]) in joints:
            notes.append(("equality that holds", joint_name(model, int(model.eq_obj1id[k]))))
    if model.opt.density or model.opt.viscosity:
        notes.append(("forces of a fluid:", f"density {model.opt.density:g} kg/m³, viscosity {model.opt.viscosity:g} Pa·s"))
    for tendon in range(model.ntendon):
        if crossed_joints(model, tendon, joints):
            notes.append(("tendons across its joints:", str(model.tendon(tendon).name) or str(tendon)))
    return notes
