"""Forces of a whole arm as rows of a linear regression, and what it may change: candidates, and errors of the links.

Torques are linear in the inertial parameters of all links, and in proportion to the force constant of each axis. Of this
product the regression contains the terms of first order, about the plant under test or about a plant found before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.effects import link_mass_error, payload
from sysid.gap.arm.forces import FRICTION, axis_friction
from sysid.gap.candidates import Candidate
from sysid.machine.rigid_body import CHUNK, PARAMETERS, RigidBody
from sysid.plant import Model
from sysid.plant.force import force_inputs
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.link_torque import inertial_parameters, link_motion, link_torque, rotors_and_scales

if TYPE_CHECKING:
    from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Seconds of a block, whose rows may depend on each other, and largest number of blocks.
BLOCK, BLOCKS = 4.0, 60
#: Kinds of small error, each with a size of its own [share]: all parameters of a link together, first moment, inertia; the
#: constant from which the force of an axis was computed, the inertia of its rotor, and that of what the tip carries, in
#: :data:`TIP_INERTIA`.
MASS, FIRST_MOMENT, INERTIA, FORCE_CONSTANT, ROTOR, AT_TIP = range(6)
#: Standard deviations by which the mass of a payload is above zero.
CERTAIN = 2.0
#: Unit of the inertia that a body at the tip may add to that of the last link [kg·m²]: four kilograms at five centimetres.
TIP_INERTIA = 0.01


@dataclass(frozen=True)
class AxisRows:
    """One axis: ``links`` (m, 10·B) slopes by inertial parameters, ``carried`` (m,) by the relative error of the constant.

    ``rotor`` (m,): inertial force of a rotor with known inertia; ``friction`` (m, 7). ``block`` (m,): number of the block of
    seconds. ``target`` (m,): measured force less the rotor's and the torque of the links of the plant under test, and what the
    linearisation adds. Where the sign of friction is unknown, all columns are zero before the low-pass.
    """

    axis: str
    target: Array
    carried: Array
    rotor: Array
    links: Array
    friction: Array
    block: npt.NDArray[np.int64]


def axis_rows(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array) -> list[AxisRows]:
    """The rows of every axis of a links problem."""
    rigid = model.rigid
    assert rigid is not None
    names = [signal_name.rpartition(".")[0] for signal_name in problem.signals]
    scales = rotors_and_scales(model, theta)[1]
    found: dict[str, list[tuple[Array, ...]]] = {name: [] for name in names}
    begin = 0.0
    for recording in recordings:
        motion = link_motion(model, recording)
        assert motion is not None  # the problem contains such recordings only
        measured, rows = problem.measured(recording), problem.rows(recording)
        slopes = [np.empty((len(recording), rigid.nominal.size)) for _ in names]
        places = [model.axis_index(name) for name in names]
        for k in range(0, len(recording), CHUNK):
            part = rigid.regressor(*(values[k : k + CHUNK] for values in motion)) * scales[:, None]
            for columns, i in zip(slopes, places, strict=True):
                columns[k : k + CHUNK] = part[:, i]
        time = begin + rows / recording.rate_hz
        begin += len(recording) / recording.rate_hz
        for j, name in enumerate(names):
            nominal = link_torque(model, theta, recording, name)
            axis, at = model.machine.axis(name), places[j] * AXIS_WIDTH + AT.inertia_error
            own = force_inputs(recording, axis, rows=rows)
            rotor = (axis.inertia or 0.0) * theta[at] * own.acceleration
            friction = axis_friction(own, axis, nominal.carried)
            table = np.column_stack(
                [nominal.constant * own.raw - nominal.whole - rotor, nominal.carried, rotor, friction, slopes[j]]
            )
            there = ~np.isnan(measured[:, j])
            used = np.flatnonzero(table.any(axis=0))
            filtered = np.zeros((int(there.sum()), table.shape[1]))
            filtered[:, used] = own.compared(table[:, used])[there]
            last = 3 + FRICTION
            found[name].append((*filtered[:, :3].T, filtered[:, last:], filtered[:, 3:last], time[there]))
    whole = max(begin, 1e-9)
    count = max(1, min(BLOCKS, int(whole / BLOCK)))
    axes = []
    for name, parts in found.items():
        target, carried, rotor, links, friction, time = (np.concatenate(column) for column in zip(*parts, strict=True))
        axes.append(AxisRows(name, target, carried, rotor, links, friction, (time * count / whole).astype(np.int64)))
    return axes


def with_carried(
    rows: Sequence[AxisRows], model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array
) -> list[AxisRows]:
    """The rows with the friction that grows with the torques of the links of ``theta``."""
    found = list[AxisRows]()
    for j, own in enumerate(rows):
        axis, parts = model.machine.axis(own.axis), list[Array]()
        for recording in recordings:
            inputs = force_inputs(recording, axis, rows=problem.rows(recording))
            columns = axis_friction(inputs, axis, link_torque(model, theta, recording, own.axis).carried)
            parts.append(inputs.compared(columns)[~np.isnan(problem.measured(recording)[:, j])])
        found.append(replace(own, friction=np.concatenate(parts)))
    return found


def linearised(rows: Sequence[AxisRows], model: Model, theta: Array, about: Array) -> list[AxisRows]:
    """Rows about the plant under test ``theta``, linearised about another vector instead.

    With slopes L, torque T of the links, change x of inertial parameters and relative error c of the force constant,
    (1 + c)·(T + L·x) ≈ T + (1 + ĉ)·L·x + c·(T + L·x̂) − ĉ·L·x̂: a payload is in proportion to the constant, too.
    """
    change = (inertial_parameters(model, about) - inertial_parameters(model, theta)).reshape(-1)
    ratio = rotors_and_scales(model, about)[1] / rotors_and_scales(model, theta)[1]
    found = list[AxisRows]()
    for own in rows:
        scale, added = float(ratio[model.axis_index(own.axis)]), own.links @ change
        target = own.target + (scale - 1.0) * added
        found.append(replace(own, target=target, carried=own.carried + added, links=scale * own.links))
    return found


def inefficiency(residual: Array, columns: Array, block: npt.NDArray[np.int64]) -> float:
    """Rows per independent row, for the estimate of the coefficients of ``columns`` (m, k): one for white residuals (m,).

    Products of residual and column are summed over blocks of seconds: the ratio of the variance of these sums to that of
    independent rows, mean over the columns (Liang and Zeger, Biometrika 73 (1986), 13–22).
    """
    size = (columns**2).sum(axis=0)
    columns, size = columns[:, size > 0.0], size[size > 0.0]
    power = float(np.mean(residual**2))
    if power <= 0.0 or not len(size):
        return 1.0
    _, number = np.unique(block, return_inverse=True)
    sums = np.zeros((int(number.max()) + 1, columns.shape[1]))
    np.add.at(sums, number, columns * residual[:, None])
    return max(1.0, float(np.mean((sums**2).sum(axis=0) / (power * size))))


def link_errors(model: Model, theta: Array) -> tuple[Array, npt.NDArray[np.int64]]:
    """Relative errors of every link that an axis moves by its own joint, and of the inertia of what the tip carries.

    First moments relative to mass times the distance of the centre, or the radius of gyration if that is larger; moments of
    inertia to mass times the radius of gyration squared. What the arm carries has an inertia of its own, beside a small one of
    the last link.

    Returns:
        Change of the inertial parameters per unit of each error, (p, B, 10), and its kind, (p,).
    """
    rigid = model.rigid
    assert rigid is not None
    parameters = inertial_parameters(model, theta)
    found = list[tuple[int, int, Array]]()
    for body in rigid.body_of:
        own = parameters[body]
        mass = own[0]
        if mass <= 0.0:
            continue
        spread = max(float(own[4] + own[6] + own[9]) / 2.0, 0.0)  # half the trace of the inertia
        radius = max(float(np.linalg.norm(own[1:4])) / mass, float(np.sqrt(spread / mass)), 1e-3)
        found.append((MASS, body, own))
        found += [(FIRST_MOMENT, body, mass * radius * row) for row in np.eye(PARAMETERS)[1:4]]
        found += [(INERTIA, body, mass * radius**2 * row) for row in np.eye(PARAMETERS)[4:]]
    found += [(AT_TIP, rigid.tip.body, TIP_INERTIA * row) for row in np.eye(PARAMETERS)[4:]]
    change = np.zeros((len(found), *parameters.shape))
    for own_change, (_, body, part) in zip(change, found, strict=True):
        own_change[body] = part
    return change, np.array([kind for kind, _, _ in found])


def change_of(model: Model, candidate: Candidate) -> Array:
    """Change of the inertial parameters per unit of each linear coordinate of a candidate, (k, B, 10).

    A payload is linear in its mass and first moment, a link in its ratio.
    """
    rigid = model.rigid
    assert rigid is not None
    if candidate.effect is payload.EFFECT:
        found = np.zeros((4, *rigid.nominal.shape))
        found[:, rigid.tip.body] = [_point(rigid, 1.0, np.zeros(3)), *(_point(rigid, 0.0, axis) for axis in np.eye(3))]
        return found
    assert candidate.effect is link_mass_error.EFFECT
    body = rigid.body_of[model.axis_index(candidate.target)]
    found = np.zeros((1, *rigid.nominal.shape))
    found[0, body] = rigid.nominal[body]
    return found


def to_linear(candidate: Candidate, values: Array) -> Array:
    """Linear coordinates of a candidate's values (or of their prior widths): of a payload mass and first moment."""
    return np.array([values[0], *(values[0] * values[1:])]) if candidate.effect is payload.EFFECT else values


