"""The machine's URDF for the world: lengths of the plant, driven joints without limits, a hanging tool as identified; and the
passive joints of the tool for the tool position of the compiled plant (inverse kinematics).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.effects import gripper_sway, link_length_error, tip_offset
from sysid.errors import SettingsError
from sysid.machine import Kinematics
from sysid.machine.kinematics import GRAVITY, Joint, rotation_about
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant
from sysid.world.urdf import (
    MASS,
    chained,
    complete_inertia,
    drop_meshes,
    effort_limit,
    inertial_of,
    joint_element,
    link_element,
    links_below,
    make_touchable,
    mass_of,
    numbers,
    offset,
    parsed,
    path_to,
    pose_of,
    remove_below,
    scale_origin,
    set_inertia,
    unlimit,
)

Array = npt.NDArray[np.float64]
Gripper = Literal["rigid", "point"]

#: Mass [kg] of a tool without one in the URDF; a free swing does not depend on it.
_TOOL_MASS = 1.0
#: Mass and inertia [kg, kg·m²] of driven links without any: heavy compared with a tool, so that its reaction moves no joint.
_STRUCTURE_MASS = 10.0
#: Name of the link that is added for a tool without one in the URDF.
_TOOL = "swaying_tool"
#: A pendulum shorter than this [m] is omitted, as in the compiled step.
_MIN_LENGTH = 1e-3


@dataclass(frozen=True)
class HangingTool:
    """The two crossed passive joints below the tip.

    Args:
        joints: from the tip downwards.
        reach: pivot → tool in the frame of the last of them, (3,) [m].
        damping: of each joint [N·m·s/rad].
        tool: the hanging link.
    """

    joints: tuple[Joint, Joint]
    reach: Array
    damping: tuple[float, float]
    tool: str


@dataclass(frozen=True)
class WorldUrdf:
    """A URDF for the world, effort limits of the driven joints [N or N·m], the tool, and the height of the ground [m]."""

    urdf: str
    effort: tuple[float, ...]
    hanging: HangingTool | None
    ground: float


def build_bodies(plant: Plant, gripper: Gripper = "rigid") -> WorldUrdf:
    """Build the URDF for the world from that of the plant's machine.

    Args:
        gripper: ``rigid`` keeps masses and inertias of the URDF below the tip; ``point`` moves all of that mass to the tool's
            origin, as in the equation of ``gripper_sway``.

    Raises:
        SettingsError: the machine has no URDF, or a tip offset on a link that a joint moves.
    """
    machine = plant.machine
    kinematics = machine.kinematics()
    if kinematics is None or machine.urdf_text is None:
        found = f"machine {machine.name} has no URDF"
        raise SettingsError("PyBullet world", found, "urdf and tip in machine.toml", "The compiled plant runs without one.")
    sway = plant.effect(gripper_sway.EFFECT.name, "tool")
    root = urdf_tree(machine.urdf_text)
    if machine.tool is None and sway is not None:
        _add_tool(root, kinematics.tip)
        machine = replace(machine, tool=_TOOL, urdf_text=tostring(root, encoding="unicode"))
        kinematics = machine.kinematics()
        assert kinematics is not None
    effort = tuple(effort_limit(root, name) for name in kinematics.actuated)
    drop_meshes(root)
    _stretch(root, plant, kinematics)
    _shift_tip(root, plant, kinematics)
    for name in kinematics.drives:
        unlimit(joint_element(root, name))
    hanging = None
    if machine.tool is not None and machine.tool != machine.tip:
        path = path_to(kinematics.joints, machine.tool, kinematics.tip)
        values = {key: float(np.asarray(value)) for key, value in (sway.parameters if sway is not None else {}).items()}
        if values.get("length", 0.0) >= _MIN_LENGTH:
            hanging = _hang(root, kinematics, path, values["length"], values["damping_ratio"], gripper)
        elif any(joint.kind != "fixed" for joint in path):
            # Without gripper_sway the plant predicts the tool at the tip.
            remove_below(root, kinematics.tip)
    for link in root.findall("link"):
        complete_inertia(link, _STRUCTURE_MASS, _STRUCTURE_MASS)
    return WorldUrdf(tostring(root, encoding="unicode"), effort, hanging, _lowest(root, kinematics))


def _hang(
    root: Element, kinematics: Kinematics, path: tuple[Joint, ...], length: float, ratio: float, gripper: Gripper
) -> HangingTool:
    """Attach the tool to two crossed joints at the tip, ``length`` below them."""
    tool = path[-1].child
    movable = [joint for joint in path if joint.kind != "fixed"]
    if not _crossed(path, movable):
        _insert_joints(root, path, length)
        path = path_to(parsed(root), tool, kinematics.tip)
        movable = list(path[:2])
    last = path.index(movable[1])
    reach = offset(path[last + 1 :])
    scale = length / float(np.linalg.norm(reach))
    for joint in path[last + 1 :]:
        scale_origin(joint_element(root, joint.name).find("origin"), scale)
    for joint in movable:
        unlimit(joint_element(root, joint.name))
    below = links_below(root, kinematics.tip)
    for link in below:
        element = link_element(root, link)
        if link != tool and scale != 1.0:
            for origin in (*element.findall("inertial/origin"), *element.findall("visual/origin")):
                scale_origin(origin, scale)
        make_touchable(element)
        complete_inertia(element, _TOOL_MASS if link == tool else MASS)
    if gripper == "point":
        total = sum(mass_of(link_element(root, link)) for link in below)
        for link in below:
            mass = total if link == tool else 1e-6 * total
            set_inertia(link_element(root, link), mass, 1e-7 * mass * length**2)
    reach = scale * reach
    joints = (movable[0], movable[1])
    return HangingTool(joints, reach, _damping(root, joints, reach, ratio), tool)


def _add_tool(root: Element, tip: str) -> None:
    """Add a link at the tip for the tool of a machine whose URDF has none."""
    SubElement(root, "link", name=_TOOL)
    joint = SubElement(root, "joint", name=f"{_TOOL}_joint", type="fixed")
    SubElement(joint, "parent", link=tip)
    SubElement(joint, "child", link=_TOOL)


def _damping(root: Element, joints: tuple[Joint, Joint], reach: Array, ratio: float) -> tuple[float, float]:
    """Joint damping ``c = 2ζω₀J`` of the physical pendulum about each axis, with ``ω₀² = m·g·d/J``."""
    down = reach / np.linalg.norm(reach)
    every = parsed(root)
    found = []
    for joint in joints:
        axis = joint.axis if joint is joints[1] else joints[1].origin[:3, :3].T @ joint.axis
        inertia = moment = 0.0
        for link in links_below(root, joints[1].parent):
            pose = pose_of(every, link, joints[1].child)
            mass, centre, tensor = inertial_of(link_element(root, link))
            centre = pose[:3, :3] @ centre + pose[:3, 3]
            turned = pose[:3, :3] @ tensor @ pose[:3, :3].T
            inertia += float(axis @ turned @ axis + mass * (centre @ centre - (axis @ centre) ** 2))
            moment += mass * float(centre @ down)
        found.append(2.0 * ratio * float(np.sqrt(max(GRAVITY * moment, 0.0) * inertia)))
    return found[0], found[1]


def _crossed(path: tuple[Joint, ...], movable: list[Joint]) -> bool:
    """Whether the URDF's joints match the equation: two axes that cross at the tip, and the tool at a distance."""
    if len(movable) != 2 or any(joint.prismatic for joint in movable):
        return False
    last = path.index(movable[1])
    to_pivot = np.linalg.norm(offset(path[: last + 1]))
    second_in_first = chained(path[path.index(movable[0]) + 1 : last + 1])[:3, :3] @ movable[1].axis
    parallel = abs(float(movable[0].axis @ second_in_first))
    return bool(to_pivot < 1e-6 and last == 1 and parallel < 0.1 and np.linalg.norm(offset(path[2:])) > 1e-3)


