"""Motion of the tip by small errors of an arm that no effect of the catalogue describes, at its poses.

Every part of an arm is a little off: a joint axis is tilted, a link is offset across its length, an encoder is eccentric, a
link bends sideways under load. Each of these errors is random and small; their sizes, one for each kind, are estimated. Without
them, every such error would become a zero offset or a length of some other joint.

Sources: Hollerbach and Wampler, IJRR 15 (1996), 573–591 (complete kinematic errors of a chain); Kennedy and O'Hagan, J. R.
Statist. Soc. B 63 (2001), 425–464 (a discrepancy beside calibrated parameters).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.machine import Kinematics
from sysid.machine.kinematics import GRAVITY
from sysid.machine.moved_bodies import moved_bodies

Array = npt.NDArray[np.float64]

#: Kinds of error, each with a size of its own: shift of a link across its length [m], tilt of a joint's axis [rad],
#: eccentricity of an encoder [rad], and tilt by the moment that acts across the axis [rad at the largest moment].
KINDS = ("shift", "tilt", "eccentricity", "lateral deflection")
#: An error that moves the tip by less than this share of the largest of its kind is left out.
UNSEEN = 1e-6


@dataclass(frozen=True)
class Tangents:
    """``columns`` (n, 3, p): motion of the tip per unit of each error [m]; ``kind`` (p,): indices into :data:`KINDS`."""

    columns: Array
    kind: npt.NDArray[np.int64]


def tangents_of(kinematics: Kinematics, joints: Array) -> Tangents:
    """The errors of a chain at joint values (n, A)."""
    poses = kinematics.link_poses(joints)
    tip = poses[kinematics.tip][:, :3, 3]
    frames = [(j, poses[j.child]) for j in kinematics.chain if j.name in kinematics.actuated]
    origins = [frame[:, :3, 3] for _, frame in frames] + [tip]
    weights = _weights(kinematics, poses)
    columns: list[Array] = []
    kinds: list[int] = []
    for k, (joint, frame) in enumerate(frames):
        turn, origin = frame[:, :3, :3], frame[:, :3, 3]
        value = joints[:, kinematics.actuated.index(joint.name)]
        across = _across(np.asarray(joint.axis))
        link = np.einsum("nji,nj->ni", turn, origins[k + 1] - origin)  # to the next joint, in the frame that the joint moves
        aligned = float(np.ptp(link, axis=0).max()) < 1e-9 and float(np.linalg.norm(link[0])) > 1e-9
        for axis in _across(link[0]) if aligned else np.eye(3):
            columns.append(turn @ axis)
            kinds.append(0)
        for axis in across:
            world = turn @ axis
            columns.append(np.cross(world, tip - origin))
            kinds.append(1)
        if not joint.prismatic:
            own = np.cross(turn @ np.asarray(joint.axis), tip - origin)
            columns += [own * np.sin(value)[:, None], own * np.cos(value)[:, None]]
            kinds += [2, 2]
        moment = _moment(weights[k:], origin)
        for axis in across:
            world = turn @ axis
            columns.append(np.cross(world, tip - origin) * np.einsum("nj,nj->n", world, moment)[:, None])
            kinds.append(3)
    table, kind = np.stack(columns, axis=2), np.array(kinds)
    bent = kind == 3
    largest = _largest_moment(weights, origins)
    table[:, :, bent] /= largest
    size = np.sqrt((table**2).sum(axis=(0, 1)))
    kept = size > UNSEEN * max(float(size.max(initial=0.0)), 1e-300)
    return Tangents(table[:, :, kept], kind[kept])


def _across(axis: Array) -> Array:
    """Two unit vectors across an axis, (2, 3)."""
    unit = axis / np.linalg.norm(axis)
    first = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(unit, first)])


def _weights(kinematics: Kinematics, poses: dict[str, Array]) -> list[tuple[float, Array]]:
    """(mass [kg], its centre (n, 3)) moved by each joint of the chain that an axis moves and by no further one."""
    driven = [joint.child for joint in kinematics.chain if joint.name in kinematics.drives]
    return [
        (body.mass, (poses[child] @ np.array([*body.centre, 1.0]))[:, :3])
        for child, body in zip(driven, moved_bodies(kinematics), strict=True)
    ]


def _moment(weights: list[tuple[float, Array]], origin: Array) -> Array:
    """Moment of the weights about an origin (n, 3) [N·m]."""
    down = np.array([0.0, 0.0, -GRAVITY])
    return np.asarray(sum((np.cross(at - origin, mass * down) for mass, at in weights), np.zeros(origin.shape)))


def _largest_moment(weights: list[tuple[float, Array]], origins: list[Array]) -> float:
    moments = [np.linalg.norm(_moment(weights[k:], origin), axis=1).max() for k, origin in enumerate(origins[:-1])]
    return max(float(max(moments, default=0.0)), 1e-12)
