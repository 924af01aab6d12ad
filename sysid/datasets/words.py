"""What the words in the name of a topic or column say about its quantity."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: What a word in the name of a column says about its quantity. An operator's stick is not the command of the axis.
WORDS: Mapping[str, frozenset[str]] = {
    "operator": _set("js joy joystick operator pilot"),
    "command": _set(
        "cmd command commands commanded setpoint sp duty pwm reference ref goal target desired des ctrl control action input "
        "valve demand signal"
    ),
    "speed": _set("speed speeds velocity velocities vel qd qdot qvel dq omega rpm tacho gyro"),
    "force": _set("torque torques effort efforts current tau force forces load pressure press"),
    "measured": _set(
        "ms meas measured measurement pos position positions present actual act state angle angles joint joints encoder enc q "
        "qpos theta sensor feedback fb observation reading"
    ),
    "cylinder": _set("cyl cylinder stroke wire wires displacement disp extension length len"),
}
#: Of the words of a command those that name other things as well: a spool, a mode, what a sensor gives.
VAGUE = _set("ctrl control action input valve signal")
#: Of the words of a measurement those that say which position is meant, or only that it is one: a command may have them too.
JOINTS, POSITIONS = _set("joint joints angle angles encoder enc"), _set("pos position positions q qpos theta")
#: Words of a component of a point or a direction, which is not the position of an axis.
GEOMETRY = _set("x y z w pose poses orientation translation rotation twist linear")
#: Words that belong to no axis.
UNITS = _set("deg degs degree degrees rad rads mm cm m s sec nm n percent pct counts raw")


def words_of(text: str) -> list[str]:
    """``/valves/boomCommand[2]`` → valves, boom, command, 2."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [word.lower() for word in re.findall(r"[A-Za-z]+|\d+", spaced)]


def said(words: Iterable[str]) -> frozenset[str]:
    """The quantities that words say."""
    own = {*words}
    return frozenset(quantity for quantity, known in WORDS.items() if known & own)
