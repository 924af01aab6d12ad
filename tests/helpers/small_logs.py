"""A small well-formed log of every format and storage: what the fuzzers damage, and what a damaged file is compared with.

Two signals of 12 samples, 0.1 s apart: a ramp and its square. Written by hand where the format is text, else by its library.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pandas as pd
from c3d_writer import Writer, trial
from flight_logs import attitude_dataflash, attitude_ulog
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

ROWS = 12
JOINTS = "sensor_msgs/msg/JointState"


def _joint_states(store: Any) -> list[Any]:
    kinds = store.types
    states = []
    for row in range(ROWS):
        stamp = kinds["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=row * 100_000_000)
        more = {"seq": row} if "seq" in kinds["std_msgs/msg/Header"].__dataclass_fields__ else {}
        header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="base"[: row % 5], **more)
        names = ["boom", "stick"] if row % 3 else ["stick", "boom", "x"]
        values = np.arange(len(names)) + 0.1 * row
        states.append(kinds[JOINTS](header=header, name=names, position=values, velocity=values[:0], effort=values[:1]))
    return states


def _mcap(path: Path, topics: list[tuple[str, str, tuple[str, str, bytes] | None, list[bytes]]], **options: Any) -> None:
    """``topics``: name, message encoding, schema (name, encoding, text), messages."""
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start()
        for topic, encoding, schema, messages in topics:
            number = writer.register_schema(*schema) if schema is not None else 0
            channel = writer.register_channel(topic, encoding, number)
            for row, data in enumerate(messages):
                writer.add_message(channel, log_time=10**18 + row * 10**8, publish_time=10**18 + row * 10**8, data=data)
        writer.finish()


def _protobuf() -> tuple[tuple[str, str, bytes], list[bytes]]:
    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="wire.proto", package="test", syntax="proto3")
    message = file.message_type.add(name="Wire")
    message.field.add(name="length", number=1, type=kind.TYPE_DOUBLE, label=kind.LABEL_OPTIONAL)
    message.field.add(name="raw", number=2, type=kind.TYPE_INT32, label=kind.LABEL_REPEATED)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    wire = message_factory.GetMessageClass(pool.FindMessageTypeByName("test.Wire"))
    schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    return ("test.Wire", "protobuf", schema), [wire(length=0.1 * i, raw=[i, -i]).SerializeToString() for i in range(ROWS)]


def _ros2(path: Path, **options: Any) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    schema = (JOINTS, "ros2msg", store.generate_msgdef(JOINTS, ros_version=2)[0].encode())
    messages = [bytes(store.serialize_cdr(state, JOINTS)) for state in _joint_states(store)]
    _mcap(path, [("/joints", "cdr", schema, messages)], **options)


def _mixed(path: Path) -> None:
    records = [json.dumps({"stamp": {"sec": 1, "nanosec": i}, "q": [0.1 * i, -1], "on": True}).encode() for i in range(ROWS)]
    schema, messages = _protobuf()
    topics = [("/json", "json", None, records), ("/wire", "protobuf", schema, messages)]
    _mcap(path, topics, compression=CompressionType.NONE, use_chunking=False)  # type: ignore[arg-type]


def _bag(path: Path, compression: str | None = None) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = BagWriter(path)
    if compression is not None:
        writer.set_compression(BagWriter.CompressionFormat[compression])
    with writer:
        connection = writer.add_connection("/joints", JOINTS, typestore=store)
        for row, state in enumerate(_joint_states(store)):
            writer.write(connection, 10**18 + row * 10**8, store.serialize_ros1(state, JOINTS))


def _db3(path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA page_size = 512")
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        database.execute("INSERT INTO topics VALUES(1, '/joints', ?, 'cdr')", [JOINTS])
        for row, state in enumerate(_joint_states(store)):
            data = bytes(store.serialize_cdr(state, JOINTS))
            database.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", [row, 10**18 + row * 10**8, data])
    database.close()


def _text(*lines: str) -> Callable[[Path], None]:
    """A writer of these lines."""

    def write(path: Path) -> None:
        path.write_text("\r\n".join([*lines, ""]), encoding="utf-8", newline="")

    return write


def _rows(line: str, separator: str = ",") -> list[str]:
    """``{i}`` is the row, ``{t}`` its time, ``{a}`` and ``{b}`` the two signals."""
    return [line.replace(",", separator).format(i=i, f=i + 1, t=f"{0.1 * i:.6f}", a=10 * i, b=i * i) for i in range(ROWS)]


MOTIVE_1_25 = (
    "Format Version,1.25,Take Name,t,Capture Frame Rate,10.0,Rotation Type,Quaternion,Length Units,Millimeters,"
    "Coordinate Space,Global",
    "",
    ",Type" + ",Rigid Body" * 8 + ",Rigid Body Marker" * 4,
    ",Name" + ",boom" * 8 + ",boom:Marker 001" * 4,
    ",ID" + ",A1" * 8 + ",B2" * 4,
    ",Parent" + "," * 8 + ",boom" * 4,
    "," + ",Rotation" * 4 + ",Position" * 3 + ",Mean Marker Error" + ",Position" * 3 + ",Marker Quality",
    "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,",
    *_rows("{i},{t},0,0,0,1,{a},{b},3,0.1,{b},{a},3,1.0"),
)
MOTIVE_EULER = (
    "Format Version,1.22,Take Name,t,Export Frame Rate,10.0,Rotation Type,XYZ,Coordinate Space,Global",
    "",
    "," + ",Rigid Body" * 7,
    "," + ",boom" * 7,
    "," + ",A1" * 7,
    ",,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error",
    "Frame,Time (Seconds),X,Y,Z,X,Y,Z,",
    *_rows("{i},{t},{a},0,0,{a},{b},3,0.1"),
)
MOTIVE_1_1 = (
    "comment,an export",
    "righthanded",
    "info,version,1.1",
    "info,framecount,12",
    'rigidbody,"boom",7,1,0,0,0,1,0,0,0',
    *_rows("frame,{i},{t},1,7,{a},{b},3,0,0,0,1,0,0,0,1,4,5,{a},11,M1"),
)
TRC = (
    "PathFileType\t4\t(X/Y/Z)\tx.trc",
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate",
    "10.00\t10.00\t12\t2\tmm\t10.00",
    "Frame#\tTime\ttip\t\t\tend\t\t",
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
    "",
    *_rows("{f},{t},{a},{b},3,{b},{a},4", "\t"),
)
VICON = (
    "Trajectories",
    "10",
    ",,crane:tip,,,crane:end,,",
    "Frame,Sub Frame,X,Y,Z,X,Y,Z",
    ",,mm,mm,mm,mm,mm,mm",
    *_rows("{f},0,{a},{b},3,{b},{a},4"),
    "",
    "Devices",
    "20",
    ",,wire,,valve",
    "Frame,Sub Frame,length,rate,u",
    ",,mm,mm/s,V",
    *_rows("{f},0,{a},{b},1"),
    "",
)
QUALISYS_3D = (
    "NO_OF_FRAMES\t12",
    "NO_OF_MARKERS\t2",
    "FREQUENCY\t10",
    "DATA_INCLUDED\t3D",
    "MARKER_NAMES\ttip\tend",
    "Frame\tTime\ttip X\ttip Y\ttip Z\tend X\tend Y\tend Z",
    *_rows("{f},{t},{a},{b},3,{b},{a},4", "\t"),
)
QUALISYS_6D = (
    "NO_OF_FRAMES\t12",
    "NO_OF_BODIES\t1",
    "FREQUENCY\t10",
    "DATA_INCLUDED\t6D",
    "BODY_NAMES\tboom",
    *_rows("{f},{t},{a},{b},3,0,0,0,0.2,1,0,0,0,1,0,0,0,1", "\t"),
)


def _table(path: Path) -> pd.DataFrame:
    return pd.DataFrame({"time": 0.1 * np.arange(ROWS), "ramp [mm]": 10.0 * np.arange(ROWS), "square": np.arange(ROWS) ** 2})


def _mat(**options: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        content: dict[str, Any] = {"t": 0.1 * np.arange(ROWS), "u": np.arange(ROWS)}
        if options.get("format") != "4":
            content |= {"log": {"ramp": 10.0 * np.arange(ROWS), "text": "abc"}, "q": np.ones((ROWS, 2)), "none": np.zeros(0)}
        savemat(path, content, **options)

    return write


def _c3d(processor: str, integers: bool) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        points, analog = trial(ROWS)
        path.write_bytes(Writer(processor, integers).file(points, analog, {"ANALOG:SCALE": (2, 3), "ANALOG:OFFSET": (10, -20)}))

    return write


def _can(path: Path) -> None:
    with can.Logger(path) as log:  # type: ignore[attr-defined]
        for row in range(ROWS):
            for identifier, extended in ((0x120, False), (0x18FF1027, True)):
                data = bytes([row, 2 * row, 3, 0, 255, row, 0, 1])
                stamp = 1.7e9 + 0.1 * row
                log(can.Message(timestamp=stamp, arbitration_id=identifier, is_extended_id=extended, data=data, channel=0))


def _mf4(path: Path) -> None:
    from asammdf import MDF, Signal

    seconds = 0.1 * np.arange(ROWS)
    with MDF() as mdf:
        mdf.append([Signal(10.0 * np.arange(ROWS), seconds, name="ramp", unit="mm")], acq_name="wires")
        mdf.save(path, overwrite=True)


def _json(path: Path) -> None:
    path.write_text(json.dumps({"gain": 2, "log": [{"time": 0.1 * i, "q": [10 * i, i * i], "on": True} for i in range(ROWS)]}))


def _npz(path: Path) -> None:
    np.savez(path, time=0.1 * np.arange(ROWS), ramp=10.0 * np.arange(ROWS), q=np.ones((ROWS, 2)), name="abc")


#: File name → (reader, how it is written).
LOGS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "plain.mcap": ("mcap", lambda path: _ros2(path, compression=CompressionType.NONE, chunk_size=400)),
    "zstd.mcap": ("mcap", lambda path: _ros2(path, compression=CompressionType.ZSTD)),
    "lz4.mcap": ("mcap", lambda path: _ros2(path, compression=CompressionType.LZ4)),
    "mixed.mcap": ("mcap", _mixed),
    "plain.bag": ("rosbag1", _bag),
    "bz2.bag": ("rosbag1", lambda path: _bag(path, "BZ2")),
    "lz4.bag": ("rosbag1", lambda path: _bag(path, "LZ4")),
    "log.db3": ("rosbag2", _db3),
    "motive_1_25.csv": ("motive", _text(*MOTIVE_1_25)),
    "motive_euler.csv": ("motive", _text(*MOTIVE_EULER)),
    "motive_1_1.csv": ("motive", _text(*MOTIVE_1_1)),
    "log.trc": ("trc", _text(*TRC)),
    "vicon.csv": ("vicon", _text(*VICON)),
    "qualisys_3d.tsv": ("qualisys", _text(*QUALISYS_3D)),
    "qualisys_6d.tsv": ("qualisys", _text(*QUALISYS_6D)),
    "floats.c3d": ("c3d", _c3d("intel", False)),
    "dec.c3d": ("c3d", _c3d("dec", True)),
    "mips.c3d": ("c3d", _c3d("mips", False)),
    "log.blf": ("can", _can),
    "log.asc": ("can", _can),
    "peak.trc": ("can", _can),
    "candump.log": ("can", _can),
    "log.mf4": ("mf4", _mf4),
    "flight.ulg": ("ulog", lambda path: path.write_bytes(attitude_ulog(ROWS)) and None),
    "flight.bin": ("ardupilot", lambda path: path.write_bytes(attitude_dataflash(ROWS)) and None),
    "table.csv": ("csv", lambda path: _table(path).to_csv(path, index=False)),
    "table.parquet": ("parquet", lambda path: _table(path).to_parquet(path)),
    "plain.mat": ("mat", _mat()),
    "packed.mat": ("mat", _mat(do_compression=True)),
    "old.mat": ("mat", _mat(format="4")),
    "records.json": ("json", _json),
    "arrays.npz": ("npz", _npz),
}


def write_log(folder: Path, name: str) -> Path:
    """The log called ``name``, one of :data:`LOGS`."""
    path = folder / name
    LOGS[name][1](path)
    return path


#: What a recipe has to state for the logs of a reader that do not say it themselves.
STATED: dict[str, dict[str, str]] = {"motive_1_1.csv": {"length_unit": "m"}, "motive_euler.csv": {"length_unit": "mm"}}
