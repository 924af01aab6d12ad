"""Inertial parameters of an arm as bodies of a physics engine can have them.

Torques of an arm determine combinations of the parameters of its bodies only, and the least-squares values of the others need
not be those of a mass distribution. A body can have mass m, first moment h and inertia I about its joint if its pseudo-inertia
``[[½·tr(I)·1 − I, h], [hᵀ, m]]`` is positive definite. Where one is not, the parameters are replaced by admissible ones with
the least change of torques.

Source: Wensing, Kim, Slotine, IEEE Robotics and Automation Letters 3(1), 2018 (pseudo-inertia); Rucker and Wensing, IEEE
Robotics and Automation Letters 7(2), 2022 (Cholesky factors as parameters).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from sysid.machine.rigid_body import PARAMETERS, RigidBody
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.link_torque import inertial_parameters, rotors_and_scales
from sysid.plant.model import Model, compile_plant
from sysid.plant.plant import Plant

Array = npt.NDArray[np.float64]

#: Rounding of moments of inertia, as a share of those about the joint, and least moment of a body with a mass [kg·m²].
ROUNDING, LEAST_MOMENT = 1e-9, 1e-13
#: Random states of motion over which torques are compared; largest speed [rad/s or m/s] and acceleration [per s²] of them.
STATES, SPEED, ACCELERATION = 300, 2.0, 5.0
#: Weight of the change of parameters, as a share of their size, beside the change of torques as a share of theirs.
CLOSE = 1e-4
#: Passes of the fit; each keeps close to the parameters of the one before, so that the last ones change torques the least.
PASSES = 4
_INDEX = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@dataclass(frozen=True)
class Inertial:
    """``mass`` [kg], ``centre`` (3,) [m] and ``moments`` (3, 3) [kg·m²] about it, in the axes of the frame of the joint."""

    mass: float
    centre: Array
    moments: Array


@dataclass(frozen=True)
class ArmInertia:
    """An arm in true forces.

    Args:
        bodies: of all that moves with one joint and no further one, by joint; without the payload.
        payload: mass [kg] and centre (3,) [m] in the frame of the tip; None without.
        scales: commanded over true force of each axis, (A,).
        armatures: inertia of each rotor, (A,) [kg·m² or kg].
        change: RMS change of torques by :func:`admissible` as a share of their RMS, largest of all axes; zero where the
            parameters are those of the plant.
    """

    bodies: dict[str, Inertial]
    payload: tuple[float, Array] | None
    scales: Array
    armatures: Array
    change: float


def arm_inertia(plant: Plant) -> ArmInertia:
    """Inertial parameters of a plant whose force axes move masses."""
    model = compile_plant(plant)
    rigid, load = model.rigid, plant.effect("payload", "tool")
    assert rigid is not None
    rotors, scales = rotors_and_scales(model, model.theta)
    places = np.arange(model.axes) * AXIS_WIDTH + AT.inertia_error
    stated = np.array([axis.inertia or 0.0 for axis in plant.machine.axes])
    armatures = (model.theta[places] * stated + rotors) / scales
    bare = compile_plant(plant.without_effect("payload", "tool"))
    parameters = inertial_parameters(bare, bare.theta)
    change = 0.0
    if not (all(is_admissible(row) for row in parameters) and (armatures >= 0.0).all()):
        parameters, armatures, change = admissible(model, parameters, armatures)
    bodies = {name: inertial(row) for name, row in zip(rigid.names, parameters, strict=True)}
    carried = None
    if load is not None and float(np.asarray(load.parameters["mass"])) > 0.0:
        carried = float(np.asarray(load.parameters["mass"])), np.asarray(load.parameters["centre"], dtype=np.float64)
    return ArmInertia(bodies, carried, scales, armatures, change)


def inertial(parameters: Array) -> Inertial:
    """Mass, centre and moments about it of admissible inertial parameters (10,); nothing of a body without a mass.

    A rod or a point has moments of zero, which a physics engine refuses: they are made larger by a billionth of those about the
    joint.
    """
    mass = float(parameters[0])
    if mass <= 0.0:
        return Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
    centre = parameters[1:4] / mass
    moments, least = _central(parameters)
    more = 2.0 * max(-least, 0.0) + ROUNDING * float(np.trace(_matrix(parameters[4:]))) + LEAST_MOMENT
    return Inertial(mass, centre, moments + more * np.eye(3))


def is_admissible(parameters: Array) -> bool:
    """Whether inertial parameters (10,) are those of a mass distribution, a rod or a point included, or all zero."""
    if parameters[0] <= 0.0:
        return not parameters.any()
    return _central(parameters)[1] >= -ROUNDING * float(np.trace(_matrix(parameters[4:])))


def _central(parameters: Array) -> tuple[Array, float]:
    """Moments (3, 3) about the centre of mass, and the least second moment of the mass along any direction [kg·m²]."""
    centre = parameters[1:4] / parameters[0]
    moved = parameters[0] * (float(centre @ centre) * np.eye(3) - np.outer(centre, centre))
    moments = _matrix(parameters[4:]) - moved
    return moments, float(np.linalg.eigvalsh(0.5 * np.trace(moments) * np.eye(3) - moments)[0])


def admissible(model: Model, parameters: Array, armatures: Array) -> tuple[Array, Array, float]:
    """Admissible parameters with the least change of the torques of random motions.

    Args:
        parameters: of the bodies, (B, 10); ``armatures``: of the axes, (A,).

    Returns:
        Parameters, armatures, and the largest change of an axis' torque as a share of it.
    """
    rigid = model.rigid
    assert rigid is not None
    rows, sizes = _torque_rows(model, rigid, parameters, armatures)
    triangle = np.linalg.qr((rows / sizes[None, :, None]).reshape(-1, rows.shape[2]), mode="r")
    moved = [k for k, row in enumerate(parameters) if row.any()]
    start = np.concatenate([parameters.ravel(), armatures])
    first, weights = list[Array](), np.zeros(len(start))
    for k in moved:
        nearest = _clipped(_pseudo_inertia(parameters[k]))
        first.append(np.asarray(np.linalg.cholesky(nearest), dtype=np.float64)[np.tril_indices(4)])
        weights[PARAMETERS * k : PARAMETERS * (k + 1)] = CLOSE / max(float(np.trace(nearest)), 1e-12)
    count, biggest = len(moved) * PARAMETERS, max(float(np.abs(armatures).max()), 1e-12)
    weights[parameters.size :] = CLOSE / biggest

    def slope(unknowns: Array) -> Array:
        by = np.zeros((len(start), len(unknowns)))
        for n, k in enumerate(moved):
            factor = _factor(unknowns[PARAMETERS * n : PARAMETERS * (n + 1)])
            for m, unit in enumerate(np.eye(PARAMETERS)):
                step = _factor(unit) @ factor.T
                by[PARAMETERS * k : PARAMETERS * (k + 1), PARAMETERS * n + m] = _parameters(step + step.T)
        by[parameters.size :, count:] = np.diag(2.0 * unknowns[count:])
        return np.vstack([triangle @ by / np.sqrt(STATES), weights[:, None] * by])

    def built(unknowns: Array) -> Array:
        found = np.zeros(len(start))
        for k, part in zip(moved, unknowns[:count].reshape(-1, PARAMETERS), strict=True):
            factor = _factor(part)
            found[PARAMETERS * k : PARAMETERS * (k + 1)] = _parameters(factor @ factor.T)
        found[parameters.size :] = unknowns[count:] ** 2
        return found

    def residuals(unknowns: Array) -> Array:
        found = built(unknowns)
        return np.concatenate([triangle @ (found - start) / np.sqrt(STATES), weights * (found - centre)])

    unknowns, centre = np.concatenate([*first, np.sqrt(np.maximum(armatures, 1e-6 * biggest))]), start
    for _ in range(PASSES):  # proximal: the parameters of the pass before are those that the next one stays close to
        unknowns = scipy.optimize.least_squares(residuals, unknowns, slope, x_scale="jac", max_nfev=100).x
        centre = built(unknowns)
    found = centre
    changed = np.einsum("nap,p->na", rows, found - start) / sizes
    share = float(np.sqrt(np.mean(changed**2, axis=0)).max())
    return found[: parameters.size].reshape(parameters.shape), found[parameters.size :], share


def _torque_rows(model: Model, rigid: RigidBody, parameters: Array, armatures: Array) -> tuple[Array, Array]:
    """Torque per unit of each parameter and armature in random states (n, A, 10·B + A), and the RMS torque of each axis."""
    rng, axes = np.random.default_rng(0), model.machine.axes
    ends = np.array([axis.limits if axis.limits is not None else (-np.pi, np.pi) for axis in axes])
    ends = np.clip(ends, -np.pi, np.pi)
    q = rng.uniform(ends[:, 0], ends[:, 1], (STATES, len(axes)))
    v, a = (rng.uniform(-most, most, q.shape) for most in (SPEED, ACCELERATION))
    rows = np.concatenate([rigid.regressor(q, v, a), a[:, :, None] * np.eye(len(axes))], axis=2)
    torque = np.einsum("nap,p->na", rows, np.concatenate([parameters.ravel(), armatures]))
    return rows, np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-9)


def _matrix(moments: Array) -> Array:
    found = np.zeros((3, 3))
    for (i, j), value in zip(_INDEX, moments, strict=True):
        found[i, j] = found[j, i] = value
    return found


def _pseudo_inertia(parameters: Array) -> Array:
    moments, found = _matrix(parameters[4:]), np.empty((4, 4))
    found[:3, :3] = 0.5 * np.trace(moments) * np.eye(3) - moments
    found[:3, 3] = found[3, :3] = parameters[1:4]
    found[3, 3] = parameters[0]
    return found


def _parameters(pseudo: Array) -> Array:
    second = pseudo[:3, :3]
    moments = np.trace(second) * np.eye(3) - second
    return np.array([pseudo[3, 3], *pseudo[:3, 3], *(moments[i, j] for i, j in _INDEX)])


def _factor(unknowns: Array) -> Array:
    """Lower triangular matrix (4, 4) of its elements (10,)."""
    found = np.zeros((4, 4))
    found[np.tril_indices(4)] = unknowns
    return found


def _clipped(pseudo: Array) -> Array:
    """The nearest matrix whose eigenvalues are certainly above zero."""
    values, vectors = np.linalg.eigh(pseudo)
    least = 1e-4 * max(float(values[-1]), 1e-9)
    return np.asarray(vectors @ np.diag(np.maximum(values, least)) @ vectors.T)
