"""Sag of a position axis under its gravity load, beside errors of its sensor: what looks the same, and what is known of it.

Load: it follows from the description of the machine where the URDF has masses, or where no mass can load the axis.

Error at rest: at the end of each hold of the setpoint the error measured − predicted hardly depends on dead time and lag:

    e_j = s·d_j + c + Σ_k a_k·φ_k(q_j) + noise,

where the prediction has no bias, scale error or compliance, with the direction d_j = ±1 from which the hold was reached (dry
friction and backlash leave an error of this sign), and functions φ of the posture. The error is significant where the constant
and the functions of posture together reduce the squares (F-test; Draper and Smith, Applied Regression Analysis, 1998, §6.1).

Fewest effects: the control loop of a servo, the inertia that it moves and the coupling of the joints are idealised. A bias that
compensates for them takes part of the sag, since most of a gravity moment is constant; what remains without it is as large
within a tenth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.datasets.recording import Recording
from sysid.effects import joint_compliance, sensor_bias, sensor_scale
from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.problem import Problem
from sysid.gap.thresholds import as_little
from sysid.machine import Machine
from sysid.machine.kinematics import Kinematics
from sysid.machine.moved_bodies import has_masses
from sysid.names import listed
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Effects of the sensor that look like sag: constant, or in proportion to the angle.
OF_SENSOR = (sensor_bias.EFFECT, sensor_scale.EFFECT)
#: Each may replace the others where the gravity moment varies little.
AT_REST = (joint_compliance.EFFECT, *OF_SENSOR)
#: Postures of a recording at which the direction of an axis is computed.
POSTURES = 50
#: Largest sine of the angle between an axis that carries no weight and the vertical (the horizontal, if it slides).
TILT = 1e-3
#: The setpoint is held at least this long [s], and the error is the mean over the end of the hold [s].
HOLD, END = 0.5, 0.1
#: A setpoint that changes by less than this share of its range is held.
STILL = 1e-3
#: Least number of holds for each coefficient.
HOLDS_PER_COEFFICIENT = 3
#: Level of the F-tests.
LEVEL = 0.01
Refit = Callable[[Sequence[Candidate], ModelFit], ModelFit]


def load_known(machine: Machine, axis: str, recordings: Sequence[Recording]) -> bool:
    """Whether the gravity load of an axis is known: the URDF has masses, or no mass can load the axis.

    No mass loads a joint that turns about the vertical, or slides horizontally, in all recorded postures. A URDF without masses
    gives the load of a unit mass at the tip, which is not that of the machine.
    """
    kinematics = machine.kinematics()
    if kinematics is None:
        return False
    return has_masses(kinematics) or _unloaded(kinematics, machine, axis, recordings)


def _unloaded(kinematics: Kinematics, machine: Machine, axis: str, recordings: Sequence[Recording]) -> bool:
    """Whether the axis keeps the direction in which no weight acts."""
    signals = [axis_signal(name, "joint") for name in machine.axis_names]
    rows = []
    for recording in recordings:
        joints = np.column_stack([recording.values(signal) for signal in signals])
        joints = joints[~np.isnan(joints).any(axis=1)]
        rows.append(joints[:: max(1, len(joints) // POSTURES)])
    postures = np.concatenate(rows) if rows else np.empty((0, len(signals)))
    if not len(postures):
        return False
    joint = kinematics.joints[kinematics.actuated[machine.axis_names.index(axis)]]
    poses = kinematics.link_poses(postures)
    if joint.child not in poses:  # it moves the tip by a passive joint alone
        return False
    upwards = np.abs(poses[joint.child][:, 2, :3] @ joint.axis)
    off = upwards if joint.prismatic else np.sqrt(np.maximum(1.0 - upwards**2, 0.0))
    return bool((off <= TILT).all())


@dataclass(frozen=True)
class StaticError:
    """Error of a position axis at rest.

    Args:
        rms: of its part without the direction of approach, over the holds [rad or m].
        by_posture: whether it depends on the posture, significantly.
        holds: number of holds.
    """

    rms: float
    by_posture: bool
    holds: int


def static_error(
    problem: Problem, machine: Machine, theta: Array, recordings: Sequence[Recording], least: float
) -> StaticError | None:
    """The error at rest of a position axis, if it is significant and not smaller than ``least``; else None.

    Args:
        problem: its command stage.
        theta: parameters without a static error, (N,).
        least: least error of practical significance, root mean square over the holds [rad or m].
    """
    found = [_holds(problem, machine, theta, recording) for recording in recordings]
    error, direction, posture = (np.concatenate(parts) for parts in zip(*found, strict=True)) if found else (np.empty(0),) * 3
    count = len(error)
    if count < 2 * HOLDS_PER_COEFFICIENT:
        return None
    friction = direction[:, None] if np.ptp(direction) > 0.0 else np.empty((count, 0))
    constant = np.column_stack([friction, np.ones(count)])
    functions = _functions(posture)
    whole = constant
    if count >= HOLDS_PER_COEFFICIENT * (constant.shape[1] + functions.shape[1]):
        whole = np.column_stack([constant, functions])
    if min(_probability(error, friction, whole), _probability(error, friction, constant)) > LEVEL:
        return None
    weights = np.linalg.lstsq(whole, error, rcond=None)[0]
    rms = float(np.sqrt(np.mean((whole[:, friction.shape[1] :] @ weights[friction.shape[1] :]) ** 2)))
    if rms < least:
        return None
    return StaticError(rms, whole is not constant and _probability(error, constant, whole) < LEVEL, count)


def _holds(problem: Problem, machine: Machine, theta: Array, recording: Recording) -> tuple[Array, Array, Array]:
    """Error at the end of each hold (m,), direction from which it was reached (m,), and posture (m, A), of one recording."""
    command = recording.values(axis_signal(problem.target, "command"))
    left = problem.residual(theta, recording)[:, 0]
    joints = np.column_stack([recording.values(axis_signal(name, "joint")) for name in machine.axis_names])
    span = float(np.nanmax(command) - np.nanmin(command)) if np.isfinite(command).any() else 0.0
    moved = np.flatnonzero(~(np.abs(np.diff(command)) <= STILL * span)) + 1  # a missing setpoint ends a hold as well
    least, end = round(HOLD * recording.rate_hz), max(1, round(END * recording.rate_hz))
    errors, directions, postures = [], [], []
    for first, last in pairwise([*moved, len(command)]):
        if last - first < least or np.isnan(command[first - 1 : last]).any():
            continue
        error = left[last - end : last]
        if np.isnan(error).any():
            continue
        errors.append(float(error.mean()))
        directions.append(float(np.sign(command[first] - command[first - 1])))
        postures.append(np.nan_to_num(joints[last - end : last]).mean(axis=0))
    return np.array(errors), np.array(directions), np.reshape(postures, (len(errors), len(machine.axes)))


def _functions(posture: Array) -> Array:
    """Functions of the posture (m, A): linear and quadratic in each joint that moves, centred and scaled."""
    moving = posture[:, np.ptp(posture, axis=0) > 0.0]
    scaled = (moving - moving.mean(axis=0)) / np.ptp(moving, axis=0)
    return np.column_stack([scaled, scaled**2])


def _probability(error: Array, less: Array, more: Array) -> float:
    """Probability of such a fall of the squares if the further columns of ``more`` had no influence (F-test)."""
    squares = [float(np.sum((error - table @ np.linalg.lstsq(table, error, rcond=None)[0]) ** 2)) for table in (less, more)]
    rank = [int(np.linalg.matrix_rank(table)) if table.shape[1] else 0 for table in (less, more)]
    further, free = rank[1] - rank[0], len(error) - rank[1]
    if further <= 0 or free <= 0:
        return 1.0
    if squares[1] <= 0.0:
        return 0.0 if squares[0] > 0.0 else 1.0
    return float(stats.f.sf((squares[0] - squares[1]) / further / (squares[1] / free), further, free))


def sags(problem: Problem, candidates: Sequence[Candidate]) -> bool:
    """Whether the stage is that of a position axis that may sag under a gravity moment that the recordings vary."""
    return problem.kind.sags and any(c.effect is joint_compliance.EFFECT for c in candidates)


def fewest_sets(model: ModelFit, candidates: Sequence[Candidate], refit: Refit) -> list[ModelFit]:
    """The model without effects at rest that are not needed, then sets with another one in place of one of it.

    Args:
        candidates: of the stage.
        refit: fit of a set, begun at the values of a model.
    """
    fewest = model
    while here := [c for c in fewest.candidates if c.effect in AT_REST]:
        smaller = min((refit(_without(fewest, c), fewest) for c in here), key=lambda f: f.left)
        if not as_little(smaller.left, model.left):
            break
        fewest = smaller
    found = [fewest]
    for candidate in fewest.candidates:
        if candidate.effect in AT_REST:
            used = {c.key for c in fewest.candidates}
            others = [c for c in candidates if c.effect in AT_REST and c.key not in used and c.form is c.effect.forms[0]]
            swapped = (refit((*_without(fewest, candidate), other), fewest) for other in others)
            found += [f for f in swapped if as_little(f.left, model.left)]
    return found


def _without(model: ModelFit, candidate: Candidate) -> tuple[Candidate, ...]:
    return tuple(c for c in model.candidates if c is not candidate)


def sagging_axis(tie: Sequence[tuple[str, str]], machine: Machine) -> str:
    """The position axis that such a tie is about, its load not known; empty for other ties."""
    axes = [target for name, target in tie if name == joint_compliance.EFFECT.name]
    biased = any(name == sensor_bias.EFFECT.name for name, _ in tie)
    if not axes or not biased or machine.axis(axes[0]).actuation != "position":
        return ""
    kinematics = machine.kinematics()
    if kinematics is not None and has_masses(kinematics):
        return ""
    return axes[0]


def advice_on_sag(axes: Sequence[str]) -> str:
    """What would distinguish the two on these axes."""
    return (
        f"Gravity of {listed(list(axes))}: give the masses (urdf, tip and the joint of each axis in machine.toml). Or record "
        "the same postures at rest with a known weight at the tip and without: sag under the load changes with the weight, an "
        "error of the sensor does not."
    )
