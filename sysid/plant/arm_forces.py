"""Commands of the force axes of an arm that a plant needs for a motion of all of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.plant.link_torque import force_constants, inertial_parameters, rotors_and_scales
from sysid.plant.model import Model

Array = npt.NDArray[np.float64]


def arm_forces(model: Model, theta: Array, q: Array, v: Array, a: Array, dt: float) -> Array:
    """Commands for the forces of the links, rotors and friction, each (n, A) → (n, A) [N·m or N].

    Args:
        q, v, a: positions, speeds and accelerations of the axes [rad or m, and per s, s²], in steps of ``dt``.
    """
    assert model.rigid is not None
    rotors, scales = rotors_and_scales(model, theta)
    links = model.rigid.torque(q, v, a, inertial_parameters(model, theta)) * scales
    names = model.machine.axis_names
    own = [model.inverse(theta, name, q[:, i], v[:, i], a[:, i], dt, links[:, i]) for i, name in enumerate(names)]
    return np.column_stack(own) + (links + a * rotors) / force_constants(model, theta)
