"""Shapes of the links from the URDF's <visual> elements.

Source: URDF specification (ROS wiki, ``urdf/XML/link``). A dataset version does not contain mesh files: a link with a mesh
only, or without any visual, is a bar to its next joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.machine import Kinematics
from sysid.machine.kinematics import origin_pose
from sysid.machine.urdf_tree import urdf_tree

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A primitive in the frame of its link.

    Args:
        kind: ``box``: size is (x, y, z); ``cylinder``: (radius, length along z); ``sphere``: (radius,); ``bar``: the end point.
        size: [m].
        pose: centre and orientation in the link's frame, 4×4.
    """

    kind: Literal["box", "cylinder", "sphere", "bar"]
    size: tuple[float, ...]
    pose: Array


def link_shapes(urdf: str, kinematics: Kinematics) -> dict[str, tuple[Shape, ...]]:
    """Shapes of every link of the chain: at least one, except for a last link without visuals."""
    described = {str(link.get("name")): link for link in urdf_tree(urdf).findall("link")}
    links = [kinematics.chain[0].parent, *(joint.child for joint in kinematics.chain)]
    shapes: dict[str, tuple[Shape, ...]] = {}
    for link in links:
        element = described.get(link)
        found = tuple(
            shape for visual in (element.findall("visual") if element is not None else []) for shape in _shape(visual)
        )
        shapes[link] = found or _bar(link, kinematics)
    return shapes


def _shape(visual: Element) -> tuple[Shape, ...]:
    pose = origin_pose(visual.find("origin"))
    box, cylinder, sphere = (visual.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        return (Shape("box", _numbers(box.get("size", "")), pose),)
    if cylinder is not None:
        return (Shape("cylinder", _numbers(f"{cylinder.get('radius')} {cylinder.get('length')}"), pose),)
    if sphere is not None:
        return (Shape("sphere", _numbers(sphere.get("radius", "")), pose),)
    return ()


def _bar(link: str, kinematics: Kinematics) -> tuple[Shape, ...]:
    """A bar from the link's frame to its child joint; empty where the two coincide."""
    for joint in kinematics.chain:
        if joint.parent == link:
            end = joint.origin[:3, 3]
            if float(np.linalg.norm(end)) > 1e-6:
                return (Shape("bar", (float(end[0]), float(end[1]), float(end[2])), np.eye(4)),)
    return ()


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())