def _insert_joints(root: Element, path: tuple[Joint, ...], length: float) -> None:
    """Replace the chain from tip to tool by two joints about y and x of the tip and a rod."""
    tip, tool = path[0].parent, path[-1].child
    for joint in path:
        root.remove(joint_element(root, joint.name))
    for joint in path[:-1]:
        remove_below(root, joint.child)
        root.remove(link_element(root, joint.child))
    names = ("sway_pitch", "sway_roll", "sway_rod")
    links = (tip, "sway_hook", "sway_hanger", tool)
    kinds, axes = ("continuous", "continuous", "fixed"), ("0 1 0", "1 0 0", "0 0 1")
    for k, (name, kind, axis) in enumerate(zip(names, kinds, axes, strict=True)):
        if k < 2:
            SubElement(root, "link", name=links[k + 1])
        element = SubElement(root, "joint", name=name, type=kind)
        SubElement(element, "parent", link=links[k])
        SubElement(element, "child", link=links[k + 1])
        SubElement(element, "origin", xyz=f"0 0 {-length if k == 2 else 0.0!r}")
        SubElement(element, "axis", xyz=axis)


def _stretch(root: Element, plant: Plant, kinematics: Kinematics) -> None:
    """Apply ``link_length_error`` to the distance from each driven joint to the next, or to the tip."""
    errors = {
        plant.machine.axis(item.target).joint: float(np.asarray(item.parameters["error"]))
        for item in plant.effects
        if item.name == link_length_error.EFFECT.name
    }
    stretch: list[Joint] = []
    after: str | None = None
    for joint in (*kinematics.chain, None):
        if joint is not None:
            stretch.append(joint)
        if joint is None or joint.name in kinematics.drives:
            length = float(np.linalg.norm(offset(stretch)))
            if errors.get(after) and length > 1e-9:
                for part in stretch:
                    scale_origin(joint_element(root, part.name).find("origin"), 1.0 + errors[after] / length)
            stretch, after = [], joint.name if joint is not None else None


