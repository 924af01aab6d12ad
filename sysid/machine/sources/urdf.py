"""A machine drafted from a URDF: its chain to the tip, actuation from ``<ros2_control>`` or ``<transmission>``, friction.

Sources: URDF specification (ROS wiki, ``urdf/XML/joint``, ``urdf/XML/Transmission``); ros2_control, *Hardware components*.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.machine.description import Actuation, KnownEffect
from sysid.machine.kinematics import Joint, Kinematics, parse_urdf
from sysid.machine.mimic import resolved
from sysid.machine.moved_bodies import has_masses
from sysid.machine.sources.draft import WITHOUT_STOPS, AxisDraft, MachineDraft, axis_names, choose_tip, summarised
from sysid.machine.urdf_tree import urdf_tree
from sysid.numbers import NonNegative, number

#: Name of a ROS command interface → actuation.
INTERFACES: Mapping[str, Actuation] = {"position": "position", "velocity": "velocity", "effort": "force"}


def urdf_draft(
    text: str, source: str, tip: str | None = None, actuation: Actuation | None = None, tool: str | None = None
) -> MachineDraft:
    """The machine that a URDF describes.

    Args:
        tip: link of the end effector; else the end of the longest chain.
        actuation: of all axes; else what the URDF states for each joint.

    Raises:
        SettingsError: not a URDF, several chains, no actuation stated, or one that ``machine.toml`` lacks.
    """
    root = urdf_tree(text)
    joints, _ = parse_urdf(text)
    moving = {name: joint for name, joint in joints.items() if joint.kind != "fixed" and joint.mimic is None}
    tip = _tip(joints, source) if tip is None else tip
    driven = _driven(joints, tip, source)
    if not driven:
        raise SettingsError(source, f"no joint moves {shown(tip)}", f"a tip among {', '.join(sorted(_ends(joints)))}")
    kinematics = Kinematics.from_urdf(text, driven, tip, tool)
    elements = {element.get("name", ""): element for element in root.findall("joint")}
    stated, names = _stated(root), axis_names(driven, source)
    axes, beyond = list[AxisDraft](), list[tuple[str, str]]()
    for name in driven:
        kind = actuation if actuation is not None else _actuation(name, stated, source)
        axis, missing = _axis(names[name], joints[name], elements[name], kind)
        axes.append(axis)
        beyond += missing
    beyond += [(f"joints beside the chain to {tip}:", joint) for joint in sorted(set(moving) - set(driven))]
    if any(axis.actuation == "force" for axis in axes) and not has_masses(kinematics):
        raise SettingsError(source, "force axes, and no masses", "<inertial> of the moved links", "Or use --kind servo.")
    return MachineDraft(source, tuple(axes), text, tip, tool, tuple(summarised(beyond)))


def _ends(joints: Mapping[str, Joint]) -> set[str]:
    return {joint.child for joint in joints.values()} - {joint.parent for joint in joints.values()}


def _driven(joints: Mapping[str, Joint], link: str, source: str) -> tuple[str, ...]:
    """Joints that move ``link`` themselves or through passive joints, from the base."""
    by_child = {joint.child: joint for joint in joints.values()}
    mimics = {name: joint.mimic for name, joint in joints.items()}
    links = {*by_child, *(joint.parent for joint in joints.values())}
    if link not in links:
        raise SettingsError(f"{source}: tip", f"unknown link {shown(link)}", nearest(link, links))
    found: list[str] = []
    while link in by_child:
        joint = by_child[link]
        if joint.kind != "fixed":
            found.append(resolved(joint.name, mimics).master)
        link = joint.parent
    return tuple(dict.fromkeys(reversed(found)))


def _tip(joints: Mapping[str, Joint], source: str) -> str:
    """The end of the longest chain; where it branches behind its last joint, the last link before that."""
    moved = {end: _driven(joints, end, source) for end in sorted(_ends(joints))}
    chosen = choose_tip(moved, source)
    ends = [end for end, chain in moved.items() if chain == chosen]
    if len(ends) == 1:
        return ends[0]
    by_child = {joint.child: joint for joint in joints.values()}
    paths = []
    for end in ends:
        path = [end]
        while path[-1] in by_child:
            path.append(by_child[path[-1]].parent)
        paths.append(path[::-1])
    common: list[str] = [links[0] for links in zip(*paths, strict=False) if len({*links}) == 1]
    return common[-1]


def _stated(root: Element) -> dict[str, set[str]]:
    """Joint → its command interfaces: position, velocity, effort."""
    found: dict[str, set[str]] = {}
    for joint in root.findall("ros2_control/joint"):
        names = {part.get("name", "") for part in joint.findall("command_interface")}
        found.setdefault(joint.get("name", ""), set()).update(names & INTERFACES.keys())
    for joint in root.findall("transmission/joint"):
        words = [(part.text or "").rpartition("/")[2].lower() for part in joint.findall("hardwareInterface")]
        names = {name for name in INTERFACES for word in words if word.startswith(name)}
        found.setdefault(joint.get("name", ""), set()).update(names)
    return found


def _actuation(joint: str, stated: Mapping[str, set[str]], source: str) -> Actuation:
    names = sorted(stated.get(joint, ()))
    if len(names) != 1:
        found = f"{' and '.join(names)} commands" if names else "no <ros2_control> or <transmission> states how it is commanded"
        remedy = "Add --kind servo (positions), velocity or force for all axes."
        raise SettingsError(f"{source}: joint {shown(joint)}", found, "one command interface a joint", remedy)
    return INTERFACES[names[0]]


def _axis(name: str, joint: Joint, element: Element, actuation: Actuation) -> tuple[AxisDraft, list[tuple[str, str]]]:
    where, notes = f"urdf: joint {shown(joint.name)}", list[tuple[str, str]]()
    values = {key: _attribute(element, key, where) for key in ("limit.velocity", "dynamics.damping", "dynamics.friction")}
    gain = 1.0
    if actuation == "velocity":
        gain = values["limit.velocity"]
        if gain <= 0.0:
            raise SettingsError(f"{where}: limit", "no velocity", "the speed at full command [rad/s or m/s]")
    effects = []
    friction = (("viscous_friction", "coefficient", "dynamics.damping"), ("coulomb_friction", "force", "dynamics.friction"))
    for effect, parameter, key in friction:
        if values[key] > 0.0 and actuation == "force":
            effects.append(KnownEffect(effect, name, {parameter: values[key]}))
        elif values[key] > 0.0:
            notes.append((f"{key.rpartition('.')[2]} inside the control loop of", joint.name))
    limits = None
    if not all(math.isfinite(end) for end in joint.limits):
        most = WITHOUT_STOPS["prismatic" if joint.prismatic else "revolute"]
        limits = (-most, most)
    about = f"{joint.kind} joint of the URDF"
    return AxisDraft(name, joint.name, actuation, about, gain, None, limits, tuple(effects)), notes


def _attribute(element: Element, place: str, where: str) -> float:
    """The number at ``tag.attribute``; zero without one."""
    tag, _, key = place.partition(".")
    part = element.find(tag)
    text = None if part is None else part.get(key)
    return 0.0 if text is None else number(text, NonNegative, f"{where}: {tag}: {key}")
