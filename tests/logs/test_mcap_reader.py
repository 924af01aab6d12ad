"""MCAP: columns against the row-by-row reference decoder, real bags, files that are cut off."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as RawWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream
from sysid.logs.layout import layout_of
from sysid.logs.mcap import McapReader
from sysid.logs.messages import ColumnDecoder
from sysid.logs.rosmsg import parse_definition

LINE = "=" * 80
STATE = f"""std_msgs/Header header
string[] name
float64[] position
float32[2] fixed
int16 count
bool ok
uint8[] raw
builtin_interfaces/Duration wait
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def state(t: int, names: list[str], positions: list[float], frame: str = "") -> dict[str, Any]:
    return {
        "header": {"stamp": {"sec": t, "nanosec": 5 * t}, "frame_id": frame},
        "name": names,
        "position": positions,
        "fixed": [0.5 * t, -1.0],
        "count": -t,
        "ok": t % 2 == 0,
        "raw": b"\x01\x02\x03"[: t % 4],
        "wait": {"sec": 1, "nanosec": t},
    }


def write_states(path: Path, messages: list[dict[str, Any]], **options: Any) -> None:
    with path.open("wb") as file, Writer(file, **options) as writer:
        schema = writer.register_msgdef("test_msgs/msg/State", STATE)
        for index, message in enumerate(messages):
            writer.write_message("/state", schema, message, log_time=1000 + index, publish_time=900 + index)


def flatten(value: Any, path: str, into: dict[str, float]) -> None:
    if hasattr(value, "__slots__"):
        for name in value.__slots__:
            flatten(getattr(value, name), f"{path}.{name}" if path else name, into)
    elif isinstance(value, list | tuple | bytes):
        for index, item in enumerate(value):
            flatten(item, f"{path}[{index}]", into)
    elif isinstance(value, int | float):
        into[path] = float(value)


def assert_like_reference(path: Path, streams: tuple[Stream, ...]) -> int:
    """Every number that mcap-ros2-support decodes stands in the columns, and nothing else does; how many were compared."""
    rows: dict[str, list[dict[str, float]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            flat: dict[str, float] = {}
            flatten(message, "", flat)
            rows.setdefault(channel.topic, []).append(flat)
    assert {stream.name for stream in streams} == set(rows)
    compared = 0
    for stream in streams:
        expected = rows[stream.name]
        assert len(stream) == len(expected)
        for column in {key for row in expected for key in row}:
            want = np.array([row.get(column, np.nan) for row in expected])
            np.testing.assert_array_equal(stream.columns[column], want, err_msg=column)
            compared += len(want)
    return compared


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_columns_are_those_of_the_reference_decoder(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(t, ["boom", "stick"], [t * 0.1, -t]) for t in range(50)], compression=compression, chunk_size=700)
    (stream,) = McapReader().read(path, ReadOptions())
    assert assert_like_reference(path, (stream,)) > 50 * 8
    np.testing.assert_array_equal(stream.stamps["header"], [t * 1_000_000_005 for t in range(50)])
    np.testing.assert_array_equal(stream.stamps["log"], 1000 + np.arange(50))
    np.testing.assert_array_equal(stream.stamps["publish"], 900 + np.arange(50))
    np.testing.assert_array_equal(stream.columns["position[boom]"], stream.columns["position[0]"])
    assert stream.losses == ()


def test_permuted_names_of_equal_length_go_to_the_right_column(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_states(
        path, [state(0, ["aa", "bb"], [1.0, 2.0]), state(4, ["bb", "aa"], [3.0, 4.0]), state(8, ["aa", "bb"], [5.0, 6.0])]
    )
    (stream,) = McapReader().read(path, ReadOptions())
    np.testing.assert_array_equal(stream.columns["position[aa]"], [1.0, 4.0, 5.0])
    np.testing.assert_array_equal(stream.columns["position[bb]"], [2.0, 3.0, 6.0])
    np.testing.assert_array_equal(stream.columns["position[0]"], [1.0, 3.0, 5.0])


texts = st.text(alphabet="abc", max_size=3)
rows = st.lists(
    st.tuples(
        st.integers(0, 9), st.lists(texts, max_size=3), st.lists(st.floats(width=64, allow_nan=False), max_size=4), texts
    ),
    min_size=1,
    max_size=12,
)


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows)
def test_any_mixture_of_layouts_decodes_like_the_reference(
    tmp_path: Path, messages: list[tuple[int, list[str], list[float], str]]
) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(*message) for message in messages], chunk_size=400)
    assert_like_reference(path, McapReader().read(path, ReadOptions()))


