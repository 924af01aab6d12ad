"""Types that one generation of ROS writes otherwise than another: signs, wide texts, versions of CDR."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_layout_guards import FORMATS, Encoder, Message, Types, copied, definitions, drawn, text_of, truth
from test_mcap_encodings import write_raw

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream
from sysid.logs.mcap import McapReader

ROS1 = {
    "byte": "b",
    "char": "B",
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
}


def read(path: Path, **options: frozenset[str]) -> Stream:
    (stream,) = McapReader().read(path, ReadOptions(fields={"/m": options["fields"]} if options else None))
    return stream


@pytest.mark.parametrize("ros1", [True, False])
@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_whole_number_keeps_its_sign(tmp_path: Path, ros1: bool, data: st.DataObject) -> None:
    codes = ROS1 if ros1 else ROS1 | {"byte": "B"}
    drawn_values = {}
    for kind, code in codes.items():
        bits = 8 * struct.calcsize(code)
        low, high = (0, 1) if code == "?" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)
        drawn_values[kind] = data.draw(st.integers(low, high))
    body = b"".join(struct.pack("<" + codes[kind], value) for kind, value in drawn_values.items())
    text = "\n".join(f"{kind} f_{kind}" for kind in codes).encode()
    path = tmp_path / "log.mcap"
    if ros1:
        times = (3_000_000_000, 5, -3, -7)
        message = body + struct.pack("<IIii", *times)
        write_raw(path, [message], "ros1", ("p/M", "ros1msg", text + b"\ntime t\nduration d"))
    else:
        times = (-1, 5, -3, 3_000_000_000)
        message = b"\0\1\0\0" + body + bytes(-len(body) % 4) + struct.pack("<iIiI", *times)
        extra = b"\nbuiltin_interfaces/Time t\nbuiltin_interfaces/Duration d"
        write_raw(path, [_aligned(codes, drawn_values, times)], "cdr", ("p/M", "ros2msg", text + extra))
    columns = read(path).columns
    assert {kind: columns[f"f_{kind}"][0] for kind in codes} == drawn_values
    assert [columns[name][0] for name in ("t.sec", "t.nanosec", "d.sec", "d.nanosec")] == list(times)
    assert message


def _aligned(codes: dict[str, str], values: dict[str, int], times: tuple[int, ...]) -> bytes:
    data = b""
    for code, value in [*((codes[kind], value) for kind, value in values.items()), *zip("iIiI", times, strict=True)]:
        data += bytes(-len(data) % struct.calcsize(code)) + struct.pack("<" + code, value)
    return b"\0\1\0\0" + data


def wide(text: str, width: int) -> bytes:
    encoded = text.encode({4: "utf-32-le", 2: "utf-16-le", 1: "utf-16-le"}[width])
    return struct.pack("<I", len(encoded) // width) + encoded


@pytest.mark.parametrize("width", [4, 2, 1])
@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    text=st.text(st.characters(min_codepoint=1, max_codepoint=0xD7FF), max_size=9),
    names=st.lists(st.sampled_from(["boom", "stick"]), max_size=2),
)
def test_wide_texts_of_every_middleware(tmp_path: Path, width: int, text: str, names: list[str]) -> None:
    names = list(dict.fromkeys(names))
    data = wide(text, width)
    data += bytes(-len(data) % 4) + struct.pack("<I", len(names))
    for name in names:
        data += bytes(-len(data) % 4) + wide(name, width)
    data += bytes(-len(data) % 4) + struct.pack("<I", len(names))
    data += bytes(-len(data) % 8) * bool(names) + struct.pack(f"<{len(names)}d", *range(len(names)))
    data += bytes(-len(data) % 8) + struct.pack("<d", 7.5)
    path = tmp_path / "log.mcap"
    schema = ("p/M", "ros2msg", b"wstring note\nwstring[] name\nfloat64[] position\nfloat64 last")
    write_raw(path, [b"\0\1\0\0" + data] * 2, "cdr", schema)
    for wanted in (None, frozenset({"last"})):
        columns = read(path, **({} if wanted is None else {"fields": wanted})).columns
        assert columns["last"].tolist() == [7.5, 7.5]
    for k, name in enumerate(names):
        assert read(path).columns[f"position[{name}]"].tolist() == [float(k)] * 2


class Encoder2(Encoder):
    """Plain CDR of version 2: alignment to four bytes, the size before arrays of texts and messages."""

    def whole(self, kind: str, value: Message) -> bytes:
        self.message(kind, value)
        return bytes([0, 7 if self.order == "<" else 6, 0, 0]) + bytes(self.data)

    def number(self, code: str, value: float) -> None:
        self.data += bytes(-len(self.data) % min(4, struct.calcsize(code)))
        self.data += struct.pack(self.order + code, value)

    def message(self, kind: str, value: Message) -> None:
        for member in self.types[kind]:
            inner = value[member.name]
            if member.length is None:
                self.value(member.kind, inner)
                continue
            place = len(self.data)
            if member.kind not in FORMATS:
                self.number("I", 0)
                place = len(self.data)
            if member.length < 0:
                self.number("I", len(inner))
            for item in inner:
                self.value(member.kind, item)
            if member.kind not in FORMATS:
                struct.pack_into(self.order + "I", self.data, place - 4, len(self.data) - place)


@settings(max_examples=examples(80), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(types=definitions(), rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_version_2_of_cdr(tmp_path: Path, types: Types, rng: object, order: str) -> None:
    root, text = text_of(types)
    value = copied(drawn(root, types, rng))  # type: ignore[arg-type]
    path = tmp_path / "log.mcap"
    message = Encoder2(types, order, False).whole(root, value)
    write_raw(path, [message, message], "cdr", (root, "ros2msg", text.encode()))
    expected = truth(root, value, types)
    columns = read(path).columns
    assert {name: values.tolist() for name, values in columns.items()} == {name: [v, v] for name, v in expected.items()}


@pytest.mark.parametrize(
    ("code", "name"), [(3, "parameter-list CDR"), (9, "delimited CDR of version 2"), (11, "parameter-list CDR of version 2")]
)
def test_a_version_of_cdr_that_is_not_read_is_named_with_its_count(tmp_path: Path, code: int, name: str) -> None:
    path = tmp_path / "log.mcap"
    write_raw(path, [bytes([0, code, 0, 0]) + bytes(8)] * 5, "cdr", ("p/M", "ros2msg", b"float64 x"))
    with pytest.raises(
        InputError, match=rf"5 messages do not follow .* encapsulation 00{code:02x}, {name}, instead of plain CDR"
    ):
        read(path)


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        ([0, 0, 0], False),
        ([5, 5, 5], False),
        ([0], False),
        ([5], True),
        ([0, 1, 2], True),
        ([0, 0, 1, 2, 3], True),
        ([0, 0, 5000, 5001], False),
        ([0, 10**9, 10**9 + 1], False),
        ([5000, 5001], True),
        ([0, 0, 5000], False),
    ],
)
def test_a_header_stamp_that_is_never_set_is_no_clock(tmp_path: Path, stamps: list[int], kept: bool) -> None:
    path = tmp_path / "log.mcap"
    messages = [b"\0\1\0\0" + struct.pack("<iId", stamp, 0, 0.5) for stamp in stamps]
    text = f"builtin_interfaces/Time stamp\nfloat64 x\n{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
    write_raw(path, messages, "cdr", ("p/M", "ros2msg", text.encode()))
    stream = read(path)
    assert list(stream.stamps) == (["header"] if kept else []) + ["log", "publish"]
    assert any("they have no clock 'header'" in loss for loss in stream.losses) == (not kept)
    assert np.isfinite(stream.columns["x"]).all()
