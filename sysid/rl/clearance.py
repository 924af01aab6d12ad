"""Distance of a machine's links from spherical obstacles; links are straight lines between the axes of successive joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.rl import damped_least_squares as solver
from sysid.rl.inverse_kinematics import KinematicChain

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Sphere:
    """An obstacle.

    Args:
        centre: (3,) [m], in the frame of the base.
        radius: [m], the thickness of the links included.
    """

    centre: Array
    radius: float


def link_ends(chain: KinematicChain, joints: npt.ArrayLike) -> Array:
    """Origins of the joints, then the tip, (n, J + 1, 3) [m] at joints (n, A)."""
    rows = chain.rows
    lasts = [*(row[solver.SHIFT : solver.SHIFT + 3] for row in rows), chain.last]
    return np.stack(
        [KinematicChain(rows[:k], np.ascontiguousarray(last)).predict(joints) for k, last in enumerate(lasts)], axis=1
    )


def clearance(chain: KinematicChain, joints: npt.ArrayLike, obstacle: Sphere) -> Array:
    """Least distance of a link from the surface of the obstacle, (n,) [m] at joints (n, A); negative inside."""
    ends = link_ends(chain, joints)
    begin, along = ends[:, :-1], np.diff(ends, axis=1)
    length = np.maximum(np.sum(along**2, axis=2), 1e-12)
    share = np.clip(np.sum((obstacle.centre - begin) * along, axis=2) / length, 0.0, 1.0)
    nearest = begin + share[:, :, None] * along
    return np.asarray(np.linalg.norm(nearest - obstacle.centre, axis=2).min(axis=1) - obstacle.radius)