def test_real_bags_decode_like_the_reference(shared_data: Path) -> None:
    for path in sorted((shared_data / "mcap_bags").glob("*.mcap")):
        assert_like_reference(path, McapReader().read(path, ReadOptions()))


def test_big_endian_and_little_endian_messages_may_mix() -> None:
    definition = parse_definition("p/msg/M", "uint8 a\nfloat64 b\nint32[] c", "test")
    little = b"\x00\x01\x00\x00" + struct.pack("<B7xdIi", 1, 2.5, 1, -3)
    big = b"\x00\x00\x00\x00" + struct.pack(">B7xdIi", 4, -0.5, 1, 9)
    decoder = ColumnDecoder(definition)
    buffer = np.frombuffer(little + big, np.uint8)
    decoder.add(buffer, np.array([0, len(little)]), np.array([len(little), len(big)]))
    columns = decoder.columns.release()
    np.testing.assert_array_equal(columns["b"], [2.5, -0.5])
    np.testing.assert_array_equal(columns["c[0]"], [-3.0, 9.0])


def test_messages_that_do_not_follow_their_schema_are_left_out_and_reported(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    good = b"\x00\x01\x00\x00" + struct.pack("<d", 7.0)
    with path.open("wb") as file:
        writer = RawWriter(file)
        writer.start()
        schema = writer.register_schema("p/msg/M", "ros2msg", b"float64 x")
        channel = writer.register_channel("/m", "cdr", schema)
        for index, data in enumerate([good, good[:9], good, b"", b"\x00\x09\x00\x00" + good[4:]]):
            writer.add_message(channel, log_time=index, publish_time=index, data=data)
        writer.finish()
    (stream,) = McapReader().read(path, ReadOptions())
    np.testing.assert_array_equal(stream.stamps["log"], [0, 2])
    np.testing.assert_array_equal(stream.columns["x"], [7.0, 7.0])
    assert stream.losses == ("log.mcap: /m: 3 messages do not follow their schema (the first: the message ends after 9 bytes)",)


def test_a_file_without_chunks_and_index_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = RawWriter(file, use_chunking=False, index_types=IndexType.NONE, use_statistics=False)
        writer.start()
        schema = writer.register_schema("p/msg/M", "ros2msg", b"float64 x")
        channel = writer.register_channel("/m", "cdr", schema)
        for index in range(5):
            writer.add_message(channel, index, b"\x00\x01\x00\x00" + struct.pack("<d", index), index)
        writer.finish()
    (stream,) = McapReader().read(path, ReadOptions())
    np.testing.assert_array_equal(stream.columns["x"], np.arange(5.0))


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_of_a_cut_off_file_everything_before_the_cut_is_read(tmp_path: Path, compression: CompressionType) -> None:
    whole = tmp_path / "whole.mcap"
    rng = np.random.default_rng(1)
    write_states(
        whole, [state(t, ["boom"], [float(rng.normal())]) for t in range(4000)], compression=compression, chunk_size=60_000
    )
    (reference,) = McapReader().read(whole, ReadOptions())
    data = whole.read_bytes()
    read = []
    for share in (0.2, 0.5, 0.51, 0.8):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[: int(share * len(data))])
        (stream,) = McapReader().read(path, ReadOptions())
        assert "cut off at byte" in stream.losses[0]
        np.testing.assert_array_equal(stream.columns["position[0]"], reference.columns["position[0]"][: len(stream)])
        read.append(len(stream))
    assert read == sorted(read)
    # The last, incomplete chunk holds 60 kB, about 600 messages: all but its broken end is read.
    assert read[1] > 0.5 * 4000 - 650
    assert read[3] < 4000


