"""ROS 1 bags and rosbag2 in sqlite: against the deserialiser of the library, real bags, damage."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from sysid.datasets.discover import discover
from sysid.datasets.plan import sources_of
from sysid.datasets.recipe import NO_RECIPE
from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream
from sysid.logs.limits import Budget
from sysid.logs.rosbag import Ros1Reader, Rosbag2Reader

JOINTS = "sensor_msgs/msg/JointState"


def read(path: Path, **options: Any) -> tuple[Stream, ...]:
    reader = Ros1Reader() if path.suffix == ".bag" else Rosbag2Reader()
    return reader.read(path, ReadOptions(**options))


def flatten(value: Any, path: str, into: dict[str, float]) -> None:
    """Numbers of a deserialised message by their path."""
    if isinstance(value, np.ndarray | list):
        for index, item in enumerate(value if len(value) <= 512 else []):
            flatten(item, f"{path}[{index}]", into)
    elif hasattr(value, "__dataclass_fields__"):
        for name in value.__dataclass_fields__:
            if not name.startswith("__"):
                flatten(getattr(value, name), f"{path}.{name}" if path else name, into)
    elif isinstance(value, int | float | np.number | np.bool_):
        into[path] = float(value)


def assert_like_library(path: Path) -> int:
    streams = {stream.name: stream for stream in read(path)}
    compared = 0
    with AnyReader([path]) as reader:
        rows: dict[str, list[dict[str, float]]] = {}
        stamps: dict[str, list[int]] = {}
        for connection, stamp, data in reader.messages():
            flat: dict[str, float] = {}
            flatten(reader.deserialize(data, connection.msgtype), "", flat)
            rows.setdefault(connection.topic, []).append(flat)
            stamps.setdefault(connection.topic, []).append(stamp)
    assert streams.keys() == rows.keys()
    for topic, expected in rows.items():
        np.testing.assert_array_equal(streams[topic].stamps["log"], stamps[topic])
        for column in {key for row in expected for key in row}:
            want = [row.get(column, np.nan) for row in expected]
            np.testing.assert_array_equal(streams[topic].columns[column], want, err_msg=column)
            compared += len(want)
    return compared


@pytest.mark.parametrize(
    ("name", "cells"), [("rigid_body_motion_ros1.bag", 20_000), ("fake_joint_state.bag", 30_000), ("tf_example.db3", 3_000)]
)
def test_real_bags_are_read_as_the_library_reads_them(shared_data: Path, name: str, cells: int) -> None:
    assert assert_like_library(shared_data / "mcap_bags" / name) > cells


def joint_states(store: Any, count: int) -> list[Any]:
    types = store.types
    states = []
    for index in range(count):
        names = ["boom", "stick"] if index % 3 else ["stick", "boom"]
        header = types["std_msgs/msg/Header"](
            **({"seq": index} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}),
            stamp=types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + index, nanosec=index),
            frame_id="x" * (index % 2),
        )
        numbers = np.array([1.0 * index, -1.0 * index])
        states.append(types[JOINTS](header=header, name=names, position=numbers, velocity=numbers[:0], effort=numbers[:0]))
    return states


@pytest.mark.parametrize("compression", [None, "bz2", "lz4"])
def test_ros1_bags_with_every_compression(tmp_path: Path, compression: str | None) -> None:
    path = tmp_path / "log.bag"
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        connection = writer.add_connection("/joints", JOINTS, typestore=store)
        for index, state in enumerate(joint_states(store, 40)):
            writer.write(connection, 5_000_000_000 + index, store.serialize_ros1(state, JOINTS))
    assert assert_like_library(path) > 40 * 4
    (stream,) = read(path, streams=frozenset({"/joints"}), fields={"/joints": frozenset({"position[boom]"})})
    np.testing.assert_array_equal(stream.columns["position[boom]"], [i if i % 3 else -i for i in range(40)])
    np.testing.assert_array_equal(stream.stamps["header"], [(1_700_000_000 + i) * 10**9 + i for i in range(40)])
    np.testing.assert_array_equal(stream.stamps["log"], 5_000_000_000 + np.arange(40))


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_rosbag2_in_sqlite(tmp_path: Path, version: int, mode: CompressionMode) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer2(tmp_path / "bag", version=version)  # type: ignore[arg-type]
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joints", JOINTS, typestore=store)
        for index, state in enumerate(joint_states(store, 40)):
            writer.write(connection, 5 + index, store.serialize_cdr(state, JOINTS))
    (path,) = (tmp_path / "bag").glob("*.db3")
    (stream,) = read(path)
    np.testing.assert_array_equal(stream.columns["position[boom]"], [i if i % 3 else -i for i in range(40)])
    np.testing.assert_array_equal(stream.stamps["log"], 5 + np.arange(40))
    assert stream.losses == ()
    assert stream.kind == JOINTS


def old_bag(path: Path, kind: str) -> None:
    """As rosbag2 wrote them before it stored definitions."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        database.execute("INSERT INTO topics VALUES(1, '/joints', ?, 'cdr')", [kind])
        for index, state in enumerate(joint_states(store, 3)):
            data = bytes(store.serialize_cdr(state, JOINTS))
            database.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", [index, index, data])
    database.close()


def test_old_bags_without_definitions(tmp_path: Path) -> None:
    path = tmp_path / "old.db3"
    old_bag(path, JOINTS)
    (stream,) = read(path)
    np.testing.assert_array_equal(stream.columns["position[stick]"], [0.0, -1.0, -2.0])
    old_bag(tmp_path / "own.db3", "my_msgs/msg/Valve")
    with pytest.raises(InputError, match=r"own\.db3: /joints: messages of type 'my_msgs/msg/Valve' without definition"):
        read(tmp_path / "own.db3", streams=frozenset({"/joints"}))