def _shift_tip(root: Element, plant: Plant, kinematics: Kinematics) -> None:
    """Apply ``tip_offset`` to the first fixed joint behind the last moving link."""
    known = plant.effect(tip_offset.EFFECT.name, "ee")
    shift = np.asarray(known.parameters["translation"], dtype=np.float64) if known is not None else np.zeros(3)
    if not shift.any():
        return
    last = max(k for k, joint in enumerate(kinematics.chain) if joint.name in kinematics.drives)
    if last + 1 == len(kinematics.chain):
        found = f"tip_offset of {kinematics.tip}, which a joint moves"
        raise SettingsError("PyBullet world", found, "a tip that is fixed to the last moving link")
    joint = joint_element(root, kinematics.chain[last + 1].name)
    origin = joint.find("origin")
    if origin is None:
        origin = SubElement(joint, "origin")
    place = np.array(numbers(origin.get("xyz", "0 0 0"))) + shift
    origin.set("xyz", " ".join(map(repr, place.tolist())))


def _lowest(root: Element, kinematics: Kinematics) -> float:
    """Height of the ground: the lowest point of the first link's shapes, or zero."""
    heights = []
    for visual in link_element(root, kinematics.chain[0].parent if kinematics.chain else kinematics.tip).findall("visual"):
        origin = visual.find("origin")
        z = numbers(origin.get("xyz", "0 0 0"))[2] if origin is not None else 0.0
        box, cylinder = visual.find("geometry/box"), visual.find("geometry/cylinder")
        if box is not None:
            heights.append(z - 0.5 * numbers(box.get("size", ""))[2])
        elif cylinder is not None:
            heights.append(z - 0.5 * float(cylinder.get("length", "0")))
    return min(heights, default=0.0)


#: Initial angles of the upper joint [rad].
_STARTS = np.linspace(-np.pi, np.pi, 4, endpoint=False) + 0.1


def passive_joints(hanging: HangingTool, tip: Array, reach: Array, speed: Array) -> tuple[Array, Array]:
    """Angles and rates of the two passive joints.

    Args:
        tip: orientation of the tip in the world, 3×3.
        reach: horizontal position (x, y) of the tool relative to the tip, world directions [m].
        speed: its rate [m/s].

    Returns:
        Angles [rad] and rates [rad/s], (2,) each.
    """
    length = float(np.linalg.norm(hanging.reach))
    flat = np.asarray(reach, dtype=np.float64)
    size = float(np.linalg.norm(flat))
    if size > 0.99 * length:
        flat = flat * (0.99 * length / size)
    drop = float(np.sqrt(length**2 - flat @ flat))
    goal = np.array([*flat, -drop])
    rate = np.array([*speed, float(flat @ speed) / drop])

    def place(angles: Array) -> Array:
        rotation = tip
        for joint, angle in zip(hanging.joints, angles, strict=True):
            rotation = rotation @ joint.origin[:3, :3] @ rotation_about(joint.axis, np.array([angle]))[0]
        return np.asarray(rotation @ hanging.reach)

    def away(angles: Array) -> Array:
        return np.asarray(place(angles) - goal)

    # Of the two solutions, take the one with the smaller angle of the lower joint.
    trials = [least_squares(away, [start, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15) for start in _STARTS]
    best = min(trials, key=lambda trial: (round(float(np.sqrt(trial.cost)) / length, 6), abs(_wrapped(trial.x[1]))))
    angles = _wrapped(best.x)
    step = 1e-6
    jacobian = np.column_stack([(place(angles + step * e) - place(angles - step * e)) / (2.0 * step) for e in np.eye(2)])
    return angles, np.linalg.lstsq(jacobian, rate, rcond=None)[0]


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
