"""MCAP files that are damaged or made to do harm: no crash, no hang, no memory beyond the limits, a message that says where."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from test_mcap_reader import state, write_states

from sysid.errors import InputError
from sysid.logs import ReadOptions
from sysid.logs.layout import layout_of
from sysid.logs.limits import Budget, unpack
from sysid.logs.mcap import CHUNK, MAGIC, McapReader
from sysid.logs.messages import parse_json, protobuf_parser
from sysid.logs.rosmsg import parse_definition, parse_idl


def chunk(packed: bytes, size: int, compression: bytes, checksum: int = 0) -> bytes:
    head = struct.pack("<QQQII", 0, 1, size, checksum, len(compression)) + compression + struct.pack("<Q", len(packed))
    return struct.pack("<BQ", CHUNK, len(head) + len(packed)) + head + packed


BOMB = zstandard.ZstdCompressor().compress(bytes(100 * 2**20))


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (chunk(BOMB, 100 * 2**20, b"zstd"), r"unpack to 104857600, more than 1000 times as many"),
        (chunk(BOMB, 1000, b"zstd"), r"more than the 1000 bytes that the file states"),
        (chunk(BOMB, 2**40, b"zstd"), r"unpacks to 1048576 MiB, more than 512 MiB"),
        (chunk(b"abc", 10, b"lz4"), r"a chunk of 10 bytes cannot be unpacked"),
        (chunk(b"abc", 10, b"brotli"), r"compressed with 'brotli'; zstd, lz4 or none"),
        (chunk(b"abc", 3, b"", checksum=1 + zlib.crc32(b"abc")), "a chunk of 3 bytes fails its checksum"),
        (struct.pack("<BQ", CHUNK, 2**62), "the file is cut off at byte 17"),
        (bytes(50), "no record starts at byte 8"),
        (b"\x90" + struct.pack("<Q", 3) + b"abc" + struct.pack("<BQ", 0x0F, 0), "no messages"),
    ],
)
def test_bombs_and_damage_are_named(tmp_path: Path, record: bytes, reason: str) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + record)
    with pytest.raises(InputError, match=rf"log\.mcap.*{reason}.*expected at least one readable message"):
        McapReader().read(path, ReadOptions())


def test_a_bomb_beside_good_chunks_costs_the_bomb_alone(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(t, ["boom"], [0.5]) for t in range(50)], chunk_size=500)
    data = path.read_bytes()
    path.write_bytes(data[: len(MAGIC)] + chunk(BOMB, 2**39, b"zstd") + data[len(MAGIC) :])
    (stream,) = McapReader().read(path, ReadOptions())
    assert len(stream) == 50
    assert "more than 512 MiB" in stream.losses[0]


@pytest.fixture(scope="module", params=[CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def good_file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("mcap") / "good.mcap"
    write_states(
        path, [state(t, ["boom", "ab"[: t % 3]], [0.1 * t]) for t in range(20)], compression=request.param, chunk_size=600
    )
    return path.read_bytes()


@settings(max_examples=examples(120), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_ends_in_streams_or_a_reason(tmp_path: Path, good_file: bytes, data: st.DataObject) -> None:
    damaged = bytearray(good_file)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(len(MAGIC), len(damaged) - 1))
        damaged[at] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(len(MAGIC), len(damaged))) :]
    path = tmp_path / "log.mcap"
    path.write_bytes(bytes(damaged))
    streams, refusal = attempt(InputError, lambda: McapReader().read(path, ReadOptions()))
    assert streams is not None or "log.mcap" in refusal
    for stream in streams or ():
        assert all(len(values) == len(stream) for values in (*stream.columns.values(), *stream.stamps.values()))


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300))
@example(struct.pack("<BQ", 5, 2**63) + b"x")
def test_any_bytes_behind_the_magic_end_in_a_reason(tmp_path: Path, body: bytes) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + body)
    with pytest.raises(InputError, match=r"log\.mcap"):
        McapReader().read(path, ReadOptions())


KINDS = ["uint8", "float64", "string", "float32[]", "string[]", "int16[3]", "Inner", "Inner[]", "bool[<=4]", "wstring"]


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.sampled_from(KINDS), max_size=6), st.binary(max_size=120), st.booleans())
def test_any_message_of_any_type_is_walked_or_refused(kinds: list[str], body: bytes, little: bool) -> None:
    members = "\n".join(f"{kind} m{number}" for number, kind in enumerate(kinds))
    text = f"{members}\n{'=' * 80}\nMSG: p/Inner\nuint8 a\nstring[] name\nfloat64[] values\n"
    definition = parse_definition("p/msg/M", text, "test")
    data = bytes([0, int(little), 0, 0]) + body
    layout, _ = attempt(IndexError, lambda: layout_of(data, definition))
    if layout is None:
        return
    for code, position in layout.numbers.values():
        assert 4 <= position <= len(data) - int(code[2])
    assert len(layout.records(np.frombuffer(data, np.uint8).reshape(1, -1))) == 1


def test_counts_that_no_message_can_hold_are_refused_at_once() -> None:
    huge = b"\x00\x01\x00\x00" + struct.pack("<I", 2**32 - 1) + bytes(64)
    for kind, message in (
        ("string[]", "texts"),
        ("Inner[]", "elements"),
        ("float64[]", "the message ends"),
        ("string", "ends"),
    ):
        definition = parse_definition("p/msg/M", f"{kind} m\n{'=' * 80}\nMSG: p/Inner\nuint8[0] nothing\n", "test")
        with pytest.raises(IndexError, match=message):
            layout_of(huge, definition)


def test_long_sequences_of_messages_are_passed_over() -> None:
    text = f"Point[] cloud\nfloat64 after\n{'=' * 80}\nMSG: p/Point\nfloat32 x\nfloat64 y\nuint8 z\n"
    definition = parse_definition("p/msg/M", text, "test")
    # Padding depends on where an element starts: its size is 13 or 17 bytes.
    assert (definition.fixed_size("p/Point", 4), definition.fixed_size("p/Point", 0)) == (13, 17)
    count = 20_000
    position = 4
    packed = bytearray()
    for _ in range(count):
        packed += bytes(-(position + len(packed)) % 4) + struct.pack("<f", 1.0)
        packed += bytes(-(position + len(packed)) % 8) + struct.pack("<d", 2.0) + b"\x03"
    packed += bytes(-(position + len(packed)) % 8) + struct.pack("<d", 42.0)
    message = b"\x00\x01\x00\x00" + struct.pack("<I", count) + bytes(packed)
    layout = layout_of(message, definition)
    record = layout.records(np.frombuffer(message, np.uint8).reshape(1, -1))
    assert record["after"][0] == 42.0
    assert record["cloud[511].y"][0] == 2.0
    assert "cloud[512].x" not in layout.numbers


def test_schemas_that_contain_themselves_are_refused() -> None:
    for text in ("M m", "M[] m", f"A a\n{'=' * 80}\nMSG: p/A\nB b\n{'=' * 80}\nMSG: p/B\nA[2] a\n"):
        with pytest.raises(InputError, match=r"contains itself or is too deep; expected at most 20 levels of messages"):
            parse_definition("p/msg/M", text, "log.mcap")
    chain = (
        "T0 x\n" + "".join(f"{'=' * 80}\nMSG: p/T{i}\nT{i + 1} x\n" for i in range(40)) + f"{'=' * 80}\nMSG: p/T40\nbool x\n"
    )
    with pytest.raises(InputError, match=r"log\.mcap: schema p/msg/M: type .* too deep"):
        parse_definition("p/msg/M", chain, "log.mcap")
    with pytest.raises(InputError, match="an array of fewer than 10 billion elements"):
        parse_definition("p/msg/M", f"uint8[{'9' * 5000}] x", "log.mcap")


def test_a_schema_of_other_types_alone_is_refused() -> None:
    with pytest.raises(InputError, match=r"log\.mcap: schema p/msg/M: does not define that type; expected its members first"):
        parse_definition("p/msg/M", "MSG: p/A\nuint8 x\n", "log.mcap")


@settings(max_examples=examples(150), deadline=None)
@given(st.text(alphabet="abM/[]<=3 \n#=:.uint8strng", max_size=120))
def test_any_text_is_a_schema_or_refused(text: str) -> None:
    definition, refusal = attempt(InputError, lambda: parse_definition("p/msg/M", text, "log.mcap"))
    assert refusal.startswith("log.mcap: schema") if definition is None else definition.root == "p/M"


@settings(max_examples=examples(60), deadline=None)
@given(st.text(alphabet="module struct {}<>;:\"'@() \nxdouble", max_size=80))
def test_any_text_is_idl_or_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"log\.mcap: schema p/msg/M"):
        parse_idl("p/msg/M", text, "log.mcap")


@settings(max_examples=examples(100), deadline=None)
@given(st.binary(max_size=80))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="a protobuf schema that cannot be read"):
        protobuf_parser("test.Pose", data, "log.mcap")
    value, refusal = attempt(ValueError, lambda: parse_json(data))
    assert isinstance(value, dict) or refusal


def test_deep_json_does_not_exhaust_the_stack() -> None:
    with pytest.raises((ValueError, RecursionError)):
        parse_json(b"[" * 200_000)


@settings(max_examples=examples(100), deadline=None)
@given(st.sampled_from(["zstd", "lz4"]), st.binary(max_size=60), st.integers(0, 2**64 - 1), st.booleans())
def test_any_packed_bytes_are_unpacked_or_refused(compression: str, packed: bytes, size: int, cut_off: bool) -> None:
    records, refusal = attempt(ValueError, lambda: unpack(packed, compression, size, Budget.of(len(packed)), cut_off))
    assert refusal if records is None else len(records) <= size


@pytest.mark.parametrize("count", [0, 7, 10**6, 2**63, 2**64 - 1])
def test_a_number_of_messages_that_the_file_does_not_hold_does_no_harm(tmp_path: Path, count: int) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(t, ["boom"], [0.5 * t]) for t in range(50)], chunk_size=500)
    data = bytearray(path.read_bytes())
    head = b"\x0b" + (56).to_bytes(8, "little")  # the statistics of a file with one channel
    assert data.count(head) == 1
    at = data.index(head) + len(head) + 46 + 2
    assert int.from_bytes(data[at : at + 8], "little") == 50
    data[at : at + 8] = count.to_bytes(8, "little")
    path.write_bytes(data)
    (stream,) = McapReader().read(path, ReadOptions())
    np.testing.assert_array_equal(stream.columns["position[boom]"], 0.5 * np.arange(50))
    assert all(len(stamps) == 50 for stamps in stream.stamps.values())
