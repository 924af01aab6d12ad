"""Masses that each joint of a chain moves: the bodies whose weight loads it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import Kinematics, origin_pose
from sysid.machine.urdf_tree import moments_of, urdf_tree

Array = npt.NDArray[np.float64]

#: Mass at the tip of a machine whose URDF has none [kg]: a load is then the gravity moment of one kilogram (contract).
UNIT_MASS = 1.0
#: Inertial parameters of a body.
PARAMETERS = 10


@dataclass(frozen=True)
class MovedBody:
    """``mass`` [kg] of all that moves with a joint and no further one, and its ``centre`` (3,) [m] in the frame it moves."""

    mass: float
    centre: Array


def has_masses(kinematics: Kinematics) -> bool:
    """Whether the URDF gives a mass that a joint of the chain moves."""
    return any(mass > 0.0 for group in _groups(kinematics)[0] for mass, _ in group)


def moved_bodies(kinematics: Kinematics) -> tuple[MovedBody, ...]:
    """One for each joint of the chain that an axis moves, itself or as a passive joint, from base to tip."""
    groups, tip = _groups(kinematics)
    if groups and not any(mass for group in groups for mass, _ in group):
        groups[-1].append((UNIT_MASS, tip))
    return tuple(_joined(group) for group in groups)


def moved_inertias(kinematics: Kinematics, urdf: str) -> Array:
    """Inertial parameters of all that moves with each joint of the chain and no further one, (J, 10).

    Mass [kg], first moment (3) [kg·m] and inertia xx, xy, yy, xz, yz, zz [kg·m²] about the origin of the joint in the frame it
    moves; zero without masses. Joints beside the chain rest at zero.

    Args:
        urdf: the text of the machine's URDF.

    Source: Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986.
    """
    links = {link.get("name", ""): link for link in urdf_tree(urdf).findall("link")}
    on_chain = {joint.name for joint in kinematics.chain}
    rows: list[Array] = []
    for number, joint, frame in kinematics.moved_frames():
        if number == len(rows):
            rows.append(np.zeros(PARAMETERS))
        if rows:  # fixed masses have no influence
            rows[-1] += _rigid(kinematics, links, joint.child, frame, on_chain)
    return np.array(rows).reshape(-1, PARAMETERS)


def _rigid(kinematics: Kinematics, links: Mapping[str, Element], link: str, frame: Array, on_chain: set[str]) -> Array:
    """Inertial parameters (10,) of a link at pose ``frame`` (4, 4) and of all that is attached to it beside the chain."""
    total, inertial = np.zeros(PARAMETERS), links[link].find("inertial")
    if link in kinematics.masses and inertial is not None:
        mass = kinematics.masses[link][0]
        pose = frame @ origin_pose(inertial.find("origin"))
        at, turn = pose[:3, 3], pose[:3, :3]
        moments = turn @ moments_of(inertial.find("inertia")) @ turn.T + mass * (float(at @ at) * np.eye(3) - np.outer(at, at))
        total[0], total[1:4], total[4:] = mass, mass * at, moments[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    for joint in kinematics.joints.values():
        if joint.parent == link and joint.name not in on_chain:
            total += _rigid(kinematics, links, joint.child, frame @ joint.origin, on_chain)
    return total


def _groups(kinematics: Kinematics) -> tuple[list[list[tuple[float, Array]]], Array]:
    """Masses and their centres that each moved joint moves, in its frame, and the tip (3,) in that of the last one [m]."""
    groups: list[list[tuple[float, Array]]] = []
    frame = np.eye(4)
    for number, joint, frame in kinematics.moved_frames():
        if number == len(groups):
            groups.append([])
        if groups:  # fixed masses load no axis
            groups[-1] += _bodies(kinematics, joint.child, frame)
    return groups, frame[:3, 3]


def _joined(group: list[tuple[float, Array]]) -> MovedBody:
    mass = float(sum(mass for mass, _ in group))
    return MovedBody(mass, sum((mass * at for mass, at in group), np.zeros(3)) / mass if mass > 0.0 else np.zeros(3))


def _bodies(kinematics: Kinematics, link: str, frame: Array) -> list[tuple[float, Array]]:
    """(mass, centre in the moved frame) of a link and of all that is attached to it beside the chain.

    A part on a joint beside the chain (a gripper, the rod of a parallel linkage) hangs: its weight acts at that joint.
    """
    found = []
    if link in kinematics.masses:
        mass, centre = kinematics.masses[link]
        found.append((mass, (frame @ np.array([*centre, 1.0]))[:3]))
    on_chain = {joint.name for joint in kinematics.chain}
    for joint in kinematics.joints.values():
        if joint.parent == link and joint.name not in on_chain:
            at = frame @ joint.origin
            attached = _bodies(kinematics, joint.child, at)
            hangs = joint.kind in ("revolute", "continuous")
            found += [(mass, at[:3, 3]) for mass, _ in attached] if hangs else attached
    return found
