"""What an MJCF actuator does with its control, the joint's control loop that follows from it, and servo axes.

The force of an actuator is ``gain·(ctrl or act) + b₀ + b₁·length + b₂·rate``, with ``length = gear·q``; joint force =
gear·force (MuJoCo 4, *Computation*, actuation model). With ``b₁ < 0`` the control is a position in units of ``−b₁/gain`` (or,
integrated with ``b₁ = −gain``, a speed), with ``b₂ = −gain`` and ``b₁ = 0``, or declared as one, a speed, without bias a force.

Servo axes are actuators whose joint force is ``clip(kp·(command − q) − kv·q̇)``. The friction loss of their joints is a
constraint in MuJoCo, which gives way: its force is ``(b·q̇ + q̈)/R`` up to the friction loss, with the regularisation ``R = (1
− d)/d·w`` and the damping b of the constraint, of inverse weight w and impedance d. A joint creeps at R/b under each newton
(metre), which it reaches in 1/b.

Source: MuJoCo 4, *Computation*, chapters Actuation model and Constraint model (reference acceleration and regularisation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sysid.errors import SettingsError
from sysid.foreign import shown
from sysid.machine.description import LEAST_INERTIA, Actuation, ServoLaw
from sysid.machine.sources.mjcf_model import actuator_name, joint_name, mujoco_library

_REMEDY = "Remove it from <actuator>, and add --kind servo, hydraulic or force: how the joint is commanded."


@dataclass(frozen=True)
class Drive:
    """An actuator at its joint, in units of the joint.

    Args:
        control: what its control is: a position, a speed, a speed that is integrated, a force.
        scale: control per unit of the command of the axis (position [rad or m], share of the full speed, force [N or N·m]).
        speed: of the joint at command 1.0, where the control is a speed [rad/s or m/s].
        stiffness, damping: of the control loop about the joint [N·m/rad or N/m, and per 1/s].
        bias: constant force [N·m or N].
        filter, delay: of the control [s].
        rate: limit of the position setpoint [1/s]; 0: none.
        integral: whether the loop integrates its error.
    """

    actuator: int
    joint: int
    control: str
    scale: float
    speed: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    bias: float = 0.0
    filter: float = 0.0
    delay: float = 0.0
    rate: float = 0.0
    integral: bool = False

    @property
    def actuation(self) -> Actuation:
        return {"position": "position", "speed": "velocity", "integrated speed": "velocity", "force": "force"}[self.control]  # type: ignore[return-value]


def drive_of(model: Any, actuator: int, source: str) -> Drive:
    """What an actuator with a joint transmission does.

    Raises:
        SettingsError: a muscle, a plugin, a voltage or another law that no actuation of ``machine.toml`` expresses.
    """
    mujoco, joint = mujoco_library(), int(model.actuator_trnid[actuator, 0])
    name = actuator_name(model, actuator)
    gear = gear_of(model, actuator)
    where = f"{source}: actuator {shown(name)} of joint {shown(joint_name(model, joint))}"
    if gear == 0.0:
        raise SettingsError(where, "gear 0", "a gear other than zero", _REMEDY)
    gain, bias = (int(getattr(model, f"actuator_{key}type")[actuator]) for key in ("gain", "bias"))
    dyn, values = int(model.actuator_dyntype[actuator]), model.actuator_dynprm[actuator]
    k = float(model.actuator_gainprm[actuator, 0])
    b0, b1, b2 = (float(value) for value in model.actuator_biasprm[actuator, :3]) if bias else (0.0, 0.0, 0.0)
    shared: dict[str, Any] = {
        "stiffness": -b1 * gear**2,
        "damping": -b2 * gear**2,
        "delay": float(model.actuator_delay[actuator]),
    }
    dyns = mujoco.mjtDyn
    if gain == mujoco.mjtGain.mjGAIN_PID and mujoco.mj_actuatorInputName(model, actuator, 0) == "pos":
        return Drive(actuator, joint, "position", gear, **shared, rate=float(values[1]) / abs(gear), integral=k != 0.0)
    linear = gain == mujoco.mjtGain.mjGAIN_FIXED and bias in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
    if not linear or k == 0.0 or int(model.actuator_plugin[actuator]) >= 0:
        raise SettingsError(where, _law(model, actuator), "a position, velocity, intvelocity or motor actuator", _REMEDY)
    if dyn in (dyns.mjDYN_FILTER, dyns.mjDYN_FILTEREXACT):
        shared["filter"] = float(values[0])
    elif dyn not in (dyns.mjDYN_NONE, dyns.mjDYN_INTEGRATOR):
        raise SettingsError(where, _law(model, actuator), "no activation, a filter or an integrator", _REMEDY)
    if dyn == dyns.mjDYN_INTEGRATOR:
        if b1 != -k:
            raise SettingsError(
                where, "an integrator without position feedback", "intvelocity, whose bias is −gain·length", _REMEDY
            )
        full = _full(model, actuator)
        return Drive(actuator, joint, "integrated speed", full * _sign(gear), full / abs(gear), **shared)
    if b1 < 0.0:
        return Drive(actuator, joint, "position", gear * -b1 / k, **shared, bias=b0 * gear)
    if b1 == 0.0 and b2 < 0.0 and (b2 == -k or mujoco.mj_actuatorInputName(model, actuator, 0) == "vel"):
        full = _full(model, actuator)
        return Drive(actuator, joint, "speed", full * _sign(gear), full / abs(gear) * k / -b2, **shared, bias=b0 * gear)
    if b1 == 0.0:
        return Drive(actuator, joint, "force", 1.0 / (k * gear), **shared, bias=b0 * gear)
    found = f"gain {k:g} and bias {b0:g} {b1:g} {b2:g}"
    raise SettingsError(where, found, "b₁ < 0 (position) or b₁ = 0 (speed, force)", _REMEDY)


def gear_of(model: Any, actuator: int) -> float:
    """Force of a joint per force of its actuator."""
    return float(model.actuator_gear[int(model.actuator_outadr[actuator]), 0])


def _full(model: Any, actuator: int) -> float:
    """The control at full speed: the larger end of its range; 1 without a range."""
    at = int(model.actuator_ctrladr[actuator])
    return float(max(abs(model.actuator_ctrlrange[at]))) if model.actuator_ctrllimited[at] else 1.0


def _sign(value: float) -> float:
    return 1.0 if value > 0.0 else -1.0


def _law(model: Any, actuator: int) -> str:
    mujoco = mujoco_library()
    kinds = (mujoco.mjtGain, model.actuator_gaintype), (mujoco.mjtDyn, model.actuator_dyntype)
    gain, dyn = (kind(int(values[actuator])).name.rpartition("_")[2].lower() for kind, values in kinds)
    return f"gain type {gain}, activation {dyn}"


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
        gear = gear_of(model, drive.actuator)
        low, high = sorted(float(end) * gear for end in model.actuator_forcerange[drive.actuator])
    if model.jnt_actfrclimited[drive.joint]:
        ends = [float(end) for end in model.jnt_actfrcrange[drive.joint]]
        low, high = max(low, ends[0]), min(high, ends[1])
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


def _give(model: Any, dof: int) -> tuple[float, float]:
    """How dry friction gives way: speed over force [rad/(s·N·m) or m/(s·N)], and time [s]."""
    least, most = (float(value) for value in model.dof_solimp[dof, :2])
    time, ratio = (float(value) for value in model.dof_solref[dof])
    stated = time <= 0.0  # stiffness and damping, both negative, instead of time constant and damping ratio
    decay = most / max(-ratio, 1e-12) if stated else 0.5 * most * max(time, 2.0 * float(model.opt.timestep))
    return (1.0 - least) / least * float(model.dof_invweight0[dof]) * decay, decay