def test_what_is_no_bag_is_named(tmp_path: Path, shared_data: Path) -> None:
    for name, text, message in (
        ("a.bag", b"\x89MCAP0\r\n", r"a\.bag: starts with .*expected '#ROSBAG V2\.0'"),
        ("b.bag", b"#ROSBAG V2.0\n" + bytes(30), r"b\.bag: not readable as a ROS 1 bag"),
        ("c.db3", b"SQLite format 3\0" + bytes(200), r"c\.db3: not readable as rosbag2"),
        ("d.db3", b"nothing", r"d\.db3: not readable as rosbag2"),
        ("e.db3.zstd", b"x", r"a file compressed as a whole; .*zstd -d e\.db3\.zstd"),
        ("f.bag", b"", "the file is empty"),
    ):
        (tmp_path / name).write_bytes(text)
        with pytest.raises(InputError, match=message):
            read(tmp_path / name)
    with pytest.raises(InputError, match=r"no topic '/tff'; expected '/tf'\?"):
        read(shared_data / "mcap_bags/tf_example.db3", streams=frozenset({"/tff"}))


def test_a_bag_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.bag"
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    writer.set_compression(Writer1.CompressionFormat.BZ2)
    with writer:
        connection = writer.add_connection("/joints", JOINTS, typestore=store)
        for index, state in enumerate(joint_states(store, 100)):
            writer.write(connection, index, store.serialize_ros1(state, JOINTS))
    allowed = Budget.of(path.stat().st_size)
    for budget, said in (
        (replace(allowed, chunk=1000), "a chunk unpacks to more than 0 MiB"),
        (replace(allowed, unpacked=1000), "chunks that unpack to more than 0 MiB"),
    ):
        options = ReadOptions(budget=budget)
        with pytest.raises(InputError, match=rf"damaged \({said}"):
            Ros1Reader().read(path, options)


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_to_a_bag_ends_in_streams_or_a_reason(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "log.bag"
    store = get_typestore(Stores.ROS1_NOETIC)
    path.unlink(missing_ok=True)
    with Writer1(path) as writer:
        connection = writer.add_connection("/joints", JOINTS, typestore=store)
        for index, state in enumerate(joint_states(store, 5)):
            writer.write(connection, index, store.serialize_ros1(state, JOINTS))
    damaged = bytearray(path.read_bytes())
    spots = [at for at in range(len(damaged)) if damaged[at] != 0x20]  # not the padding of the header
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.sampled_from(spots))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(13, len(damaged))) :]
    path.write_bytes(bytes(damaged))
    streams, refusal = attempt(InputError, lambda: read(path))
    assert streams is not None or "log.bag" in refusal


def recorder_killed(folder: Path, mode: str, kept: int, total: int) -> Path:
    """A bag whose recorder was killed: ``kept`` messages are in the file, the others in the write-ahead log or the journal."""
    folder.mkdir()
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = folder / "live.db3"
    old_bag(path, JOINTS)
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("DELETE FROM messages")
        database.execute(f"PRAGMA journal_mode={mode}")
        database.execute("PRAGMA wal_autocheckpoint=0")
        database.execute("PRAGMA cache_size=1")  # pages go to the file before the transaction ends
        for index, state in enumerate(joint_states(store, total)):
            if index == kept:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                database.execute("BEGIN")
            data = bytes(store.serialize_cdr(state, JOINTS))
            database.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", [index, index, data])
        if mode == "WAL":
            database.execute("COMMIT")
        copy = folder / "killed" / "bag_0.db3"
        copy.parent.mkdir()
        for name in ("live.db3", "live.db3-wal", "live.db3-journal"):
            if (folder / name).exists():
                (copy.parent / name.replace("live", "bag_0")).write_bytes((folder / name).read_bytes())
    return copy


def test_messages_in_the_write_ahead_log_are_read_and_nothing_is_changed(tmp_path: Path) -> None:
    path = recorder_killed(tmp_path / "bag", "WAL", 100, 300)
    before = {file: file.read_bytes() for file in path.parent.iterdir()}
    assert len(before) == 2
    (stream,) = read(path)
    np.testing.assert_array_equal(stream.stamps["log"], np.arange(300))
    assert {file: file.read_bytes() for file in path.parent.iterdir()} == before
    log = Path(f"{path}-wal")
    for end in (len(before[log]) // 2, 40, 0):  # torn where the recorder died: whole transactions remain
        log.write_bytes(before[log][:end])
        np.testing.assert_array_equal(read(path)[0].stamps["log"], np.arange(100))
    log.unlink()
    log.symlink_to(path)
    with pytest.raises(InputError, match=r"bag_0\.db3-wal: a link; expected the write-ahead log"):
        read(path)


def test_an_interrupted_transaction_is_refused_with_a_remedy_that_works(tmp_path: Path) -> None:
    path = recorder_killed(tmp_path / "bag", "DELETE", 100, 300)
    with pytest.raises(InputError, match=r'a transaction that was interrupted .*sqlite3 bag_0\.db3 "PRAGMA integrity_check"'):
        read(path)
    with contextlib.closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    np.testing.assert_array_equal(read(path)[0].stamps["log"], np.arange(100))


def test_the_write_ahead_log_is_part_of_the_content(tmp_path: Path) -> None:
    path = recorder_killed(tmp_path / "bag", "WAL", 100, 300)
    (found,) = discover([path.parent], NO_RECIPE)
    assert {source.path for source in sources_of([found])} == {"killed/bag_0.db3", "killed/bag_0.db3-wal"}
    Path(f"{path}-wal").write_bytes(b"")
    with pytest.raises(InputError, match=r"bag_0\.db3-wal: written while it was read"):
        found.check_unchanged()
