"""What a whole-arm regression may change: columns of candidates and of errors of the links, and the effects they become."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.effects import link_mass_error, payload
from sysid.gap.candidates import Candidate
from sysid.machine.rigid_body import PARAMETERS, RigidBody
from sysid.plant import Model
from sysid.plant.link_torque import inertial_parameters

Array = npt.NDArray[np.float64]

#: Kinds of error, each with a size of its own [share]: all parameters of a link together, first moment, inertia; and that of
#: the constant from which the force of an axis was computed, of the inertia of its rotor, and of the inertia of what the tip
#: carries, in :data:`TIP_INERTIA`.
KINDS = ("mass", "first moment", "inertia", "force constant", "rotor", "inertia at the tip")
FORCE_CONSTANT, ROTOR, AT_TIP = 3, 4, 5
#: Standard deviations by which the mass of a payload is above zero.
CERTAIN = 2.0
#: Unit of the inertia that a body at the tip may add to that of the last link [kg·m²]: four kilograms at five centimetres.
TIP_INERTIA = 0.01


@dataclass(frozen=True)
class LinkErrors:
    """Errors of the links: ``change`` (p, B, 10) of the inertial parameters per unit of each, ``kind`` (p,)."""

    change: Array
    kind: npt.NDArray[np.int64]


def link_errors(model: Model, theta: Array) -> LinkErrors:
    """Relative errors of every link that an axis moves by its own joint.

    First moments relative to mass times the distance of the centre, or the radius of gyration if that is larger; moments of
    inertia to mass times the radius of gyration squared.
    """
    rigid = model.rigid
    assert rigid is not None
    parameters = inertial_parameters(model, theta)
    changes, kinds = list[Array](), list[int]()
    for body in rigid.body_of:
        own = parameters[body]
        mass = own[0]
        if mass <= 0.0:
            continue
        spread = max(float(own[4] + own[6] + own[9]) / 2.0, 0.0)  # half the trace of the inertia
        radius = max(float(np.linalg.norm(own[1:4])) / mass, float(np.sqrt(spread / mass)), 1e-3)
        parts = [own, *(mass * radius * row for row in np.eye(PARAMETERS)[1:4])]
        parts += [mass * radius**2 * row for row in np.eye(PARAMETERS)[4:]]
        for part, kind in zip(parts, (0, 1, 1, 1, *[2] * 6), strict=True):
            change = np.zeros(parameters.shape)
            change[body] = part
            changes.append(change)
            kinds.append(kind)
    for row in np.eye(PARAMETERS)[4:]:  # what the arm carries has an inertia of its own, beside a small one of the last link
        change = np.zeros(parameters.shape)
        change[rigid.tip.body] = TIP_INERTIA * row
        changes.append(change)
        kinds.append(AT_TIP)
    return LinkErrors(np.array(changes).reshape(-1, *parameters.shape), np.array(kinds, dtype=np.int64))


def change_of(model: Model, theta: Array, candidate: Candidate) -> Array:
    """Change of the inertial parameters per unit of each linear coordinate of a candidate, (k, B, 10).

    A payload is linear in its mass and first moment, a link in its ratio.
    """
    rigid = model.rigid
    assert rigid is not None
    if candidate.effect is payload.EFFECT:
        rows = [_point(rigid, 1.0, np.zeros(3)), *(_point(rigid, 0.0, axis) for axis in np.eye(3))]
        found = np.zeros((4, *rigid.nominal.shape))
        found[:, rigid.tip.body] = rows
        return found
    assert candidate.effect is link_mass_error.EFFECT
    body = rigid.body_of[model.axis_index(candidate.target)]
    found = np.zeros((1, *rigid.nominal.shape))
    found[0, body] = rigid.nominal[body]
    return found


def to_linear(candidate: Candidate, values: Array) -> Array:
    """Linear coordinates of a candidate's values: of a payload mass and first moment."""
    return np.array([values[0], *(values[0] * values[1:])]) if candidate.effect is payload.EFFECT else values


def from_linear(candidate: Candidate, linear: Array) -> Array:
    """Values of a candidate: of a payload mass and centre."""
    if candidate.effect is not payload.EFFECT:
        return linear
    mass = max(float(linear[0]), 1e-9)
    return np.array([mass, *(linear[1:] / mass)])


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
    assert model.rigid is not None
    carrying = [
        n for n, body in zip(model.machine.axis_names, model.rigid.body_of, strict=True) if body == model.rigid.tip.body
    ]
    heavier = any(c.effect is link_mass_error.EFFECT and c.target in carrying for c in candidates)
    return heavier and any(c.effect is payload.EFFECT for c in candidates)


def slope_of(candidate: Candidate, linear: Array) -> Array:
    """Derivative of the values by the linear coordinates, (k, k)."""
    if candidate.effect is not payload.EFFECT:
        return np.eye(len(linear))
    mass = max(float(linear[0]), 1e-9)
    slope = np.eye(4) / mass
    slope[0] = [1.0, 0.0, 0.0, 0.0]
    slope[1:, 0] = -linear[1:] / mass**2
    return slope


def linear_width(candidate: Candidate, width: Array) -> Array:
    """Prior widths of the linear coordinates, from those of the values."""
    return np.array([width[0], *(width[0] * width[1:])]) if candidate.effect is payload.EFFECT else width


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


def places(candidates: Sequence[Candidate]) -> list[npt.NDArray[np.intp]]:
    """Indices of the unknowns of each candidate among those of all."""
    ends = np.cumsum([0, *(len(c.unknowns) for c in candidates)])
    return [np.arange(a, b, dtype=np.intp) for a, b in pairwise(ends)]
