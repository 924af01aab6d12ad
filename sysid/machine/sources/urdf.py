"""A machine drafted from a URDF: its chain to the tip, actuation from ``<ros2_control>`` or ``<transmission>``, friction.

Sources: URDF specification (ROS wiki, ``urdf/XML/joint``, ``urdf/XML/Transmission``); ros2_control, *Hardware components*.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element, tostring

from sysid.errors import SettingsError, UnknownDriveError, nearest
from sysid.foreign import shown
from sysid.machine.description import Actuation, KnownEffect
from sysid.machine.kinematics import Joint, Kinematics, parse_urdf
from sysid.machine.moved_bodies import has_masses
from sysid.machine.sources.draft import (
    ACTUATIONS,
    AxisDraft,
    ChainChoice,
    MachineDraft,
    axis_names,
    draft_of,
    limit_notes,
    stops,
    summarised,
)
from sysid.machine.urdf_tree import (
    GROUND,
    MOVING,
    followed,
    indefinite_links,
    invalid_shapes,
    is_bare_ground,
    repeated,
    resolved,
    urdf_tree,
    xml_root,
)
from sysid.names import listed
from sysid.numbers import NonNegative, number

#: Name of a ROS command interface → actuation.
INTERFACES: Mapping[str, Actuation] = {"position": "position", "velocity": "velocity", "effort": "force"}


def urdf_draft(
    text: str, source: str, tip: str | None = None, kind: str | None = None, tool: str | None = None, base: str | None = None
) -> MachineDraft:
    """The machine that a URDF describes.

    Args:
        tip: link of the end effector; else the end of the longest chain.
        kind: how all joints are commanded, of :data:`~sysid.machine.sources.draft.KINDS`; else what the URDF states for each.
        base: link that is held still: joints in front of it are fixed at zero.

    Raises:
        SettingsError: not a URDF, several chains, no actuation stated, or what ``machine.toml`` cannot express.
    """
    whole, described = text, urdf_tree(text)
    if base is not None:
        text = _held(described, base, source)
    tree = _Tree(text, source)
    ends = [tree.choice(tip)] if tip is not None else [tree.choice(end) for end in tree.ends]
    if tip is not None and not ends[0].joints:
        raise SettingsError(source, f"no joint moves {shown(tip)}", f"a tip among {', '.join(tree.ends)}")

    def draft(choice: ChainChoice, its_kind: str | None) -> MachineDraft:
        own = text if choice.base is None else _held(urdf_tree(text), choice.base, source)
        return _draft(own, source, choice, its_kind, tool)

    made = draft_of(ends, draft, tree.choice, source, kind)
    written = xml_root(whole)
    unread = [(f"repeated <{element.tag}>, of which the first counts, in", _named(part)) for part, element in repeated(written)]
    unread += [("shapes without an extent of", link.get("name", "")) for link, _ in invalid_shapes(written)]
    ground = (f"link {GROUND}, which the URDF does not describe: the ground",) if is_bare_ground(written) else ()
    return replace(made, left_out=(*made.left_out, *summarised(unread)), assumed=(*made.assumed, *ground))


def _named(part: Element) -> str:
    return part.get("name") or f"<{part.tag}>"


class _Tree:
    """Links and joints of a URDF, and the chains in them."""

    def __init__(self, text: str, source: str) -> None:
        self.joints, _ = parse_urdf(text)
        self.source = source
        self.by_child = {joint.child: joint for joint in self.joints.values()}
        self.mimics = {name: joint.mimic for name, joint in self.joints.items()}
        self.links = {*self.by_child, *(joint.parent for joint in self.joints.values())}

    @property
    def ends(self) -> list[str]:
        """Links that carry no other link."""
        return sorted(self.links - {joint.parent for joint in self.joints.values()})

    def choice(self, end: str) -> ChainChoice:
        """The chain to a link, behind the last joint on it that no axis can move."""
        if end not in self.links:
            raise SettingsError(f"{self.source}: tip", f"unknown link {shown(end)}", nearest(end, self.links))
        path, joints = [end], list[Joint]()
        while path[-1] in self.by_child:
            joints.append(self.by_child[path[-1]])
            path.append(joints[-1].parent)
        path, joints = path[::-1], joints[::-1]
        blocked = max((k for k, joint in enumerate(joints) if joint.kind not in (*MOVING, "fixed")), default=-1)
        driven = [resolved(joint.name, self.mimics).master for joint in joints[blocked + 1 :] if joint.kind != "fixed"]
        held = joints[blocked] if blocked >= 0 else None
        return ChainChoice(
            tuple(dict.fromkeys(driven)),
            tuple(path),
            end,
            None if held is None else held.child,
            "" if held is None else f"joint {shown(held.name)} is {held.kind}",
        )


def _held(root: Element, base: str, source: str) -> str:
    """A URDF whose joints in front of a link are fixed at zero."""
    by_child = {str(part.get("link")): joint for joint in root.findall("joint") for part in joint.findall("child")}
    if base not in (links := [str(link.get("name")) for link in root.findall("link")]):
        raise SettingsError(f"{source}: base", f"unknown link {shown(base)}", nearest(base, links))
    while base in by_child:
        by_child[base].set("type", "fixed")
        base = next(str(part.get("link")) for part in by_child[base].findall("parent"))
    return tostring(root, encoding="unicode")


def _draft(text: str, source: str, choice: ChainChoice, kind: str | None, tool: str | None) -> MachineDraft:
    root, tip = urdf_tree(text), choice.tip
    joints, _ = parse_urdf(text)
    kinematics = Kinematics.from_urdf(text, choice.joints, tip, tool)
    elements = {element.get("name", ""): element for element in root.findall("joint")}
    stated, names = _stated(root), axis_names(choice.joints)
    actuations = [ACTUATIONS[kind] if kind is not None else _actuation(name, stated, source) for name in choice.joints]
    _check_ranges([joints[name] for name in choice.joints])
    axes, beyond = list[AxisDraft](), list[tuple[str, str]]()
    for name, actuation in zip(choice.joints, actuations, strict=True):
        axis, missing = _axis(names[name], joints[name], elements[name], actuation)
        axes.append(axis)
        beyond += missing
    mimics = {name: joint.mimic for name, joint in joints.items()}
    for name, joint in sorted(joints.items()):
        if joint.kind != "fixed" and joint.mimic is None and name not in choice.joints:
            beyond.append((f"joints beside the chain to {tip}, which rest at zero:", name))
        elif joint.mimic is not None and followed(name, mimics) is None:
            beyond.append(("mimic of a joint that does not exist:", f"{name} ({joint.mimic.master})"))
    if any(axis.actuation == "force" for axis in axes) and not has_masses(kinematics):
        raise SettingsError(source, "force axes, and no masses", "<inertial> of the moved links", "Or use --kind servo.")
    if not any(axis.actuation == "force" for axis in axes):
        beyond += [("inertia with a negative principal moment, which no body has, of", link) for link in indefinite_links(text)]
    assumed = tuple(line for axis in axes for line in axis.assumed)
    return MachineDraft(source, tuple(axes), text, tip, tool, tuple(summarised(beyond)), assumed)


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
        raise UnknownDriveError(f"{source}: joint {shown(joint)}", found, "one command interface a joint")
    return INTERFACES[names[0]]


def _check_ranges(joints: Sequence[Joint]) -> None:
    """Raise SettingsError where the ends of a range are not in order, with all joints of one mistake."""
    for swapped in (True, False):
        wrong = [j for j in joints if (j.limits[0] > j.limits[1] if swapped else j.limits[0] == j.limits[1])]
        if not wrong:
            continue
        one, names = len(wrong) == 1, listed([shown(joint.name) for joint in wrong])
        where, its = f"urdf: joint{'' if one else 's'} {names}: limit", "its" if one else "their"
        if swapped:
            ends = ", ".join(f"[{joint.limits[0]:g}, {joint.limits[1]:g}]" for joint in wrong)
            raise SettingsError(where, ends, "lower below upper", "Swap lower and upper.")
        kind = f"{its} type to fixed" if wrong[0].prismatic else f"{its} type to continuous, which has no end stops"
        found = f"lower and upper are {', '.join(f'{joint.limits[0]:g}' for joint in wrong)}"
        raise SettingsError(where, found, "lower below upper", f"Change {kind}, or state lower and upper.")


def _axis(name: str, joint: Joint, element: Element, actuation: Actuation) -> tuple[AxisDraft, list[tuple[str, str]]]:
    where = f"urdf: joint {shown(joint.name)}"
    keys = ("limit.velocity", "limit.effort", "dynamics.damping", "dynamics.friction")
    values = {key: _attribute(element, key, where) for key in keys}
    unit, gain = ("N", "m/s") if joint.prismatic else ("N·m", "rad/s"), 1.0
    notes = limit_notes(joint.name, ("force", values["limit.effort"], unit[0]))
    if actuation == "velocity":
        gain = values["limit.velocity"]
        if gain <= 0.0:
            remedy = f'Write <limit velocity="…"/> of {joint.name}, or use --kind servo.'
            raise SettingsError(f"{where}: limit", "no velocity", f"the speed at full command [{unit[1]}]", remedy)
    else:
        notes += limit_notes(joint.name, ("speed", values["limit.velocity"], unit[1]))
    effects = []
    friction = (("viscous_friction", "coefficient", "dynamics.damping"), ("coulomb_friction", "force", "dynamics.friction"))
    for effect, parameter, key in friction:
        if values[key] > 0.0 and actuation == "force":
            effects.append(KnownEffect(effect, name, {parameter: values[key]}))
        elif values[key] > 0.0:
            notes.append((f"{key.rpartition('.')[2]} inside the control loop of", joint.name))
    limits, assumed = stops(name, *joint.limits, joint.prismatic)
    about = f"{joint.kind} joint of the URDF"
    return AxisDraft(name, joint.name, actuation, about, gain, None, limits, tuple(effects), assumed), notes


def _attribute(element: Element, place: str, where: str) -> float:
    """The number at ``tag.attribute``; zero without one."""
    tag, _, key = place.partition(".")
    part = element.find(tag)
    text = None if part is None else part.get(key)
    return 0.0 if text is None else number(text, NonNegative, f"{where}: {tag}: {key}")
