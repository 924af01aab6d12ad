"""ROS message definitions as stored in a bag (``ros2msg``, ROS 1, or ``ros2idl``).

Source: ROS 2 documentation, "About interfaces"; the schema of a message is followed by those it contains, each after a line
of ``=`` and ``MSG: package/Name``. The ``rosbags`` library translates IDL to this form.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from sysid.errors import InputError
from sysid.logs.labels import are_names, identifying

#: Primitive type → NumPy code without byte order; strings apart.
PRIMITIVES = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
#: Types of text.
TEXTS = ("string", "wstring")


@dataclass(frozen=True)
class Field:
    """One member of a message. ``length`` is None for a single value, -1 for a sequence, else the fixed array length."""

    name: str
    kind: str
    length: int | None = None


@dataclass(frozen=True)
class Definition:
    """A message type with all types that it contains."""

    root: str
    types: Mapping[str, tuple[Field, ...]]
    _sizes: dict[tuple[str, int | None], int | None] = field(default_factory=dict, compare=False, repr=False)

    def stamp_fields(self) -> frozenset[str]:
        """The two fields of the stamp of a message of this type; empty where it has none."""
        for prefix in (("header", "stamp"), ("stamp",), ("timestamp",)):
            kind: str | None = self.root
            for name in prefix:
                kind = next((f.kind for f in self.types.get(kind or "", ()) if f.name == name and f.length is None), None)
            if kind == "builtin_interfaces/Time":
                path = ".".join(prefix)
                return frozenset({f"{path}.sec", f"{path}.nanosec"})
        return frozenset()

    def identity(self, kind: str) -> str | None:
        """The text of a ``kind`` that identifies it within an array; None where there is none."""
        return identifying(tuple(m.name for m in self.types[kind] if m.length is None and m.kind in TEXTS))

    def has_series(self, kind: str) -> bool:
        """Whether a ``kind`` contains sequences without names of their own, as the point of a trajectory."""
        sequences = [member for member in self.types[kind] if member.length == -1]
        return bool(sequences) and not any(member.kind in TEXTS and are_names(member.name) for member in sequences)

    @property
    def has_wide_texts(self) -> bool:
        """Whether any message in it contains a ``wstring``."""
        return any(member.kind == "wstring" for members in self.types.values() for member in members)

    def fixed_size(self, kind: str, phase: int | None) -> int | None:
        """Size of a ``kind`` [bytes], None where it is not fixed.

        In CDR it depends on the start: ``phase`` (0 to 7) behind a multiple of eight; None: without padding (ROS 1).
        """
        key = (kind, phase)
        if key not in self._sizes:
            self._sizes[key] = self._measure(kind, phase)
        return self._sizes[key]

    def _measure(self, kind: str, phase: int | None) -> int | None:
        position = phase or 0
        for member in self.types[kind]:
            if member.length == -1 or member.kind in TEXTS:
                return None
            if member.kind in PRIMITIVES:
                size = int(PRIMITIVES[member.kind][1])
                count = 1 if member.length is None else member.length
                padding = 0 if phase is None or not count else -position % size
                position += padding + count * size
                continue
            for _ in range(min(1 if member.length is None else member.length, 64)):
                size_of_member = self.fixed_size(member.kind, None if phase is None else position % 8)
                if size_of_member is None or (member.length or 0) > 64:
                    return None
                position += size_of_member
        return position - (phase or 0) or None


#: Times and durations in ROS 2 and ROS 1.
_TIME = (Field("sec", "int32"), Field("nanosec", "uint32"))
_ROS1_TIME = (Field("sec", "uint32"), Field("nanosec", "uint32"))
_ROS1_DURATION = (Field("sec", "int32"), Field("nanosec", "int32"))
_MEMBER = re.compile(
    r"^(?P<kind>[A-Za-z][\w/]*)(?P<bound><=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$"
)


def parse_definition(name: str, text: str, where: object, ros1: bool = False) -> Definition:
    """Parse the schema of message type ``name``; in ROS 1 a ``byte`` is signed.

    Raises:
        InputError: a line that is no member, or a type that is not defined in the schema.
    """
    times = (_ROS1_TIME, _ROS1_DURATION) if ros1 else (_TIME, _TIME)
    types: dict[str, tuple[Field, ...]] = dict(
        zip(("builtin_interfaces/Time", "builtin_interfaces/Duration"), times, strict=True)
    )
    current = _short(name)
    for number, section in enumerate(re.split(r"^={3,}\s*$", text, flags=re.MULTILINE)):
        lines = [line.strip() for line in section.splitlines() if line.strip()]
        if lines and lines[0].startswith("MSG:"):
            current = _short(lines[0][4:].strip())
            lines = lines[1:]
        elif number > 0:
            continue
        types[current] = tuple(_members(lines, current, where, ros1))
    root = _short(name)
    if root not in types:
        raise InputError(
            f"{where}: schema {name}", "does not define that type", "its members first, then the types it contains"
        )
    for owner, fields in types.items():
        for member in fields:
            if member.kind not in PRIMITIVES and member.kind not in TEXTS and member.kind not in types:
                raise InputError(f"{where}: schema {name}", f"type {member.kind!r} of {owner}.{member.name} is not defined")
    _check_depth(root, types, (), f"{where}: schema {name}", {})
    return Definition(root, types)


def parse_idl(name: str, text: str, where: object) -> Definition:
    """Parse a schema of message type ``name`` in IDL (``ros2idl``).

    Raises:
        InputError: the text is no IDL, or does not define the type.
    """
    from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_typestore

    store = get_typestore(Stores.EMPTY)
    place = f"{where}: schema {name}"
    try:
        for part in re.split(r"^={3,}\s*$", text, flags=re.MULTILINE):
            body = re.sub(r"\A\s*IDL:[^\n]*\n", "", part)
            if body.strip():
                store.register(get_types_from_idl(body))
        message, _ = store.generate_msgdef(name, ros_version=2)
    except (TypesysError, KeyError, RecursionError, ValueError) as error:
        raise InputError(place, f"IDL that cannot be read ({error})", "a definition as ROS 2 writes it") from None
    return parse_definition(name, message, where)


#: Levels of nested messages.
MAX_DEPTH = 20


def _check_depth(
    kind: str, types: Mapping[str, tuple[Field, ...]], above: tuple[str, ...], where: str, known: dict[str, int]
) -> int:
    """Levels of messages below ``kind``; raises where a type contains itself or the levels are too many."""
    if kind in above or len(above) > MAX_DEPTH:
        raise InputError(where, f"type {kind!r} contains itself or is too deep", f"at most {MAX_DEPTH} levels of messages")
    if kind not in known:
        inner = {member.kind for member in types.get(kind, ()) if member.kind in types}
        known[kind] = 1 + max((_check_depth(k, types, (*above, kind), where, known) for k in sorted(inner)), default=0)
    if len(above) + known[kind] > MAX_DEPTH:
        raise InputError(where, f"type {kind!r} is nested too deep", f"at most {MAX_DEPTH} levels of messages")
    return known[kind]


def _members(lines: list[str], owner: str, where: object, ros1: bool) -> list[Field]:
    members = []
    for line in lines:
        text = line.partition("#")[0].strip()
        if not text:
            continue
        match = _MEMBER.match(text)
        if match is None:
            raise InputError(f"{where}: schema {owner}", f"line {line!r}", "`type name`")
        if match["rest"].startswith("="):
            continue  # a constant is not serialised
        array = match["array"]
        if array is not None and len(array) > 12:
            raise InputError(f"{where}: schema {owner}", f"line {line[:80]!r}", "an array of fewer than 10 billion elements")
        length = None if array is None else -1 if array == "[]" or "<" in array else int(array[1:-1])
        kind = "int8" if ros1 and match["kind"] == "byte" else _resolve(match["kind"], owner)
        members.append(Field(match["name"], kind, length))
    return members


def _resolve(kind: str, owner: str) -> str:
    if kind in PRIMITIVES or kind in TEXTS:
        return kind
    if kind in ("time", "duration"):
        return f"builtin_interfaces/{kind.title()}"
    if kind == "Header":
        return "std_msgs/Header"  # ROS 1 omits its package
    return _short(kind) if "/" in kind else f"{owner.split('/')[0]}/{kind}"


def _short(name: str) -> str:
    """``package/msg/Name`` and ``package/Name`` are the same type."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"
