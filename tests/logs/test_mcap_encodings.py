"""MCAP with JSON, protobuf and IDL; wanted fields alone; the message index; many channels of one topic."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from attempts import attempt
from examples import examples
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as RawWriter
from mcap_ros2.writer import Writer
from test_mcap_reader import STATE, rows, state, write_states

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream
from sysid.logs.inspection import summarise
from sysid.logs.mcap import McapReader, indexed_block
from sysid.logs.messages import flatten


def write_raw(
    path: Path, messages: list[bytes], encoding: str, schema: tuple[str, str, bytes] | None, topic: str = "/m", **options: Any
) -> None:
    with path.open("wb") as file:
        writer = RawWriter(file, **options)
        writer.start()
        number = writer.register_schema(*schema) if schema is not None else 0
        channel = writer.register_channel(topic, encoding, number)
        for index, data in enumerate(messages):
            writer.add_message(channel, log_time=index, publish_time=index, data=data)
        writer.finish()


def read_one(path: Path, **options: Any) -> Stream:
    (stream,) = McapReader().read(path, ReadOptions(**options))
    return stream


def test_json_messages_with_and_without_a_schema(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    message = {
        "header": {"stamp": {"sec": 1_700_000_000, "nsec": 123_456_789}},
        "name": ["boom", "stick"],
        "position": [0.5, -1],
        "deep": {"x": 3, "on": True, "text": "no number"},
    }
    later = {**message, "header": {"stamp": {"sec": 1_700_000_000, "nsec": 123_456_790}}, "position": [7, 8]}
    data = [json.dumps(message).encode(), b"{broken", b"[1]", json.dumps(later).encode()]
    for schema in (None, ("State", "jsonschema", b'{"type": "object"}')):
        write_raw(path, data, "json", schema)
        stream = read_one(path)
        np.testing.assert_array_equal(stream.columns["position[boom]"], [0.5, 7.0])
        np.testing.assert_array_equal(stream.columns["position[1]"], [-1.0, 8.0])
        np.testing.assert_array_equal(stream.columns["deep.on"], [1.0, 1.0])
        np.testing.assert_array_equal(stream.stamps["header"], [1_700_000_000_123_456_789, 1_700_000_000_123_456_790])
        np.testing.assert_array_equal(stream.stamps["log"], [0, 3])
        assert "2 messages do not follow their schema (the first: Expecting property name" in stream.losses[0]


def pose_files() -> descriptor_pb2.FileDescriptorSet:
    file = descriptor_pb2.FileDescriptorProto(name="pose.proto", package="test", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    vector = file.message_type.add(name="Vector")
    kinds = descriptor_pb2.FieldDescriptorProto
    for number, name in enumerate("xyz", start=1):
        vector.field.add(name=name, number=number, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL)
    pose = file.message_type.add(name="Pose")
    pose.field.add(
        name="timestamp",
        number=1,
        type=kinds.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=kinds.LABEL_OPTIONAL,
    )
    pose.field.add(name="at", number=2, type=kinds.TYPE_MESSAGE, type_name=".test.Vector", label=kinds.LABEL_OPTIONAL)
    pose.field.add(name="name", number=3, type=kinds.TYPE_STRING, label=kinds.LABEL_REPEATED)
    pose.field.add(name="position", number=4, type=kinds.TYPE_FLOAT, label=kinds.LABEL_REPEATED)
    return descriptor_pb2.FileDescriptorSet(file=[file])


@pytest.mark.parametrize("with_google", [True, False])
def test_protobuf_messages(tmp_path: Path, with_google: bool) -> None:
    files = pose_files()
    google = descriptor_pb2.FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(google)
    pool.Add(files.file[0])
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("test.Pose"))
    if with_google:
        files.file.append(google)  # behind the file that needs it: the order is not the writer's duty
    message = kind(at={"x": 1.5, "z": -2.0}, name=["boom"], position=[0.25])
    message.timestamp.seconds, message.timestamp.nanos = 1_700_000_000, 5
    path = tmp_path / "log.mcap"
    data = message.SerializeToString()
    message.timestamp.nanos = 6
    write_raw(
        path, [data, data[:-2], message.SerializeToString()], "protobuf", ("test.Pose", "protobuf", files.SerializeToString())
    )
    stream = read_one(path)
    np.testing.assert_array_equal(stream.columns["at.x"], [1.5, 1.5])
    np.testing.assert_array_equal(stream.columns["at.y"], [0.0, 0.0])
    np.testing.assert_array_equal(stream.columns["position[boom]"], [0.25, 0.25])
    np.testing.assert_array_equal(stream.stamps["header"], [1_700_000_000_000_000_005, 1_700_000_000_000_000_006])
    assert stream.kind == "test.Pose"
    assert "1 messages do not follow their schema" in stream.losses[0]


def test_a_damaged_protobuf_schema_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    for text in (b"\xff\xff\xff", b"", pose_files().SerializeToString()[:30]):
        write_raw(path, [b""], "protobuf", ("test.Pose", "protobuf", text))
        with pytest.raises(InputError, match=r"log\.mcap: /m: schema test\.Pose: a protobuf schema that cannot be read"):
            McapReader().read(path, ReadOptions(streams=frozenset({"/m"})))


IDL = """================================================================================
IDL: test_msgs/msg/Pair
module test_msgs { module msg {
  struct Pair { double first; sequence<float> rest; test_msgs::msg::Inner inner; };
}; };
================================================================================
IDL: test_msgs/msg/Inner
module test_msgs { module msg { struct Inner { uint8 a; int64 b; }; }; };
"""


def test_idl_schemas_are_decoded(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    same = "float64 first\nfloat32[] rest\nInner inner\n" + "=" * 80 + "\nMSG: test_msgs/Inner\nuint8 a\nint64 b\n"
    with path.open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("test_msgs/msg/Pair", same)
        value = {"first": 2.5, "rest": [1.0, 2.0, 3.0], "inner": {"a": 7, "b": -9}}
        writer.write_message("/pair", schema, value, log_time=1, publish_time=1)
    reference = read_one(path)
    from mcap.reader import make_reader

    with path.open("rb") as file:
        data = [message.data for _, _, message in make_reader(file).iter_messages()]
    write_raw(path, data, "cdr", ("test_msgs/msg/Pair", "ros2idl", IDL.encode()), topic="/pair")
    stream = read_one(path)
    assert stream.columns.keys() == reference.columns.keys()
    assert {name: float(values[0]) for name, values in stream.columns.items()} == {
        "first": 2.5, "rest[0]": 1.0, "rest[1]": 2.0, "rest[2]": 3.0, "inner.a": 7.0, "inner.b": -9.0,
    }  # fmt: skip
    write_raw(path, data, "cdr", ("test_msgs/msg/Pair", "ros2idl", b"module {"), topic="/pair")
    with pytest.raises(InputError, match="schema test_msgs/msg/Pair: IDL that cannot be read"):
        McapReader().read(path, ReadOptions(streams=frozenset({"/pair"})))


def test_an_unknown_encoding_is_a_loss_or_an_error(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = RawWriter(file)
        writer.start()
        for topic, encoding in (("/flat", "flatbuffer"), ("/json", "json")):
            channel = writer.register_channel(topic, encoding, 0)
            writer.add_message(channel, 1, b'{"x": 1}', 1)
        writer.finish()
    (stream,) = McapReader().read(path, ReadOptions())
    assert stream.name == "/json"
    assert "/flat: messages in 'flatbuffer' with a schema in ''; expected 'cdr' with 'ros2msg'" in stream.losses[0]
    with pytest.raises(InputError, match="messages in 'flatbuffer'"):
        McapReader().read(path, ReadOptions(streams=frozenset({"/flat"})))


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows, st.sets(st.sampled_from(["count", "fixed[1]", "position[0]", "position[2]", "position[a]", "position[bb]"])))
def test_wanted_fields_are_those_of_the_whole_read(
    tmp_path: Path, messages: list[tuple[int, list[str], list[float], str]], wanted: set[str]
) -> None:
    """Names in any order, arrays of any length: a message that is walked to the last wanted field alone is never misread. An
    index that is another name in other messages is refused.
    """
    path = tmp_path / "log.mcap"
    write_states(path, [state(*message) for message in messages], chunk_size=400)
    whole = read_one(path)
    held = [names for _, names, values, _ in messages if len(names) == len(values)]
    for name in sorted(wanted & {"position[0]", "position[2]"}):
        place = int(name[9])
        others = {names[place] for names in held if len(names) > place} - {""}
        doubtful = len(others) > 1
        part_of, refusal = attempt(InputError, lambda name=name: read_one(path, fields={"/state": frozenset({name})}))
        assert (part_of is None) == doubtful == ("in some messages and" in refusal)
        wanted = wanted - ({name} if doubtful else set())
    twice = {name for name in wanted if any(names.count(name[9:-1]) > 1 for names in held)}
    wanted = {name for name in wanted if name not in twice or name in whole.columns}
    part = read_one(path, fields={"/state": frozenset(wanted)})
    assert set(part.columns) == wanted & set(whole.columns)
    for name, values in part.columns.items():
        np.testing.assert_array_equal(values, whole.columns[name], err_msg=name)
    for clock, stamps in whole.stamps.items():
        np.testing.assert_array_equal(part.stamps[clock], stamps)
    assert set(part.columns) <= set(part.fields)


def test_a_preview_has_all_stamps_and_the_first_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.logs.topics.PREVIEW", 30)
    path = tmp_path / "log.mcap"
    write_states(path, [state(t, ["boom"], [1.0 * t], "x" * (t % 3)) for t in range(100)], chunk_size=1000)
    whole, seen = read_one(path), read_one(path, preview=True)
    for clock, stamps in whole.stamps.items():
        np.testing.assert_array_equal(seen.stamps[clock], stamps)
    first = seen.columns["position[boom]"]
    assert 30 <= len(first) < 60
    np.testing.assert_array_equal(first, whole.columns["position[boom]"][: len(first)])
    (shown,) = [item for item in summarise(seen).fields if item.name == "position[boom]"]
    assert (shown.missing, shown.low, shown.high) == (0.0, 0.0, len(first) - 1.0)


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
def test_with_and_without_the_message_index(tmp_path: Path, index: IndexType) -> None:
    path = tmp_path / "log.mcap"
    messages = [json.dumps({"x": t}).encode() for t in range(300)]
    write_raw(path, messages, "json", None, chunk_size=500, index_types=index, compression=CompressionType.NONE)
    np.testing.assert_array_equal(read_one(path).columns["x"], np.arange(300.0))


def test_an_index_that_leaves_messages_out_is_not_trusted() -> None:
    message = b"\x05" + (22 + 1).to_bytes(8, "little") + bytes(22) + b"x"
    records = message * 3
    offsets = [0, len(message), 2 * len(message)]

    def entry(positions: list[int]) -> bytes:
        return b"\0\0\0\0\0\0" + b"".join(bytes(8) + p.to_bytes(8, "little") for p in positions)

    block = indexed_block(records, [entry(offsets)])
    assert block is not None
    np.testing.assert_array_equal(block.starts, offsets)
    np.testing.assert_array_equal(indexed_block(records, [entry([offsets[2]]), entry(offsets[:2])]).starts, offsets)  # type: ignore[union-attr]
    for wrong in (
        [0, len(message)],
        [0, len(message), len(message) + 1],
        [0, 2**63, 5],
        [0, 0, len(message)],
        [*offsets, 10**6],
    ):
        assert indexed_block(records, [entry(wrong)]) is None
    assert indexed_block(records, [b"\0\0"]) is None


def test_two_channels_of_one_topic_are_one_stream(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = RawWriter(file)
        writer.start()
        channels = [writer.register_channel("/x", "json", 0, {"node": str(number)}) for number in range(2)]
        other = writer.register_channel("/x", "json", writer.register_schema("Other", "jsonschema", b"{}"))
        for index, channel in enumerate([*channels, other, *channels]):
            writer.add_message(channel, index, json.dumps({"x": index}).encode(), index)
        writer.finish()
    streams = {stream.name: stream for stream in McapReader().read(path, ReadOptions())}
    np.testing.assert_array_equal(np.sort(streams["/x"].columns["x"]), [0, 1, 3, 4])
    np.testing.assert_array_equal(streams["/x#2"].columns["x"], [2])


def test_memory_is_that_of_the_wanted_fields(tmp_path: Path) -> None:
    """40 MB of images beside a small topic: neither the file nor a topic that is not wanted is ever held whole."""
    path = tmp_path / "log.mcap"
    image = "std_msgs/Header header\nuint8[] data\n" + STATE.partition("uint8[] raw\n")[2].partition("\n")[2]
    with path.open("wb") as file, Writer(file, compression=CompressionType.NONE) as writer:
        states = writer.register_msgdef("test_msgs/msg/State", STATE)
        images = writer.register_msgdef("test_msgs/msg/Image", image)
        for t in range(200):
            picture = {"header": {"stamp": {"sec": t, "nanosec": 0}, "frame_id": ""}, "data": bytes(200_000)}
            writer.write_message("/image", images, picture, log_time=t, publish_time=t)
            writer.write_message("/state", states, state(t, ["boom"], [float(t)]), log_time=t, publish_time=t)
    assert path.stat().st_size > 40e6
    tracemalloc.start()
    try:
        wanted = {"/state": frozenset({"position[boom]"}), "/image": frozenset[str]()}
        streams = McapReader().read(path, ReadOptions(fields=wanted))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8e6
    by_name = {stream.name: stream for stream in streams}
    np.testing.assert_array_equal(by_name["/state"].columns["position[boom]"], np.arange(200.0))
    np.testing.assert_array_equal(by_name["/image"].stamps["header"], np.arange(200) * 10**9)


def test_flattening_keeps_whole_numbers_and_gives_up_on_deep_objects() -> None:
    flat: dict[str, float] = {}
    flatten({"t": 2**62 + 1, "a": [{"b": 1.5}]}, "", flat)
    assert flat == {"t": 2**62 + 1, "a[0].b": 1.5}
    deep: dict[str, Any] = {}
    for _ in range(100):
        deep = {"x": deep}
    with pytest.raises(ValueError, match="more than 32 levels of objects"):
        flatten(deep, "", {})
