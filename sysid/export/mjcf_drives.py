"""Drives of a machine in MuJoCo: actuators that have the effects of an axis, or one that follows the drive model.

A velocity axis is a source of speed and a position axis one of position: load does not push them back, as in the plant. Their
joint has a large armature and a servo that dominates it, so that a step of the implicit integrator reaches the commanded speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from sysid.plant import Plant

#: Armature of a joint that is a source of motion [kg or kg·m²]: far above what the links of a machine load it with.
ARMATURE = 1e6
#: A step of the integrator leaves 1/(1 + FAST) of a commanded change of speed. The faster the servo, the deeper it presses the
#: joint into its end stop; at ten the rest of a change is below 1 % after two steps.
FAST = 10.0
#: The same of an axis without an end stop in its joint: a position servo, or one that follows the drive model.
FASTEST = 1e3
#: Command-stage effects of a velocity axis in the order of the chain, each of which an actuator has.
VELOCITY_NATIVE = ("input_delay", "first_order_lag", "gain_error", "nominal_gain", "internal_leakage")
POSITION_NATIVE = ("input_delay", "first_order_lag", "second_order_lag")
FORCE_NATIVE = ("viscous_friction", "coulomb_friction")
Mode = Literal["native", "drive_model"]


@dataclass(frozen=True)
class DriveEntry:
    """An axis in the model, for the shipped loop.

    Args:
        mode: ``native``: the actuator takes the command; ``drive_model``: it follows the position of the drive model.
        reason: the first effect or part that the actuator does not have.
    """

    axis: str
    mode: Mode
    reason: str


def mode_of(plant: Plant, axis: dict[str, Any], pump: bool) -> DriveEntry:
    """How an axis of the drive data is written."""
    native = {"velocity": VELOCITY_NATIVE, "position": POSITION_NATIVE, "force": FORCE_NATIVE}[axis["actuation"]]
    lacking = [name for name, _ in axis["command"] if name not in native]
    if axis["actuation"] == "force":
        lacking += [name for name, values in axis["frictions"] if name not in native or not _even(values)]
        lacking += ["flexible_drive"] if axis["rotor"] == "flexible_drive" else []
    if pump and axis["actuation"] == "velocity":
        lacking.append("pump_flow_limit")
    lacking += ["a cylinder with a linkage"] if axis["drives"] == "cylinder" else []
    lacking += [f"backlash ({side})" for side in ("drive", "structure") if axis[f"{side}_backlash"]]
    lacking += [f"joint_compliance ({side})" for side in ("drive", "structure") if axis[f"{side}_compliance"]]
    if lacking:
        return DriveEntry(axis["name"], "drive_model", lacking[0])
    return DriveEntry(axis["name"], "native", "")


def _even(values: dict[str, float]) -> bool:
    return values["positive"] == values["negative"]


def add_drive(spec: Any, axis: dict[str, Any], joint: Any, entry: DriveEntry, step: float) -> None:
    """Add the actuator of an axis to an ``MjSpec`` and complete its joint; ``step`` of the integrator [s]."""
    import mujoco

    actuator = spec.add_actuator(name=axis["name"], target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    low, high = axis["low"], axis["high"]
    servo = axis["actuation"] == "position" and "second_order_lag" not in dict(axis["command"])
    if entry.mode == "native" and (low is not None or high is not None):
        ends = (-1e6 if low is None else low, 1e6 if high is None else high)
        if servo:  # which goes where its set-point is
            actuator.ctrlrange, actuator.ctrllimited = ends, mujoco.mjtLimited.mjLIMITED_TRUE
        else:
            joint.range, joint.limited = [end + axis["offset"] for end in ends], mujoco.mjtLimited.mjLIMITED_TRUE
            joint.solref_limit, joint.solimp_limit = [2.0 * step, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0]
    if axis["actuation"] == "force" and entry.mode == "native":
        _force(axis, joint, actuator, step)
        return
    joint.armature = ARMATURE
    damping = (FASTEST if servo or entry.mode == "drive_model" else FAST) * ARMATURE / step
    if entry.mode == "drive_model":
        _set(actuator, damping, 0.0, 0.0, -damping)
    elif axis["actuation"] == "velocity":
        _velocity(axis, actuator, damping)
    else:
        _position(axis, actuator, damping, step)
    if entry.mode == "native":
        _delay(axis, actuator, step)


def _velocity(axis: dict[str, Any], actuator: Any, damping: float) -> None:
    """Speed = gain·act − leakage, act the command behind the lag."""
    import mujoco

    parts = dict(axis["command"])
    gain = axis["gain"] * parts.get("gain_error", {"ratio": 1.0})["ratio"]
    _set(actuator, damping * gain, -damping * parts.get("internal_leakage", {"rate": 0.0})["rate"], 0.0, -damping)
    lag = parts.get("first_order_lag", {"time_constant": 0.0})["time_constant"]
    if lag >= 1e-6:
        actuator.dyntype, actuator.dynprm[0], actuator.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag, True


def _position(axis: dict[str, Any], actuator: Any, damping: float, step: float) -> None:
    """T·v = u − q by the ratio of stiffness and damping, or T²·a + 2ζT·v + q = u against the armature."""
    import mujoco

    parts = dict(axis["command"])
    lag = parts.get("first_order_lag", {"time_constant": 0.0})["time_constant"]
    second = parts.get("second_order_lag")
    if second is None:
        share = 1.0 - math.exp(-step / lag) if lag >= 1e-6 else 1.0  # of the way in a step of the integrator
        stiffness = damping * share / step
    else:
        stiffness = ARMATURE / second["time_constant"] ** 2
        damping = 2.0 * second["damping_ratio"] * ARMATURE / second["time_constant"]
        if lag >= 1e-6:
            actuator.dyntype, actuator.dynprm[0], actuator.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag, True
    _set(actuator, stiffness, stiffness * axis["offset"], -stiffness, -damping)


def _force(axis: dict[str, Any], joint: Any, actuator: Any, step: float) -> None:
    """Mass as armature, friction of the joint, and a constant force against the command."""
    laws = dict(axis["frictions"])
    joint.armature = axis["mass"]
    joint.damping = [laws.get("viscous_friction", {"positive": 0.0})["positive"], 0.0, 0.0]
    joint.frictionloss = laws.get("coulomb_friction", {"positive": 0.0})["positive"]
    joint.solref_friction, joint.solimp_friction = [2.0 * step, 1.0], [0.9999, 0.9999, 1e-3, 0.5, 2.0]
    _set(actuator, 1.0, -axis["bias"], 0.0, 0.0)


def _delay(axis: dict[str, Any], actuator: Any, step: float) -> None:
    delay = dict(axis["command"]).get("input_delay", {"delay": 0.0})["delay"]
    if delay >= step:  # the shortest that MuJoCo has
        actuator.delay, actuator.nsample = delay, math.ceil(delay / step) + 2


def _set(actuator: Any, gain: float, *bias: float) -> None:
    actuator.gainprm[0] = gain
    actuator.biasprm[: len(bias)] = bias
