"""ROS 2 message definitions as text (``ros2msg``), as they stand in an MCAP schema.

Source: ROS 2 documentation, "About interfaces"; the schema of a message is followed by those it contains, each after a line
of ``=`` and ``MSG: package/Name``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from sysid.errors import InputError

#: Primitive type → NumPy code without byte order; strings apart.
PRIMITIVES = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """One member of a message. ``length`` is None for a single value, -1 for a sequence, else the fixed array length."""

    name: str
    kind: str
    length: int | None = None


@dataclass(frozen=True)
class Definition:
    """A message type with all the types that it contains."""

    root: str
    types: Mapping[str, tuple[Field, ...]]


_TIME = (Field("sec", "int32"), Field("nanosec", "uint32"))
_MEMBER = re.compile(
    r"^(?P<kind>[A-Za-z][\w/]*)(?P<bound><=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$"
)


def parse_definition(name: str, text: str, where: object) -> Definition:
    """Parse the schema of message type ``name``.

    Raises:
        InputError: a line that is no member, or a type that is not defined in the schema.
    """
    types: dict[str, tuple[Field, ...]] = {"builtin_interfaces/Time": _TIME, "builtin_interfaces/Duration": _TIME}
    current = _short(name)
    for number, section in enumerate(re.split(r"^={3,}\s*$", text, flags=re.MULTILINE)):
        lines = [line.strip() for line in section.splitlines() if line.strip()]
        if lines and lines[0].startswith("MSG:"):
            current = _short(lines[0][4:].strip())
            lines = lines[1:]
        elif number > 0:
            continue
        types[current] = tuple(_members(lines, current, where))
    root = _short(name)
    for owner, fields in types.items():
        for field in fields:
            if field.kind not in PRIMITIVES and field.kind not in ("string", "wstring") and field.kind not in types:
                raise InputError(f"{where}: schema {name}", f"type {field.kind!r} of {owner}.{field.name} is not defined")
    return Definition(root, types)


def _members(lines: list[str], owner: str, where: object) -> list[Field]:
    members = []
    for line in lines:
        text = line.partition("#")[0].strip()
        if not text:
            continue
        match = _MEMBER.match(text)
        if match is None:
            raise InputError(f"{where}: schema {owner}", f"line {line!r}", "`type name`")
        if match["rest"].startswith("="):
            continue  # a constant takes no room in the message
        array = match["array"]
        length = None if array is None else -1 if array == "[]" or "<" in array else int(array[1:-1])
        members.append(Field(match["name"], _resolve(match["kind"], owner), length))
    return members


def _resolve(kind: str, owner: str) -> str:
    if kind in PRIMITIVES or kind in ("string", "wstring"):
        return kind
    if kind in ("time", "duration"):
        return "builtin_interfaces/Time"
    return _short(kind) if "/" in kind else f"{owner.split('/')[0]}/{kind}"


def _short(name: str) -> str:
    """``package/msg/Name`` and ``package/Name`` are the same type."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"
