"""What the words in the name of a topic or column say: its quantity, and with a machine its signal."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping

from sysid.logs.lerobot import KIND
from sysid.machine import Axis, Machine


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: What a word in the name of a column says about its quantity. An operator's stick is not the command of the axis.
WORDS: Mapping[str, frozenset[str]] = {
    "operator": _set("js joy joystick operator pilot handhebel"),
    "command": _set(
        "cmd command commands commanded setpoint sp duty pwm reference ref goal target desired des ctrl control action input "
        "valve spool dac demand signal soll sollwert sollwinkel sollweg sollposition solllage vorgabe ventil stellwert "
        "stellgröße stellgroesse stellsignal"
    ),
    "speed": _set("speed speeds velocity velocities vel qd qdot qvel dq omega rpm tacho gyro geschwindigkeit drehzahl"),
    "force": _set(
        "torque torques effort efforts current tau force forces load pressure press kraft moment drehmoment strom druck"
    ),
    "measured": _set(
        "ms meas measured measurement pos position positions present actual act state angle angles joint joints encoder enc q "
        "qpos theta sensor feedback fb observation reading ist istwert istwinkel istweg istposition istlage messwert winkel "
        "gelenk lage"
    ),
    "cylinder": _set(
        "cyl cylinder stroke wire wires displacement disp extension length len zylinder kolben zylinderweg kolbenweg "
        "seilzug weg"
    ),
}
#: Words that say that a place is an angle, and a length; names of axes that rotate, and that slide.
ANGLES = _set(
    "angle angles deg degs degree degrees rad rads theta winkel istwinkel sollwinkel torque torques moment drehmoment "
    "slew slewing swing swivel rotate rotation turntable yaw pan pitch roll shoulder elbow wrist hip knee ankle "
    "drehwerk schwenk schwenkwerk schulter ellbogen handgelenk"
)
STRAIGHT = WORDS["cylinder"] | _set(
    "mm cm distance travel slide slider telescope teleskop rail carriage gantry linear schlitten kraft"
)
#: Of the words of a command those that name other things as well: a spool, a mode, what a sensor gives.
_VAGUE = _set("ctrl control action input valve spool dac signal ventil")
#: Of the words of a measurement those that say which position is meant, or only that it is one: a command may have them too.
_JOINTS = _set("joint joints angle angles encoder enc winkel gelenk istwinkel")
_POSITIONS = _set("pos position positions q qpos theta lage")
#: Words of a component of a point or a direction, which is not the position of an axis.
_GEOMETRY = _set("x y z w pose poses orientation translation rotation twist linear")
#: Words that belong to no axis.
UNITS = _set("deg degs degree degrees rad rads turn turns mm cm m s sec us v bar nm n percent pct counts ticks raw")
#: Fields that change but are no signals.
NO_SIGNAL = re.compile(r"covariance|(^|\.)stamp\.(sec|nanosec|nsec|secs|nsecs)$|^((frame|episode|task)_)?index$")
#: Which array of a ``JointState`` commands an axis, by its actuation.
_COMMANDED = {"velocity": "velocity", "position": "position", "servo": "position", "force": "effort"}


def words_of(text: str) -> list[str]:
    """``/valves/boomCommand[2]`` → valves, boom, command, 2; letters of any alphabet, composed."""
    spaced = re.sub(r"(?<=[a-zß-öø-ÿ])(?=[A-ZÀ-ÖØ-Þ])", " ", unicodedata.normalize("NFC", text))
    return [word.lower() for word in re.findall(r"[^\W\d_]+|\d+", spaced)]


def words_without_numbers(text: str) -> set[str]:
    """Its words but for numbers."""
    return {word for word in words_of(text) if not word.isdecimal()}


def said(words: Iterable[str]) -> frozenset[str]:
    """The quantities that words say."""
    own = {*words}
    return frozenset(quantity for quantity, known in WORDS.items() if known & own)


def says_command(topic: str, field: str) -> bool:
    """Whether any word is that of a command."""
    return "command" in said(words_of(f"{topic} {field}"))


def signal_of(topic: str, field: str, machine: Machine | None, kind: str) -> tuple[str, bool]:
    """The likely signal of a field, and whether both axis and quantity were found in its name."""
    words = words_without_numbers(f"{topic} {field}")
    axes: list[Axis] = (
        [axis for axis in machine.axes if words_without_numbers(axis.name) <= words] if machine is not None else []
    )
    axis = axes[0] if len(axes) == 1 else None
    beside = words - words_without_numbers(axis.name) if axis is not None else words
    words = beside if said(beside) else words  # an axis may be called a valve
    if kind == KIND:
        quantity = "command" if field.startswith("action") else "joint" if field.startswith("observation.state") else ""
    elif kind.endswith("JointState") and field.partition("[")[0] in ("position", "velocity", "effort"):
        quantity = _of_joint_state(words_without_numbers(topic), field.partition("[")[0], axis)
    else:
        quantity = _said_quantity(words, axis)
    name = axis.name if axis is not None else "<axis>"
    return f"{name}.{quantity or '<command, cylinder, joint or speed>'}", axis is not None and bool(quantity)


def _of_joint_state(words: set[str], array: str, axis: Axis | None) -> str:
    """The quantity of an array of a ``JointState``, whose name says what it is, whatever words the names of joints have."""
    quantities = said(words)
    if "command" in quantities and words & WORDS["command"] - _VAGUE:
        return "command" if axis is None or _COMMANDED[axis.actuation] == array else ""
    if array == "position":
        return "cylinder" if "cylinder" in quantities and not _slides(axis) else "joint"
    return "speed" if array == "velocity" and not _of_other_end(words, axis) else ""


def _said_quantity(words: set[str], axis: Axis | None) -> str:
    """The quantity that the words of a topic and field say; empty where they say none, or two."""
    quantities = said(words)
    if "operator" in quantities:
        return ""
    if "command" in quantities:
        measured = words & WORDS["measured"] - _JOINTS - _POSITIONS
        rate = "speed" in quantities and axis is not None and axis.actuation != "velocity"
        force = "force" in quantities and (axis is None or axis.actuation != "force")
        return "command" if words & WORDS["command"] - _VAGUE and not (measured or rate or force) else ""
    if "force" in quantities:
        return ""
    if "speed" in quantities:
        return "" if _of_other_end(words, axis) else "speed"
    if "cylinder" in quantities and not _slides(axis):
        return "cylinder" if not words & _JOINTS else axis.drives if axis is not None else ""
    if words & _JOINTS or "cylinder" in quantities:
        return "joint"
    return axis.drives if "measured" in quantities and axis is not None and not words & _GEOMETRY else ""


def _slides(axis: Axis | None) -> bool:
    """Whether a wire sensor lies along the joint of an axis, which has no cylinder."""
    return axis is not None and axis.drives == "joint" and axis.stroke is None


def _of_other_end(words: set[str], axis: Axis | None) -> bool:
    """Whether a rate is that of the joint of an axis with a cylinder, or the reverse: only that of what the command drives is a
    signal.
    """
    of = {"joint" if words & _JOINTS else "", "cylinder" if "cylinder" in said(words) else ""} - {""}
    return axis is not None and bool(of) and axis.drives not in of