def from_linear(candidate: Candidate, linear: Array) -> tuple[Array, Array]:
    """Values (k,) of a candidate, of a payload mass and centre, and their derivative by the linear coordinates, (k, k)."""
    if candidate.effect is not payload.EFFECT:
        return linear, np.eye(len(linear))
    mass = max(float(linear[0]), 1e-9)
    slope = np.eye(4) / mass
    slope[0] = [1.0, 0.0, 0.0, 0.0]
    slope[1:, 0] = -linear[1:] / mass**2
    return np.array([mass, *(linear[1:] / mass)]), slope


def plausible(candidate: Candidate, linear: Array, deviations: Array) -> bool:
    """Whether a payload has a mass certainly above zero and a centre within its bounds; any other effect is plausible."""
    if candidate.effect is not payload.EFFECT:
        return True
    bounds = np.array([u.bounds for u in candidate.unknowns[1:]])
    centre = linear[1:] / max(float(linear[0]), 1e-9)
    certain = linear[0] > CERTAIN * deviations[0]
    return bool(certain and (centre >= bounds[:, 0]).all() and (centre <= bounds[:, 1]).all())


def doubled(model: Model, candidates: Sequence[Candidate]) -> bool:
    """Whether a payload and the mass of the link that carries it are both among the effects: the payload contains the other."""
    rigid = model.rigid
    assert rigid is not None
    masses = [c for c in candidates if c.effect is link_mass_error.EFFECT]
    heavier = any(rigid.body_of[model.axis_index(c.target)] == rigid.tip.body for c in masses)
    return heavier and any(c.effect is payload.EFFECT for c in candidates)


def columns_of(links: Array, changes: Array) -> Array:
    """Columns (m, p) of changes (p, B, 10) of the inertial parameters; ``links`` (m, 10·B)."""
    return np.asarray(links @ changes.reshape(len(changes), -1).T)


def _point(rigid: RigidBody, mass: float, first_moment: Array) -> Array:
    """Inertial parameters (10,) of a point mass in the frame of the tip's joint, without the term of second order."""
    at, moment = rigid.tip.place, rigid.tip.rotation @ first_moment
    second = mass * np.outer(at, at) + np.outer(at, moment) + np.outer(moment, at)
    inertia = np.trace(second) * np.eye(3) - second
    return np.array(
        [mass, *(moment + mass * at), *(inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))]
    )