def test_a_file_that_grows_is_read_as_it_was_when_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, path = tmp_path / "whole.mcap", tmp_path / "log.mcap"
    states = [state(t, ["boom"], [float(t)]) for t in range(400)]
    write_states(whole, states, compression=CompressionType.NONE, chunk_size=6000)
    data = whole.read_bytes()
    for cut in range(len(data) // 2, len(data) // 2 + 700, 7):
        path.write_bytes(data[:cut])
        (expected,) = McapReader().read(path, ReadOptions())

        def grows(file: object, size: int, cut: int = cut) -> Iterator[tuple[int, bytes]]:
            with path.open("ab") as more:
                more.write(data[cut:])
            return iter(())

        with monkeypatch.context() as patch:
            patch.setattr("sysid.logs.mcap._summary", grows)
            (stream,) = McapReader().read(path, ReadOptions())
        assert stream.losses == expected.losses
        np.testing.assert_array_equal(stream.columns["position[0]"], expected.columns["position[0]"])


def test_a_damaged_chunk_is_left_out_and_reported(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(t, ["boom"], [0.0]) for t in range(100)], compression=CompressionType.NONE, chunk_size=2000)
    data = bytearray(path.read_bytes())
    data[1500] ^= 0xFF
    path.write_bytes(bytes(data))
    (stream,) = McapReader().read(path, ReadOptions())
    assert 60 < len(stream) < 100
    assert "fails its checksum" in stream.losses[0]


def test_a_log_of_which_nothing_is_left_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(t, ["boom"], [0.0]) for t in range(100)], compression=CompressionType.ZSTD)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match=r"cut off at byte 60.*expected at least one readable message"):
        McapReader().read(path, ReadOptions())


def test_what_is_no_mcap_file_is_named(tmp_path: Path) -> None:
    empty, bag = tmp_path / "empty.mcap", tmp_path / "bag.mcap"
    empty.touch()
    bag.write_bytes(b"#ROSBAG V2.0\n" * 10)
    with pytest.raises(InputError, match=r"empty\.mcap: the file is empty; expected an MCAP file"):
        McapReader().read(empty, ReadOptions())
    with pytest.raises(InputError, match="expected the magic bytes of an MCAP file"):
        McapReader().read(bag, ReadOptions())


def test_an_unknown_topic_suggests_the_nearest(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_states(path, [state(0, [], [])])
    with pytest.raises(InputError, match=r"no topic '/stat'; expected '/state'\?"):
        McapReader().read(path, ReadOptions(streams=frozenset({"/stat"})))


def test_an_undefined_type_in_a_schema_is_named() -> None:
    with pytest.raises(InputError, match=r"type 'geometry_msgs/Pose' of p/M\.pose is not defined"):
        parse_definition("p/msg/M", "geometry_msgs/Pose pose", "log.mcap")


def test_constants_defaults_and_bounds_take_no_part_in_the_layout() -> None:
    text = "int32 A=3\nstring<=8 label 'x'\nint8[<=4] few\nfloat32 y 1.5  # a comment"
    definition = parse_definition("p/msg/M", text, "test")
    assert [(f.name, f.kind, f.length) for f in definition.types["p/M"]] == [
        ("label", "string", None),
        ("few", "int8", -1),
        ("y", "float32", None),
    ]
    message = b"\x00\x01\x00\x00" + struct.pack("<I2sxx", 2, b"a\x00") + struct.pack("<Ibbxxf", 2, 5, -6, 2.0)
    layout = layout_of(message, definition)
    assert set(layout.numbers) == {"few[0]", "few[1]", "y"}
