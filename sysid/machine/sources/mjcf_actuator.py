"""What an MJCF actuator does with its control, and the joint's control loop that follows from it.

The force of an actuator is ``gain·(ctrl or act) + b₀ + b₁·length + b₂·rate``, with ``length = gear·q``; joint force =
gear·force (MuJoCo 4, *Computation*, actuation model). With ``b₁ < 0`` the control is a position in units of ``−b₁/gain`` (or,
integrated with ``b₁ = −gain``, a speed), with ``b₂ = −gain`` and ``b₁ = 0``, or declared as one, a speed, without bias a force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sysid.errors import SettingsError
from sysid.foreign import shown
from sysid.machine.description import Actuation
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
    gear = float(model.actuator_gear[int(model.actuator_outadr[actuator]), 0])
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
