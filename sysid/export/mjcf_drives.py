"""Drives of a machine in MuJoCo: an actuator with the effects of an axis, behind those that the drive model computes.

A velocity axis is a source of speed and a position axis one of position: load does not push them back, as in the plant. The
joint or the tendon that they move has a large armature and a servo that dominates it, so that a step of the implicit
integrator nearly reaches the commanded speed.

A cylinder is a triangle of levers, offset and retracted length; they are fitted to a linkage table where a triangle fits it.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.machine import TabulatedLinkage
from sysid.machine.description import Linkage
from sysid.machine.linkage import TriangleLinkage
from sysid.plant import Plant

Array = npt.NDArray[np.float64]

#: Largest RMS error of the cylinder displacement, and of the joint, as shares of their ranges, of a table that counts as a
#: triangle: a tenth of what the replay of an export may differ by.
SHARE = 1e-3
#: Start values: both levers in strokes, and the angle between them in the middle of the stroke [rad].
LEVERS, ANGLES = (0.6, 1.5, 4.0), (0.8, 1.5, 2.2)
#: Points of a table that are fitted.
POINTS = 60


def triangle_of(table: TabulatedLinkage) -> Linkage | None:
    """The triangle of a table; None where none fits, or the table runs through its dead centre.

    Fitted is ``length² = a² + b² − 2ab·cos(sense·(q + offset))`` with displacement = length − retracted, in displacements.
    """
    rows = np.linspace(0, len(table.displacements) - 1, POINTS).astype(int)
    x, q = table.displacements[rows], table.joints[rows]
    stroke = float(x[-1] - x[0])
    sense: int = 1 if q[-1] > q[0] else -1
    best: Linkage | None = None
    least = SHARE * stroke
    for a, b, angle in itertools.product(LEVERS, LEVERS, ANGLES):
        start = np.array([a * stroke, b * stroke, angle - sense * q[POINTS // 2], 0.0])
        start[3] = _lengths(start, sense, q)[POINTS // 2] - x[POINTS // 2]
        bounds = (np.array([0.05 * stroke, 0.05 * stroke, -10.0, -100.0 * stroke]), np.full(4, np.inf))
        scale = np.array([stroke, stroke, 1.0, stroke])
        found = least_squares(_misfit, np.maximum(start, bounds[0]), bounds=bounds, x_scale=scale, args=(sense, q, x))
        error = float(np.sqrt(np.mean(found.fun**2)))
        turned = found.x[2] + sense * q
        if error < least and found.x[3] >= 0.0 and turned.min() > 0.0 and turned.max() < np.pi:
            lever, other, turn, retracted = (float(value) for value in found.x)
            least, best = error, Linkage("triangle", lever, other, sense * turn, retracted, sense=1 if sense > 0 else -1)
            if error < 1e-2 * SHARE * stroke:
                break
    if best is None or _joint_error(best, table) > SHARE * float(np.ptp(table.joints)):
        return None
    return best


def _misfit(p: Array, sense: int, q: Array, x: Array) -> Array:
    """Errors of the displacements (n,) [m] for the levers, the angle between them at joint zero, and the retracted length."""
    return np.asarray(_lengths(p, sense, q) - p[3] - x)


def _lengths(p: Array, sense: int, q: Array) -> Array:
    a, b, turn = p[0], p[1], p[2]
    return np.asarray(np.sqrt(np.maximum(a * a + b * b - 2.0 * a * b * np.cos(turn + sense * q), 1e-12)))


def _joint_error(linkage: Linkage, table: TabulatedLinkage) -> float:
    """RMS error of the joint of a triangle over a table [rad]."""
    return float(np.sqrt(np.mean((TriangleLinkage(linkage).joint(table.displacements) - table.joints) ** 2)))


#: Armature of a source of motion [kg or kg·m²]: far above what the links of a machine load it with.
ARMATURE = 1e6
#: A step of the integrator leaves 1/(1 + FAST) of a commanded change of speed. The faster the servo, the deeper it presses the
#: joint into its end stop; at ten the rest of a change is below 1 % after two steps.
FAST = 10.0
#: The same of an axis without an end stop in its joint: a position servo, or one that follows the drive model. Not in a model
#: with passive joints: the constraint that couples them does not see the implicit damping, and is the later the larger it is.
FASTEST = 1e3
#: Effects of the command stage that an actuator has, in the order of the chain.
VELOCITY_NATIVE = ("input_delay", "first_order_lag", "gain_error", "nominal_gain", "internal_leakage")
POSITION_NATIVE = ("input_delay", "first_order_lag", "second_order_lag")
FORCE_NATIVE = ("viscous_friction", "coulomb_friction")
#: An end stop that is never reached [rad or m].
FAR = 1e6
#: Impedance of stops and dry friction: the hardest that MuJoCo has.
HARD = (0.9999, 0.9999, 1e-3, 0.5, 2.0)
Mode = Literal["native", "command", "drive_model"]
#: What stands for a drive: also several elements of MuJoCo, single ones, or the drive model alone.
Elements = Literal["composed", "native", "plugin"]
_ALL_BY_DRIVE_MODEL = "differences of the replay with elements of MuJoCo"


@dataclass(frozen=True)
class DriveEntry:
    """An axis in the model.

    Args:
        mode: ``native``: the actuator takes the command; ``command``: it takes what the first ``prefix`` parts of the drive
            model make of the command; ``drive_model``: it follows the joint of the drive model.
        reason: the last effect or part that the actuator does not have.
        triangle: linkage of a cylinder, which becomes a tendon.
        backlash: (width, side) of a backlash, which becomes a second joint.
    """

    axis: str
    mode: Mode
    reason: str
    prefix: int
    triangle: Linkage | None = None
    backlash: tuple[float, str] | None = None


def drive_entry(plant: Plant, axis: dict[str, Any], pump: bool, most: Elements) -> DriveEntry:
    """How an axis of the drive data is written, with elements of MuJoCo up to ``most``."""
    native = {"velocity": VELOCITY_NATIVE, "position": POSITION_NATIVE, "force": FORCE_NATIVE}[axis["actuation"]]
    parts = [name for name, _ in axis["command"]]
    lacking = _lacking(axis, pump, native)
    if most != "composed":
        lacking += [part for part in ("drive_backlash", "structure_backlash") if axis[part]]
        lacking += ["a linkage that is not a triangle"] if axis["drives"] == "cylinder" else []
    lacking += [_ALL_BY_DRIVE_MODEL] if most == "plugin" else []
    triangle = None
    if axis["drives"] == "cylinder" and not lacking:
        triangle = plant.machine.axis(axis["name"]).linkage or (
            triangle_of(plant.linkages[axis["name"]]) if axis["name"] in plant.linkages else None
        )
        lacking += [] if triangle is not None else ["a linkage that is not a triangle"]
    if lacking:
        return DriveEntry(axis["name"], "drive_model", lacking[0], len(parts))
    prefix = 1 + max((k for k, name in enumerate(parts) if name not in native), default=-1)
    sides = [(axis[f"{side}_backlash"], side) for side in ("drive", "structure") if axis[f"{side}_backlash"]]
    mode: Mode = "command" if prefix else "native"
    return DriveEntry(axis["name"], mode, parts[prefix - 1] if prefix else "", prefix, triangle, sides[0] if sides else None)


def _lacking(axis: dict[str, Any], pump: bool, native: tuple[str, ...]) -> list[str]:
    """What neither an actuator nor bodies, behind parts of the drive model, can do."""
    found = [f"joint_compliance ({side})" for side in ("drive", "structure") if axis[f"{side}_compliance"]]
    if axis["drive_backlash"] and axis["structure_backlash"]:
        found.append("backlash on both sides")
    if axis["actuation"] != "velocity" and (axis["drive_backlash"] or axis["structure_backlash"]):
        found.append("backlash of an axis whose speed no command limits")
    if axis["actuation"] == "force":
        found += [name for name, values in axis["frictions"] if name not in native or values["positive"] != values["negative"]]
        found += ["flexible_drive"] if axis["rotor"] == "flexible_drive" else []
    if pump and axis["actuation"] == "velocity":
        found.append("pump_flow_limit")
    return found


@dataclass(frozen=True)
class Moved:
    """The joint or tendon that an actuator moves.

    Args:
        joint: name of the joint, of which a tendon is the cylinder.
        zero: value of the element where the drive's position is zero [rad or m].
    """

    element: Any
    joint: str
    tendon: bool
    zero: float


def add_drive(spec: Any, axis: dict[str, Any], moved: Moved, entry: DriveEntry, step: float, coupled: bool) -> None:
    """Add the actuator of an axis to an ``MjSpec`` and complete what it moves.

    Args:
        step: of the integrator [s].
        coupled: whether the model has passive joints.
    """
    import mujoco

    actuator = add_actuator(spec, axis["name"], moved.element, moved.tendon)
    parts = dict(axis["command"][entry.prefix :])
    follows = entry.mode == "drive_model"
    servo = axis["actuation"] == "position" and "second_order_lag" not in parts
    ends = [-math.inf if axis["low"] is None else axis["low"], math.inf if axis["high"] is None else axis["high"]]
    if not follows and not servo:
        limit(moved.element, [end + moved.zero for end in ends], step)
    elif not follows and _stops(ends):  # a servo goes where its set-point is
        actuator.ctrlrange, actuator.ctrllimited = _stops(ends), mujoco.mjtLimited.mjLIMITED_TRUE
    if axis["actuation"] == "force" and not follows:
        _force(axis, moved, actuator, step)
        return
    moved.element.armature = ARMATURE
    damping = (FASTEST if (servo or follows) and not coupled else FAST) * ARMATURE / step
    if follows:
        _set(actuator, damping, 0.0, 0.0, -damping)
    elif axis["actuation"] == "velocity":
        _velocity(axis, parts, actuator, damping)
    else:
        _position(parts, moved.zero, actuator, damping, step)
    delay = parts.get("input_delay", {"delay": 0.0})["delay"]
    if not follows and delay >= step:  # the shortest that MuJoCo has
        actuator.delay = delay - 1e-3 * step  # a whole number of steps must not become one more by rounding
        actuator.nsample = math.ceil(delay / step) + 2


def add_actuator(spec: Any, name: str, element: Any, tendon: bool = False) -> Any:
    """Add an actuator with a fixed gain and an affine bias to a joint or tendon."""
    import mujoco

    kind = mujoco.mjtTrn.mjTRN_TENDON if tendon else mujoco.mjtTrn.mjTRN_JOINT
    actuator = spec.add_actuator(name=name, target=element.name, trntype=kind)
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    return actuator


def limit(element: Any, ends: list[float], step: float) -> None:
    """Hard ends of a joint or tendon, infinite where there is none."""
    import mujoco

    if stops := _stops(ends):
        element.range, element.limited = stops, mujoco.mjtLimited.mjLIMITED_TRUE
        element.solref_limit, element.solimp_limit = [2.0 * step, 1.0], HARD


def _stops(ends: list[float]) -> list[float]:
    """Both ends of a range that has one, the other far away; none of a range without."""
    return [min(max(end, -FAR), FAR) for end in ends] if any(map(math.isfinite, ends)) else []


def dry_friction(element: Any, force: float, step: float) -> None:
    """Hard dry friction of a joint or tendon [N or N·m]."""
    element.frictionloss = force
    element.solref_friction, element.solimp_friction = [2.0 * step, 1.0], HARD


def _velocity(axis: dict[str, Any], parts: dict[str, Any], actuator: Any, damping: float) -> None:
    """Speed = gain·act − leakage, act the command behind the lag; the gain is 1 where the drive model gives the speed."""
    import mujoco

    gain = parts.get("nominal_gain", {"gain": 1.0})["gain"] * parts.get("gain_error", {"ratio": 1.0})["ratio"]
    _set(actuator, damping * gain, -damping * parts.get("internal_leakage", {"rate": 0.0})["rate"], 0.0, -damping)
    lag = parts.get("first_order_lag", {"time_constant": 0.0})["time_constant"]
    if lag >= 1e-6:
        actuator.dyntype, actuator.dynprm[0], actuator.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag, True


def _position(parts: dict[str, Any], zero: float, actuator: Any, damping: float, step: float) -> None:
    """T·v = u − q by the ratio of stiffness and damping, or T²·a + 2ζT·v + q = u against the armature."""
    import mujoco

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
    _set(actuator, stiffness, stiffness * zero, -stiffness, -damping)


def _force(axis: dict[str, Any], moved: Moved, actuator: Any, step: float) -> None:
    """Mass as armature, friction of the joint, and a constant force against the command."""
    laws = dict(axis["frictions"])
    moved.element.armature = axis["mass"]
    moved.element.damping = [laws.get("viscous_friction", {"positive": 0.0})["positive"], 0.0, 0.0]
    dry_friction(moved.element, laws.get("coulomb_friction", {"positive": 0.0})["positive"], step)
    _set(actuator, 1.0, -axis["bias"], 0.0, 0.0)


def _set(actuator: Any, gain: float, *bias: float) -> None:
    actuator.gainprm[0] = gain
    actuator.biasprm[: len(bias)] = bias
