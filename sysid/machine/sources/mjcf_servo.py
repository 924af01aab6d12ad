"""Servo axes of an MJCF: actuators whose joint force is ``clip(kp·(command − q) − kv·q̇)``, and the friction of their joints.

Friction loss is a constraint in MuJoCo, which gives way: its force is ``(b·q̇ + q̈)/R`` up to the friction loss, with the
regularisation ``R = (1 − d)/d·w`` and the damping b of the constraint, of inverse weight w and impedance d. A joint creeps at
R/b under each newton (metre), which it reaches in 1/b.

Source: MuJoCo 4, *Computation*, chapters Actuation model and Constraint model (reference acceleration and regularisation).
"""

from __future__ import annotations

import math
from typing import Any

from sysid.machine.description import LEAST_INERTIA, KnownEffect, ServoLaw
from sysid.machine.sources.mjcf_actuator import Drive
from sysid.machine.sources.mjcf_model import joint_name, mujoco_library


def why_no_servo(model: Any, drive: Drive) -> str:
    """Why a driven joint is no servo axis of ``machine.toml``; empty where it is one."""
    its = joint_name(model, drive.joint)
    if drive.control != "position" or drive.stiffness <= 0.0:
        return f"{its} has no position actuator"
    reasons = {
        "a filter that acts early": drive.filter > 0.0 and bool(model.actuator_actearly[drive.actuator]),
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
    give, time = _give(model, int(model.jnt_dofadr[drive.joint]))
    # The speed that a constraint sees is that half a step before the middle of the step.
    return ServoLaw(drive.stiffness, drive.damping, limit, step, implicit, give, max(time - 0.5 * step, 0.0))


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


def dead_time(model: Any, drive: Drive) -> float:
    """Time after which a control acts [s]: from the first step that is no earlier than the delay of the actuator."""
    step = float(model.opt.timestep)
    return math.ceil(drive.delay / step - 1e-6) * step


def setpoint_lag(model: Any, drive: Drive) -> float:
    """Time constant of a filter of the control [s]; a filter of explicit steps as the exact one that does the same."""
    step, explicit = float(model.opt.timestep), int(mujoco_library().mjtDyn.mjDYN_FILTER)
    if int(model.actuator_dyntype[drive.actuator]) != explicit or drive.filter <= 0.0:
        return drive.filter
    return -step / math.log1p(-step / drive.filter) if drive.filter > step else 0.0


def friction_effects(model: Any, drive: Drive, name: str, damping: float) -> list[KnownEffect]:
    """Viscous friction of ``damping`` [N·m·s/rad or N·s/m], and the dry friction of a joint."""
    force = float(model.dof_frictionloss[int(model.jnt_dofadr[drive.joint])])
    found = [KnownEffect("viscous_friction", name, {"coefficient": damping})] if damping > 0.0 else []
    return [*found, KnownEffect("coulomb_friction", name, {"force": force})] if force > 0.0 else found


def _give(model: Any, dof: int) -> tuple[float, float]:
    """How dry friction gives way: speed over force [rad/(s·N·m) or m/(s·N)], and time [s]."""
    least, most = (float(value) for value in model.dof_solimp[dof, :2])
    time, ratio = (float(value) for value in model.dof_solref[dof])
    stated = time <= 0.0  # stiffness and damping, both negative, instead of time constant and damping ratio
    decay = most / max(-ratio, 1e-12) if stated else 0.5 * most * max(time, 2.0 * float(model.opt.timestep))
    return (1.0 - least) / least * float(model.dof_invweight0[dof]) * decay, decay
