"""Servo axes of an MJCF: actuators whose joint force is ``clip(kp·(command − q) − kv·q̇)``, and the friction of their joints.

Friction loss is a constraint in MuJoCo, which gives way: below its largest force F a joint creeps at the speed force·R/b, with
the regularisation ``R = (1 − d)/d·w`` and damping b of the constraint, of inverse weight w and impedance d. That is smooth dry
friction of the width F·R/b.

Source: MuJoCo 4, *Computation*, chapters Actuation model and Constraint model (reference acceleration and regularisation).
"""

from __future__ import annotations

import math
from typing import Any

from sysid.machine.description import LEAST_INERTIA, KnownEffect, ServoLaw
from sysid.machine.sources.mjcf_actuator import Drive
from sysid.machine.sources.mjcf_model import joint_name, mujoco_library

#: Narrowest smooth friction [rad/s or m/s]; a narrower one is dry friction.
_NARROWEST = 1e-4
#: Exponent with which smooth friction approaches its full force nearly as abruptly as a constraint does.
_EXPONENT = 8.0


def why_no_servo(model: Any, drive: Drive) -> str:
    """Why a driven joint is no servo axis of ``machine.toml``; empty where it is one."""
    its = joint_name(model, drive.joint)
    if drive.control != "position" or drive.stiffness <= 0.0:
        return f"{its} has no position actuator"
    reasons = {
        "a filter": drive.filter > 0.0,
        "a limit of its setpoint's rate": drive.rate > 0.0,
        "integral action": drive.integral,
        "a constant force": drive.bias != 0.0,
        "negative damping": drive.damping < 0.0,
        "a force range without zero": not force_range(model, drive)[0] < 0.0 < force_range(model, drive)[1],
        "neither mass nor armature": float(model.dof_M0[model.jnt_dofadr[drive.joint]]) < LEAST_INERTIA,
    }
    found = [reason for reason, holds in reasons.items() if holds]
    return f"the actuator of {its} has {found[0]}" if found else ""


def servo_law(model: Any, drive: Drive) -> ServoLaw:
    """The controller of a joint, in units of the joint, with the step of the model."""
    mujoco, integrator = mujoco_library(), int(model.opt.integrator)
    low, high = force_range(model, drive)
    limit = None if math.isinf(low) and math.isinf(high) else high if low == -high else (low, high)
    step = 0.0 if integrator == int(mujoco.mjtIntegrator.mjINT_RK4) else float(model.opt.timestep)
    implicit = integrator != int(mujoco.mjtIntegrator.mjINT_EULER)
    return ServoLaw(drive.stiffness, drive.damping, limit, step, implicit)


def force_range(model: Any, drive: Drive) -> tuple[float, float]:
    """Lowest and highest force of an actuator at its joint, the limit of the joint included [N·m or N]; infinite for none."""
    low, high = -math.inf, math.inf
    if model.actuator_forcelimited[drive.actuator]:
        gear = float(model.actuator_gear[int(model.actuator_outadr[drive.actuator]), 0])
        low, high = sorted(float(end) * gear for end in model.actuator_forcerange[drive.actuator])
    if model.jnt_actfrclimited[drive.joint]:
        low, high = (
            max(low, float(model.jnt_actfrcrange[drive.joint, 0])),
            min(high, float(model.jnt_actfrcrange[drive.joint, 1])),
        )
    return low, high


def friction_effects(model: Any, drive: Drive, name: str, damping: float) -> list[KnownEffect]:
    """Viscous friction of ``damping`` [N·m·s/rad or N·s/m], and the dry friction of a joint."""
    found, dof = list[KnownEffect](), int(model.jnt_dofadr[drive.joint])
    if damping > 0.0:
        found.append(KnownEffect("viscous_friction", name, {"coefficient": damping}))
    force = float(model.dof_frictionloss[dof])
    if force <= 0.0:
        return found
    width = force * _give(model, dof)
    if width < _NARROWEST:
        return [*found, KnownEffect("coulomb_friction", name, {"force": force})]
    return [*found, KnownEffect("smooth_coulomb_friction", name, {"force": force, "width": width, "exponent": _EXPONENT})]


def _give(model: Any, dof: int) -> float:
    """Speed at which a joint with friction creeps under a force, over that force [rad/(s·N·m) or m/(s·N)]."""
    least, most = (float(value) for value in model.dof_solimp[dof, :2])
    time, ratio = (float(value) for value in model.dof_solref[dof])
    regular = (1.0 - least) / least * float(model.dof_invweight0[dof])
    if time <= 0.0:  # stiffness and damping, both negative
        return regular * most / max(-ratio, 1e-12)
    return regular * 0.5 * most * max(time, 2.0 * float(model.opt.timestep))
