"""Messages of equal length that do not share a layout: whatever changes from one message to the next, nothing is misread.

Definitions, values and sequences of messages are drawn; the messages are encoded here, and columns are compared row by row with
the values that went in, and with the slow decoder of mcap-ros2-support.
"""

from __future__ import annotations

import random
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from test_mcap_reader import flatten

from sysid.logs.messages import ColumnDecoder
from sysid.logs.rosmsg import Field, parse_definition

FORMATS = {
    "bool": "?", "uint8": "B", "int8": "b", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
NAMES = ["aa", "bb", "cc", "d", "7", ""]

Types = dict[str, list[Field]]
Message = dict[str, Any]


@st.composite
def definitions(draw: st.DrawFn) -> Types:
    """Up to three types, each made of primitives, strings, arrays, sequences, names, and the types before it."""
    types: Types = {}
    for number in range(draw(st.integers(1, 3))):
        kinds = st.sampled_from([*FORMATS, "string", *types, *types])
        lengths = st.sampled_from([None, None, -1, -1, 1, 3])
        members = [Field(f"f{i}", draw(kinds), draw(lengths)) for i in range(draw(st.integers(1, 4)))]
        if draw(st.booleans()):  # what a joint state looks like: names, and sequences of one kind that may trade elements
            names = [Field("name", "string", -1), *(Field(f, "float64", -1) for f in ("position", "velocity"))]
            at = draw(st.integers(0, len(members)))
            members[at:at] = draw(st.permutations(names))
        elif draw(st.booleans()):  # what a transform looks like: a text that identifies it
            members.insert(draw(st.integers(0, len(members))), Field("child_frame_id", "string"))
        types[f"p/T{number}"] = members
    return types


def text_of(types: Types) -> tuple[str, str]:
    """Name and ``ros2msg`` text of the last type."""
    arrays = {None: "", -1: "[]"}
    sections = {
        name: "\n".join(f"{m.kind}{arrays.get(m.length, f'[{m.length}]')} {m.name}" for m in members)
        for name, members in types.items()
    }
    root = list(types)[-1]
    parts = [sections.pop(root), *(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in sections.items())]
    return root, "\n".join(parts)


def drawn(kind: str, types: Types, rng: random.Random) -> Any:
    if kind in types:
        return {m.name: drawn_member(m, types, rng) for m in types[kind]}
    if kind == "string":
        return rng.choice(NAMES)
    if kind in ("float32", "float64"):
        return float(rng.randint(-99, 99)) / 8.0
    return bool(rng.getrandbits(1)) if kind == "bool" else rng.randint(0, 99)


def drawn_member(member: Field, types: Types, rng: random.Random) -> Any:
    if member.length is None:
        return drawn(member.kind, types, rng)
    count = rng.randint(0, 3) if member.length < 0 else member.length
    if member.name == "name":
        return rng.sample(NAMES, count)
    return [drawn(member.kind, types, rng) for _ in range(count)]


def nodes(kind: str, value: Message, types: Types) -> list[tuple[list[Field], Message]]:
    """The message and every message inside of it, with their members."""
    found = [(types[kind], value)]
    for member in types[kind]:
        if member.kind in types:
            inner = value[member.name]
            for item in inner if isinstance(inner, list) else [inner]:
                found += nodes(member.kind, item, types)
    return found


def altered(kind: str, value: Message, types: Types, rng: random.Random) -> Message:
    """A copy with one thing changed: mostly one that keeps the length of the message."""
    value = copied(value)
    members, node = rng.choice(nodes(kind, value, types))
    sequences = [m for m in members if m.length == -1]
    match rng.choice(("values", "names", "move", "empty", "other")):
        case "values":
            for member in members:
                if member.kind in FORMATS:
                    old = node[member.name]
                    count = len(old) if isinstance(old, list) else None
                    fresh = [drawn(member.kind, types, rng) for _ in range(count or 1)]
                    node[member.name] = fresh[0] if count is None else fresh[:count]
        case "names" if "name" in node:
            rng.shuffle(node["name"])
        case "move" if len(sequences) > 1:
            giver, taker = rng.sample(sequences, 2)
            if giver.kind == taker.kind and node[giver.name]:
                node[taker.name].append(node[giver.name].pop())
        case "empty" if sequences:
            node[rng.choice(sequences).name] = []
        case "other":
            member = rng.choice(members)
            node[member.name] = drawn_member(member, types, rng)
    return value


def copied(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: copied(inner) for name, inner in value.items()}
    return [copied(inner) for inner in value] if isinstance(value, list) else value


@dataclass
class Encoder:
    """CDR in either byte order, or packed as ROS 1 writes it."""

    types: Types
    order: str
    packed: bool
    data: bytearray = field(default_factory=bytearray)

    def whole(self, kind: str, value: Message) -> bytes:
        self.message(kind, value)
        head = b"" if self.packed else (b"\0\1\0\0" if self.order == "<" else b"\0\0\0\0")
        return head + bytes(self.data)

    def number(self, code: str, value: Any) -> None:
        if not self.packed:
            self.data += bytes(-len(self.data) % struct.calcsize(code))
        self.data += struct.pack(self.order + code, value)

    def value(self, kind: str, value: Any) -> None:
        if kind in self.types:
            self.message(kind, value)
        elif kind == "string":
            text = value.encode() + (b"" if self.packed else b"\0")
            self.number("I", len(text))
            self.data += text
        else:
            self.number(FORMATS[kind], value)

    def message(self, kind: str, value: Message) -> None:
        for member in self.types[kind]:
            inner = value[member.name]
            if member.length is None:
                self.value(member.kind, inner)
                continue
            if member.length < 0:
                self.number("I", len(inner))
            for item in inner:
                self.value(member.kind, item)


def truth(kind: str, value: Message, types: Types, prefix: str = "", labelled: str = "") -> dict[str, float]:
    """Path → number, by place and by label: of the names beside an array, or of a text in each of its elements."""
    found: dict[str, float] = {}
    names = value.get("name", [])
    for member in types[kind]:
        path, by_label, inner = prefix + member.name, labelled + member.name, value[member.name]
        if member.kind == "string":
            continue
        if member.length is None:
            items = [("", "", inner)]
        else:
            own = [item.get("child_frame_id") if isinstance(item, dict) else None for item in inner]
            beside = names if member.length == -1 and len(names) == len(inner) else [""] * len(inner)
            labels = own if inner and own[0] is not None else beside
            items = [(f"[{i}]", label_of(labels, i), item) for i, item in enumerate(inner)]
        for place, label, item in items:
            if member.kind in types:
                found |= truth(member.kind, item, types, f"{path}{place}.", f"{by_label}{label}.")
            else:
                found |= {path + place: float(item), by_label + label: float(item)}
    return found


def label_of(labels: list[Any], index: int) -> str:
    label = str(labels[index])
    if not label or labels.count(label) > 1:
        return f"[{index}]"
    return f'["{label}"]' if label.isdecimal() else f"[{label}]"


def columns_of(
    types: Types, messages: list[bytes], rng: random.Random, packed: bool, wanted: frozenset[str] | None
) -> dict[str, np.ndarray[Any, Any]]:
    """Our columns of the messages, handed over in batches that are cut anywhere."""
    name, text = text_of(types)
    decoder = ColumnDecoder(parse_definition(name, text, "test"), wanted, packed=packed)
    left = list(messages)
    while left:
        batch, left = left[: (size := rng.randint(1, 8))], left[size:]
        sizes = np.array([len(message) for message in batch], dtype=np.int64)
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        decoder.add(np.frombuffer(b"".join(batch) or b"\0", np.uint8), starts, sizes)
    assert not decoder.columns.bad, decoder.reason
    return dict(decoder.columns.release())


def test_an_inner_message_has_its_own_names_wherever_they_stand() -> None:
    state = [Field("position", "float64", -1), Field("name", "string", -1)]
    types = {"p/State": state, "p/Robot": [Field("name", "string", -1), Field("arm", "p/State", None)]}
    value = {"name": ["left", "right"], "arm": {"position": [1.0, 2.0], "name": ["boom", "stick"]}}
    columns = columns_of(types, [Encoder(types, "<", True).whole("p/Robot", value)], random.Random(0), True, None)
    assert {path: column.tolist() for path, column in columns.items()} == {
        "arm.position[0]": [1.0], "arm.position[1]": [2.0], "arm.position[boom]": [1.0], "arm.position[stick]": [2.0],
    }  # fmt: skip


@pytest.mark.parametrize("packed", [False, True], ids=["ros2", "ros1"])
@settings(max_examples=examples(150))
@given(types=definitions(), seed=st.integers(0, 2**32))
def test_nothing_is_misread_whatever_changes_between_messages(types: Types, seed: int, packed: bool) -> None:
    rng = random.Random(seed)
    root = list(types)[-1]
    values = [drawn(root, types, rng)]
    for _ in range(rng.randint(1, 24)):
        values.append(altered(root, rng.choice(values[-3:]), types, rng))
    orders = ["<" if packed or rng.random() < 0.7 else ">" for _ in values]
    messages = [Encoder(types, order, packed).whole(root, value) for order, value in zip(orders, values, strict=True)]
    expected = [truth(root, value, types) for value in values]
    paths = {path for row in expected for path in row}
    table = {path: np.array([row.get(path, np.nan) for row in expected]) for path in paths}

    columns = columns_of(types, messages, rng, packed, None)
    assert set(columns) == paths
    for path, column in columns.items():
        np.testing.assert_array_equal(column, table[path], err_msg=path)

    wanted = frozenset(path for path in sorted(paths) if rng.random() < 0.3)
    part = columns_of(types, messages, rng, packed, wanted)
    assert set(part) == wanted
    for path, column in part.items():
        np.testing.assert_array_equal(column, table[path], err_msg=f"{path}, wanted")

    if not packed:
        name, text = text_of(types)
        package, _, short = name.partition("/")
        peer = DecoderFactory().decoder_for("cdr", Schema(1, text.encode(), "ros2msg", f"{package}/msg/{short}"))
        assert peer is not None
        for row, message in enumerate(messages):
            seen: dict[str, float] = {}
            flatten(peer(message), "", seen)
            for path, number in seen.items():
                assert columns[path][row] == number, (path, row)
