"""Elements of arrays by their labels: of names beside the array, or of a text in each element; in every kind of bag."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import examples
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as RawWriter
from mcap_ros2.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from test_joint_commands import LINE

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.inspection import summarise

#: Element → value in each message, by the texts that label them.
Rows = list[list[tuple[str, float]]]
BODY = "test_msgs/msg/Body"
BODIES = "test_msgs/msg/Bodies"
DEFINITION = f"test_msgs/Body[] bodies\n{LINE}\nMSG: test_msgs/Body\nfloat64 x\nstring body_name\nfloat64 y\n"


def plain(rows: Rows) -> list[dict[str, Any]]:
    return [{"bodies": [{"x": x, "body_name": name, "y": -x} for name, x in row]} for row in rows]


def cdr(path: Path, rows: Rows) -> Path:
    with path.with_suffix(".mcap").open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef(BODIES, DEFINITION)
        for k, message in enumerate(plain(rows)):
            writer.write_message("/m", schema, message, log_time=k, publish_time=k)
    return path.with_suffix(".mcap")


def raw(path: Path, encoding: str, schema: tuple[str, str, bytes], messages: list[bytes]) -> Path:
    with path.with_suffix(".mcap").open("wb") as file:
        writer = RawWriter(file)
        writer.start()
        channel = writer.register_channel("/m", encoding, writer.register_schema(*schema))
        for k, data in enumerate(messages):
            writer.add_message(channel, log_time=k, publish_time=k, data=data)
        writer.finish()
    return path.with_suffix(".mcap")


def as_json(path: Path, rows: Rows) -> Path:
    return raw(path, "json", ("Bodies", "jsonschema", b"{}"), [json.dumps(message).encode() for message in plain(rows)])


def protobuf(path: Path, rows: Rows) -> Path:
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="bodies.proto", package="test", syntax="proto3")
    body, bodies = file.message_type.add(name="Body"), file.message_type.add(name="Bodies")
    for number, name in enumerate(("x", "body_name", "y"), 1):
        kind = kinds.TYPE_STRING if name == "body_name" else kinds.TYPE_DOUBLE
        body.field.add(name=name, number=number, type=kind, label=kinds.LABEL_OPTIONAL)
    bodies.field.add(name="bodies", number=1, type=kinds.TYPE_MESSAGE, type_name=".test.Body", label=kinds.LABEL_REPEATED)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    message_type = message_factory.GetMessageClass(pool.FindMessageTypeByName("test.Bodies"))
    schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    messages = [message_type(**message).SerializeToString() for message in plain(rows)]
    return raw(path, "protobuf", ("test.Bodies", "protobuf", schema), messages)


def in_store(store: Any, rows: Rows) -> list[Any]:
    store.register(get_types_from_msg("float64 x\nstring body_name\nfloat64 y\n", BODY))
    store.register(get_types_from_msg("test_msgs/Body[] bodies\n", BODIES))
    body, bodies = store.types[BODY], store.types[BODIES]
    return [bodies(bodies=[body(x=x, body_name=name, y=-x) for name, x in row]) for row in rows]


def ros1(path: Path, rows: Rows) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path.with_suffix(".bag")) as writer:
        messages = in_store(store, rows)
        connection = writer.add_connection("/m", BODIES, typestore=store)
        for k, message in enumerate(messages):
            writer.write(connection, k, store.serialize_ros1(message, BODIES))
    return path.with_suffix(".bag")


def rosbag2(path: Path, rows: Rows) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(path, version=9) as writer:
        messages = in_store(store, rows)
        connection = writer.add_connection("/m", BODIES, typestore=store)
        for k, message in enumerate(messages):
            writer.write(connection, k, store.serialize_cdr(message, BODIES))
    return next(path.glob("*.db3"))


KINDS = [cdr, as_json, protobuf, ros1, rosbag2]
Write = Callable[[Path, Rows], Path]


def read(path: Path, *fields: str) -> Stream:
    options = ReadOptions(fields={"/m": frozenset(fields)}) if fields else ReadOptions()
    (stream,) = reader_for(path).read(path, options)
    return stream


def bag(folder: Path, write: Write, rows: Rows) -> Path:
    return write(folder / f"log{len(list(folder.iterdir()))}", rows)


TEXTS = st.sampled_from(["boom", "stick", "boom_body", "7", ""])
ROWS = st.lists(st.lists(st.tuples(TEXTS, st.floats(-9, 9)), max_size=4), min_size=1, max_size=6)


@pytest.mark.parametrize("write", KINDS)
@settings(max_examples=examples(25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=ROWS)
def test_an_element_is_the_same_thing_in_every_message(tmp_path: Path, write: Write, rows: Rows) -> None:
    path = bag(tmp_path, write, rows)
    stream = read(path)
    for name in ("boom", "stick", "boom_body", "7"):
        label = '"7"' if name == "7" else name
        own = [[value for text, value in row if text == name] for row in rows]
        expected = [values[0] if len(values) == 1 else np.nan for values in own]
        for field, sign in ((f"bodies[{label}].x", 1.0), (f"bodies[{label}].y", -1.0)):
            there = field in stream.columns
            assert there == (not np.isnan(expected).all())
            if there:
                np.testing.assert_array_equal(stream.columns[field], sign * np.array(expected))
                np.testing.assert_array_equal(read(path, field).columns[field], sign * np.array(expected))
        twice = sum(len(values) > 1 for values in own)
        assert any(f"{twice} messages have two elements {name!r} in bodies" in loss for loss in stream.losses) == bool(twice)


@pytest.mark.parametrize("write", KINDS)
@settings(max_examples=examples(25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=ROWS)
def test_an_index_is_taken_only_where_it_is_one_thing(tmp_path: Path, write: Write, rows: Rows) -> None:
    path = bag(tmp_path, write, rows)
    texts = {row[0][0] for row in rows if row and any(text for text, _ in row)} - {""}
    if len(texts) > 1:
        with pytest.raises(InputError, match=r"bodies\[0\] is '.*' in some messages and '.*' in others; expected bodies\["):
            read(path, "bodies[0].x")
    elif any(rows):
        expected = [row[0][1] if row else np.nan for row in rows]
        found = read(path, "bodies[0].x").columns.get("bodies[0].x", np.full(len(rows), np.nan))
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("write", KINDS)
def test_labels_are_shown_instead_of_indices(tmp_path: Path, write: Write) -> None:
    path = bag(tmp_path, write, [[("boom", 1.0), ("stick", 2.0)], [("stick", 3.0), ("boom", 4.0)]])
    shown = {field.name for field in summarise(read(path)).fields}
    assert shown == {"bodies[boom].x", "bodies[boom].y", "bodies[stick].x", "bodies[stick].y"}


@pytest.mark.parametrize("write", KINDS)
def test_a_label_that_two_elements_always_have_is_refused(tmp_path: Path, write: Write) -> None:
    path = bag(tmp_path, write, 3 * [[("boom", 1.0), ("boom", 2.0), ("stick", 3.0)]])
    with pytest.raises(InputError, match=r"two elements 'boom' in bodies in 3 messages; expected one element a name"):
        read(path, "bodies[boom].x")
    np.testing.assert_array_equal(read(path, "bodies[stick].x").columns["bodies[stick].x"], [3.0] * 3)


def ros2_fields(tmp_path: Path, definition: str, message: dict[str, Any]) -> dict[str, float]:
    """The fields of one message in CDR, which are those of the same message in JSON."""
    with (tmp_path / "cdr.mcap").open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("test_msgs/msg/M", definition)
        writer.write_message("/m", schema, message, log_time=1, publish_time=1)
    path = raw(tmp_path / "json", "json", ("M", "jsonschema", b"{}"), [json.dumps(message).encode()])
    found = [{name: float(values[0]) for name, values in read(p).columns.items()} for p in (tmp_path / "cdr.mcap", path)]
    assert found[0] == found[1]
    return {name: value for name, value in found[0].items() if not any(f"[{k}]" in name for k in range(9))}


def test_names_belong_to_the_arrays_beside_them(tmp_path: Path) -> None:
    definition = f"string[] joint_names\nInner[] interface_values\n{LINE}\nMSG: test_msgs/Inner\n"
    definition += "string[] interface_names\nfloat64[] values\n"
    values = [
        {"interface_names": ["position", "velocity"], "values": [1.0, 2.0]},
        {"interface_names": ["velocity", "position"], "values": [3.0, 4.0]},
    ]
    fields = ros2_fields(tmp_path, definition, {"joint_names": ["stick", "boom"], "interface_values": values})
    assert fields == {
        "interface_values[stick].values[position]": 1.0, "interface_values[stick].values[velocity]": 2.0,
        "interface_values[boom].values[velocity]": 3.0, "interface_values[boom].values[position]": 4.0,
    }  # fmt: skip


def test_messages_beside_names_have_them(tmp_path: Path) -> None:
    """``gazebo_msgs/ModelStates``, with the names before or behind the poses."""
    inner = f"{LINE}\nMSG: test_msgs/Pose\nfloat64 x\nfloat64[3] at\n"
    poses = [{"x": 1.0, "at": [0.0, 0.0, 0.0]}, {"x": 2.0, "at": [0.0, 5.0, 0.0]}]
    for order in (["string[] name", "Pose[] pose"], ["Pose[] pose", "string[] name"]):
        fields = ros2_fields(tmp_path, "\n".join(order) + f"\n{inner}", {"name": ["crane", "ground"], "pose": poses})
        assert [fields[f"pose[{name}].x"] for name in ("crane", "ground")] == [1.0, 2.0]


def test_as_many_points_as_joints_are_points(tmp_path: Path) -> None:
    """A trajectory of two points of two joints: the names are of the joints, not of the points."""
    definition = f"string[] joint_names\nPoint[] points\n{LINE}\nMSG: test_msgs/Point\nfloat64[] positions\n"
    points = [{"positions": [1.0, 2.0]}, {"positions": [3.0, 4.0]}]
    with (tmp_path / "cdr.mcap").open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef("test_msgs/msg/M", definition)
        message = {"joint_names": ["boom", "stick"], "points": points}
        writer.write_message("/m", schema, message, log_time=1, publish_time=1)
    columns = read(tmp_path / "cdr.mcap").columns
    assert columns["points[1].positions[boom]"].tolist() == [3.0]
    assert not [name for name in columns if name.startswith("points[boom]")]


def test_other_names_do_not_reach_into_other_messages(tmp_path: Path) -> None:
    definition = f"string[] name\nInner pose\n{LINE}\nMSG: test_msgs/Inner\nfloat64[] at\n"
    assert ros2_fields(tmp_path, definition, {"name": ["a", "b"], "pose": {"at": [1.0, 2.0]}}) == {}


@pytest.mark.parametrize("write", [cdr, as_json])
def test_a_field_that_is_named_is_read_beside_any_number_of_others(tmp_path: Path, write: Write) -> None:
    """Labels that are new in every message fill the list of fields, which is limited."""
    rows: Rows = [[(f"track{k}_{n}", 1.0) for n in range(300)] for k in range(8)]
    path = bag(tmp_path, write, [*rows, [("boom", 5.0)]])
    assert any("has too many fields" in loss for loss in read(path).losses)
    assert read(path, "bodies[boom].x").columns["bodies[boom].x"].tolist()[-1] == 5.0
