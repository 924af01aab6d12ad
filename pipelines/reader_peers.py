"""Every reader beside the library of its format, on random valid files: which values differ, and why.

    .venv/bin/python pipelines/reader_peers.py --count 1000

writes the table of ``reports/formats/``. Each file is written by the library of its format (logs of autopilots and databases by
their published descriptions) and read by both; every number and every stamp is compared. Where the reader has no value and the
library has one, a rule of the reader has to say so. LeRobot needs older packages: ``make reader-peers`` installs the release of
each layout in an environment of its own, where ``lerobot_sets.py`` writes and reads.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import json
import os
import re
import struct
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from committed import markdown, write_tables
from sysid.logs import ReadOptions, Stream, reader_for, reader_named
from sysid.logs.lerobot import data_files, episode_name

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "reports" / "formats" / "README.md"
Array = npt.NDArray[np.float64]
#: Stamps agree to this [s]: libraries give them as floats in seconds.
STAMP_S = 2e-6


@dataclass
class Comparison:
    """What was compared of one format.

    ``by_rule``: reason → number of values that a rule of the reader takes for missing, or that the library rounds.
    """

    files: int = 0
    values: int = 0
    by_rule: dict[str, int] = field(default_factory=dict)
    differences: list[str] = field(default_factory=list)

    def column(self, what: str, ours: Array, theirs: Array, rules: dict[str, npt.NDArray[np.bool_]] | None = None) -> None:
        """Compare a column; ``rules``: reason → mask of the values that it makes missing."""
        theirs = np.array(theirs, dtype=np.float64)
        if len(ours) != len(theirs):
            self.differences.append(f"{what}: {len(ours)} values instead of {len(theirs)}")
            return
        self.values += len(theirs)
        for reason, mask in (rules or {}).items():
            hit = mask & np.isfinite(theirs)
            if hit.any():
                self.by_rule[reason] = self.by_rule.get(reason, 0) + int(np.count_nonzero(hit))
                theirs[hit] = np.nan
        same = np.isclose(ours, theirs, rtol=1e-12, atol=0.0, equal_nan=True)
        if not same.all():
            row = int(np.flatnonzero(~same)[0])
            self.differences.append(f"{what}: {ours[row]!r} instead of {theirs[row]!r} in row {row}")

    def names(self, what: str, ours: Iterable[str], theirs: Iterable[str]) -> None:
        """Compare names of streams or columns."""
        if set(ours) != set(theirs):
            self.differences.append(f"{what}: {sorted(set(ours) ^ set(theirs))} in one alone")

    def stamps(self, what: str, stream: Stream, seconds: Sequence[float] | Array) -> None:
        """Compare stamps, counted from the first: not every library keeps the start of a log."""
        ours = next(iter(stream.stamps.values()))
        theirs = np.asarray(seconds, dtype=np.float64)
        if len(ours) != len(theirs):
            self.differences.append(f"{what}: {len(ours)} stamps instead of {len(theirs)}")
            return
        self.values += len(theirs)
        apart = np.abs((ours - ours[0]) * 1e-9 - (theirs - theirs[0]))
        if apart.max() > STAMP_S:
            self.differences.append(f"{what}: a stamp {apart.max():.3g} s off")


def streams_of(path: Path, **options: Any) -> dict[str, Stream]:
    reader = reader_named("can", path) if path.suffix == ".log" else reader_for(path)
    return {stream.name: stream for stream in reader.read(path, ReadOptions(**options))}


# -- motion capture -------------------------------------------------------------------------------------------------


def c3d(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """C3D with ezc3d: markers that are lost now and then, analog channels at a multiple of the rate."""
    import ezc3d

    markers, frames, each = int(rng.integers(1, 5)), int(rng.integers(1, 30)), int(rng.integers(1, 5))
    channels = int(rng.integers(0, 4))
    file = ezc3d.c3d()
    rate = float(rng.choice([50.0, 100.0, 120.0, 1000.0]))
    points = rng.normal(0.0, 1000.0, (3, markers, frames))
    points[:, rng.random((markers, frames)) < 0.1] = np.nan
    points[:, rng.random((markers, frames)) < 0.05] = 0.0
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    file["parameters"]["POINT"]["UNITS"]["value"] = [str(rng.choice(["mm", "m", "cm"]))]
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"body:M{i}" for i in range(markers)]
    file["data"]["points"] = np.vstack([points, np.ones((1, markers, frames))])
    if channels:
        file["parameters"]["ANALOG"]["RATE"]["value"] = [rate * each]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = [f"V{i}" for i in range(channels)]
        file["data"]["analogs"] = rng.normal(0.0, 5.0, (1, channels, frames * each))
    path = folder / "trial.c3d"
    file.write(str(path))
    theirs = ezc3d.c3d(str(path))
    factor = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[theirs["parameters"]["POINT"]["UNITS"]["value"][0]]
    streams = streams_of(path)
    found.names("points", set(streams) - {"analog"}, theirs["parameters"]["POINT"]["LABELS"]["value"])
    for number, name in enumerate(theirs["parameters"]["POINT"]["LABELS"]["value"]):
        own = theirs["data"]["points"][:3, number]
        zero = {"a marker exactly in the origin is lost": (own == 0.0).all(axis=0)}
        for index, axis in enumerate("xyz"):
            found.column(f"{name}.{axis}", streams[name].columns[axis], own[index] * factor, zero)
        found.stamps(name, streams[name], np.arange(frames) / rate)
    for number in range(channels):
        found.column(f"V{number}", streams["analog"].columns[f"V{number}"], theirs["data"]["analogs"][0, number])


# -- CAN ------------------------------------------------------------------------------------------------------------


def database_text(rng: np.random.Generator) -> str:
    """A random DBC: integers and floats in both byte orders, multiplexers, stated ranges, messages of J1939."""
    text = 'VERSION ""\nBS_:\nBU_: ECU\n'
    tail = 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    tail += 'BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";\n'
    for number in range(int(rng.integers(1, 4))):
        extended, big, mux = (bool(flag) for flag in rng.random(3) < (0.5, 0.5, 0.3))
        identifier = (0x80000000 | 0x18FE0000 | number << 8) if extended else 0x100 + number
        text += f"BO_ {identifier} M{number}: 8 ECU\n"
        if extended and rng.random() < 0.5:
            tail += f'BA_ "VFrameFormat" BO_ {identifier} 3;\n'
        groups = ["m0 ", "m1 "] if mux else [""]
        text += f' SG_ switch M : {7 if big else 0}|8@{0 if big else 1}+ (1,0) [0|0] "" ECU\n' if mux else ""
        for group in groups:
            bit = 8 if mux else 0
            while bit < 60:
                is_float = rng.random() < 0.1 and bit + 32 <= 64
                length = 32 if is_float else min(int(rng.integers(1, 33)), 64 - bit)
                start = 8 * (bit // 8) + 7 - bit % 8 if big else bit
                signed = bool(rng.random() < 0.3)
                scale, offset = (1, 0) if is_float else (rng.choice([1, 0.5, 0.01, -2.0]), rng.choice([0, -40.0]))
                high = rng.choice([0, 100, 2**length - 1])
                name = f"s{bit}{group.strip()}"
                place = f"{start}|{length}@{0 if big else 1}{'-' if signed or is_float else '+'}"
                text += f' SG_ {name} {group}: {place} ({scale},{offset}) [0|{high}] "mm" ECU\n'
                tail += f"SIG_VALTYPE_ {identifier} {name} : 1;\n" if is_float else ""
                bit += length + int(rng.integers(0, 4))
    return text + tail


def no_value(raw: int, signal: Any, j1939: bool, value: float) -> str:
    """Why a raw value is none by the rules of the reader, written a second time; empty where it is one."""
    ones = raw == 2**signal.length - 1
    if signal.is_signed or signal.conversion.is_float or signal.length < 2:
        return ""
    if j1939:
        if signal.length == 2:
            return "no value by SAE J1939-71" if raw >= 2 else ""
        if signal.length in (8, 16, 24, 32):
            return "no value by SAE J1939-71" if raw >> (signal.length - 8) > 0xFA else ""
        return "no value by SAE J1939-71" if ones else ""
    stated = signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum
    half = 0.5 * abs(signal.conversion.scale)
    outside = stated and not signal.minimum - half <= value <= signal.maximum + half
    return "all bits one, outside of the range in the DBC" if ones and outside else ""


def can_log(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """BLF, ASC, PEAK, candump and MDF logs of a bus with python-can and cantools, frame by frame."""
    import can
    import cantools

    dbc = folder / "bus.dbc"
    dbc.write_text(database_text(rng))
    database: Any = cantools.database.load_file(dbc, strict=False)
    path = folder / f"bus{rng.choice(['.blf', '.asc', '.trc', '.log', '.mf4'])}"
    with can.Logger(path) as log:  # type: ignore[attr-defined]
        for row in range(int(rng.integers(1, 40))):
            message = database.messages[int(rng.integers(len(database.messages)))]
            data = bytearray(rng.bytes(8 if rng.random() < 0.9 else int(rng.integers(0, 9))))
            if rng.random() < 0.3:
                data = bytearray(b"\xff" * len(data))
            if message.is_multiplexed() and data:
                data[0] = int(rng.integers(0, 3))
            log.on_message_received(
                can.Message(
                    timestamp=1.7e9 + 0.01 * row, arbitration_id=message.frame_id, is_extended_id=message.is_extended_frame,
                    data=bytes(data), channel=0,
                )
            )  # fmt: skip
    with contextlib.redirect_stderr(io.StringIO()), path.open("rb") as file:
        # The library leaves a file that it opens itself open.
        frames = list(can.MF4Reader(file) if path.suffix == ".mf4" else can.LogReader(path))
    streams = streams_of(path, dbc=dbc)
    for message in database.messages:
        own = [frame for frame in frames if frame.arbitration_id == message.frame_id]
        for signal in message.signals if own else ():
            selected = own
            name = message.name
            if signal.multiplexer_ids:
                selected = [frame for frame in own if frame.data and frame.data[0] in signal.multiplexer_ids]
                name = f"{name}[switch={signal.multiplexer_ids[0]}]"
            if not selected:
                if name in streams:
                    found.differences.append(f"{name}: a stream without frames")
                continue
            values, reasons = [], []
            for frame in selected:
                try:
                    decoded = message.decode(frame.data, decode_choices=False, allow_truncated=True)
                    raws = message.decode(frame.data, decode_choices=False, allow_truncated=True, scaling=False)
                except Exception:  # a multiplexer that selects nothing: its own value is decoded without the rest
                    decoded = raws = {"switch": frame.data[0]} if frame.data else {}
                values.append(float(decoded.get(signal.name, np.nan)))
                raw = raws.get(signal.name)
                reasons.append(
                    no_value(int(raw), signal, message.protocol == "j1939", values[-1]) if isinstance(raw, int) else ""
                )
            rules = {reason: np.array([other == reason for other in reasons]) for reason in set(reasons) - {""}}
            found.column(f"{name}.{signal.name}", streams[name].columns[signal.name], np.array(values), rules)
            found.stamps(name, streams[name], [frame.timestamp for frame in selected])


# -- measurements ---------------------------------------------------------------------------------------------------


def mf4(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """MDF 4 with asammdf: types, linear conversions, invalid samples, packed data, versions of the format."""
    from asammdf import MDF, Signal
    from asammdf.blocks.conversion_utils import from_dict

    version = str(rng.choice(["4.00", "4.10", "4.11", "4.20"]))
    path = folder / "run.mf4"
    with MDF(version=version) as mdf:
        for group in range(int(rng.integers(1, 4))):
            rows = int(rng.integers(1, 40))
            time = np.cumsum(rng.uniform(0.001, 0.02, rows))
            signals = []
            for number in range(int(rng.integers(1, 5))):
                kind = str(rng.choice(["u1", "i2", "u4", "i8", "f4", "f8"]))
                samples = (rng.normal(0.0, 50.0, rows)).astype("<f8")
                samples = np.abs(samples).astype(f"<{kind}") if kind[0] == "u" else samples.astype(f"<{kind}")
                conversion = from_dict({"a": 0.5, "b": -3.0}) if rng.random() < 0.3 else None
                marks = rng.random(rows) < 0.2 if rng.random() < 0.3 else None
                signals.append(
                    Signal(samples, time, name=f"c{number}", unit="mm", conversion=conversion, invalidation_bits=marks)
                )
            mdf.append(signals, acq_name=f"g{group}", common_timebase=True)
        mdf.save(path, overwrite=True, compression=int(rng.integers(0, 3)))
    streams = streams_of(path)
    with MDF(path) as mdf:
        found.names("groups", streams, [group.channel_group.acq_name for group in mdf.groups])
        for group, stream in enumerate(streams.values()):
            channels = [channel.name for channel in mdf.groups[group].channels if channel.channel_type not in (2, 3)]
            found.names(f"g{group}", stream.columns, channels)
            for name, values in stream.columns.items():
                theirs = mdf.get(name, group=group, ignore_invalidation_bits=True)
                marks = theirs.invalidation_bits
                rules = {"marked invalid in the file": np.asarray(marks, dtype=bool)} if marks is not None else None
                found.column(f"g{group}.{name}", values, theirs.samples, rules)
                found.stamps(f"g{group}", stream, theirs.timestamps)


def parquet(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """Parquet with pyarrow: types, missing values, row groups, compression."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = int(rng.integers(2, 60))
    columns = {"time": pa.array(np.cumsum(rng.uniform(0.001, 0.02, rows)))}
    for number in range(int(rng.integers(1, 5))):
        kind = str(rng.choice(["int8", "uint16", "int32", "float32", "float64"]))
        columns[f"c{number}"] = pa.array(rng.uniform(0.0, 100.0, rows).astype(kind), mask=rng.random(rows) < 0.2)
    path = folder / "table.parquet"
    pq.write_table(
        pa.table(columns),
        path,
        row_group_size=int(rng.integers(1, rows + 1)),
        compression=str(rng.choice(["none", "zstd", "snappy"])),
    )
    (stream,) = streams_of(path).values()
    theirs = pq.read_table(path)
    found.names("columns", {"time", *stream.columns}, theirs.column_names)
    for name, values in stream.columns.items():
        found.column(name, values, np.array([np.nan if value is None else value for value in theirs[name].to_pylist()]))
    found.stamps("time", stream, theirs["time"].to_numpy())


# -- flight logs ----------------------------------------------------------------------------------------------------

ULOG = {
    "int8_t": "b",
    "uint8_t": "B",
    "int16_t": "h",
    "uint32_t": "I",
    "int64_t": "q",
    "float": "f",
    "double": "d",
    "bool": "?",
}


def ulog(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """ULog of PX4 with pyulog: arrays, instances of a topic."""
    from pyulog import ULog

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<Hc", len(body), kind.encode()) + body

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message("B", bytes(40))
    layouts = []
    for topic in range(int(rng.integers(1, 4))):
        fields = [(str(rng.choice(list(ULOG))), int(rng.integers(0, 4))) for _ in range(int(rng.integers(1, 5)))]
        text = "".join(f"{kind}{f'[{size}]' if size else ''} f{i};" for i, (kind, size) in enumerate(fields))
        data += message("F", f"topic{topic}:uint64_t timestamp;{text}".encode())
        layouts.append("<" + "".join(ULOG[kind] * max(size, 1) for kind, size in fields))
    topics = [(int(rng.integers(len(layouts))), instance) for instance in range(3)]
    for number, (topic, instance) in enumerate(topics):
        data += message("A", struct.pack("<BH", instance, number) + f"topic{topic}".encode())
    for row in range(int(rng.integers(1, 40))):
        number = int(rng.integers(len(topics)))
        data += message(
            "D", struct.pack("<HQ", number, 5000 + 10 * row) + rng.bytes(struct.calcsize(layouts[topics[number][0]]))
        )
    path = folder / "flight.ulg"
    path.write_bytes(data)
    streams = streams_of(path)
    for theirs in ULog(str(path)).data_list:
        name = f"{theirs.name}#{theirs.multi_id}" if theirs.multi_id else theirs.name
        found.names(name, {"timestamp", *streams[name].columns}, theirs.data)
        for key, values in streams[name].columns.items():
            with np.errstate(invalid="ignore"):  # a signalling NaN
                numbers = theirs.data[key].astype(np.float64)
            found.column(f"{name}.{key}", values, numbers)
        found.stamps(name, streams[name], theirs.data["timestamp"] * 1e-6)


DATAFLASH = {
    "b": "b",
    "B": "B",
    "h": "h",
    "H": "H",
    "i": "i",
    "I": "I",
    "f": "f",
    "d": "d",
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
    "Q": "Q",
}


def dataflash(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """DataFlash of ArduPilot with pymavlink, message by message."""
    from pymavlink.DFReader import DFReader_binary

    def described(kind: int, letters: str, name: str, columns: str, size: int) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name.encode(), letters.encode(), columns.encode())

    data = described(0x80, "BBnNZ", "FMT", "Type,Length,Name,Format,Columns", 89)
    layouts = []
    for kind in range(1, int(rng.integers(2, 5))):
        letters = "".join(rng.choice(list(DATAFLASH), int(rng.integers(1, 8))))
        layout = "<" + "".join(DATAFLASH[letter] for letter in letters)
        columns = ",".join(["TimeUS", *(f"F{i}" for i in range(len(letters)))])
        data += described(kind, f"Q{letters}", f"T{kind}", columns, 11 + struct.calcsize(layout))
        layouts.append(layout)
    for row in range(int(rng.integers(1, 40))):
        kind = int(rng.integers(len(layouts)))
        data += struct.pack("<BBBQ", 0xA3, 0x95, kind + 1, 1000 * row) + rng.bytes(struct.calcsize(layouts[kind]))
    path = folder / "flight.bin"
    path.write_bytes(data)
    streams = streams_of(path)
    with contextlib.redirect_stderr(io.StringIO()), DFReader_binary(str(path)) as log:
        messages = [message for message in iter(log.recv_msg, None) if message.get_type() != "FMT"]
    found.names("types", streams, {message.get_type() for message in messages})
    for name, stream in streams.items():
        own = [message for message in messages if message.get_type() == name]
        found.names(name, {"TimeUS", *stream.columns}, own[0].get_fieldnames())
        for key, values in stream.columns.items():
            found.column(f"{name}.{key}", values, np.array([float(getattr(message, key)) for message in own]))
        found.stamps(name, stream, [message.TimeUS * 1e-6 for message in own])


# -- ROS ------------------------------------------------------------------------------------------------------------

ROS = {"bool": "?", "int8": "i1", "uint8": "u1", "int16": "i2", "uint32": "u4", "int64": "i8", "float32": "f4", "float64": "f8"}


def ros_definition(rng: np.random.Generator) -> tuple[str, list[tuple[str, str]]]:
    """A random message: its text, and (name, type) of its fields; ``[3]`` fixed and ``[]`` free arrays, texts."""
    fields = []
    for number in range(int(rng.integers(1, 7))):
        kind = str(rng.choice([*ROS, "string"]))
        fields.append((f"f{number}", kind + ("" if kind == "string" else str(rng.choice(["", "", "[3]", "[]"])))))
    return "".join(f"{kind} {name}\n" for name, kind in fields), fields


def ros_message(rng: np.random.Generator, store: Any, kind: str, fields: Sequence[tuple[str, str]]) -> Any:
    values: dict[str, Any] = {}
    for name, declared in fields:
        base, _, size = declared.partition("[")
        if base == "string":
            values[name] = "x" * int(rng.integers(0, 6))
            continue
        count = 1 if not size else 3 if size == "3]" else int(rng.integers(0, 4))
        numbers = rng.integers(0, 2, count) > 0 if base == "bool" else rng.integers(0, 100, count).astype(ROS[base])
        values[name] = numbers if size else numbers[0].item()
    return store.types[kind](**values)


def at(message: Any, path: str) -> float:
    """The number at ``f1`` or ``f1[2]`` of a decoded message; NaN where it is shorter."""
    name, _, index = path.partition("[")
    value = getattr(message, name)
    return float(value) if not index else float(value[int(index[:-1])]) if int(index[:-1]) < len(value) else float("nan")


def numbers_in(message: Any, fields: Sequence[tuple[str, str]]) -> set[str]:
    """Paths of the numbers of a decoded message."""
    paths: set[str] = set()
    for name, declared in fields:
        if declared != "string":
            paths |= {f"{name}[{i}]" for i in range(len(getattr(message, name)))} if "[" in declared else {name}
    return paths


def ros_store(rng: np.random.Generator, stores: str) -> tuple[Any, str, str, list[tuple[str, str]]]:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    text, fields = ros_definition(rng)
    store = get_typestore(Stores[stores])
    store.register(get_types_from_msg(text, "peers_msgs/msg/Any"))
    return store, "peers_msgs/msg/Any", text, fields


def ros_messages(path: Path, fields: Sequence[tuple[str, str]], theirs: Sequence[tuple[int, Any]], found: Comparison) -> None:
    """Compare the only topic of a log with (stamp [ns], decoded message) of another library."""
    stream = streams_of(path)["/any"]
    found.names("/any", stream.columns, set().union(*(numbers_in(message, fields) for _, message in theirs)))
    for name, values in stream.columns.items():
        found.column(name, values, np.array([at(message, name) for _, message in theirs]))
    found.stamps("/any", stream, np.array([stamp - 10**18 for stamp, _ in theirs]) * 1e-9)


def mcap(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """MCAP with ROS 2 messages of random types, with mcap-ros2-support."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer
    from mcap_ros2.decoder import DecoderFactory

    store, kind, text, fields = ros_store(rng, "ROS2_HUMBLE")
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[str(rng.choice(["NONE", "LZ4", "ZSTD"]))], chunk_size=200)
        writer.start()
        channel = writer.register_channel("/any", "cdr", writer.register_schema(kind, "ros2msg", text.encode()))
        for row in range(int(rng.integers(1, 30))):
            body = bytes(store.serialize_cdr(ros_message(rng, store, kind, fields), kind))
            writer.add_message(channel, log_time=10**18 + row * 10**7, publish_time=0, data=body)
        writer.finish()
    with path.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        theirs = [(each.message.log_time, each.decoded_message) for each in decoded]
    ros_messages(path, fields, theirs, found)


def ros1(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """ROS 1 bags of random message types with rosbags."""
    from rosbags.rosbag1 import Reader, Writer

    store, kind, _, fields = ros_store(rng, "ROS1_NOETIC")
    path = folder / "log.bag"
    path.unlink(missing_ok=True)
    writer = Writer(path)
    if (packed := str(rng.choice(["", "BZ2", "LZ4"]))) != "":
        writer.set_compression(Writer.CompressionFormat[packed])
    with writer:
        connection = writer.add_connection("/any", kind, typestore=store)
        for row in range(int(rng.integers(1, 30))):
            writer.write(connection, 10**18 + row * 10**7, store.serialize_ros1(ros_message(rng, store, kind, fields), kind))
    with Reader(path) as bag:
        theirs = [(stamp, store.deserialize_ros1(data, kind)) for _, stamp, data in bag.messages()]
    ros_messages(path, fields, theirs, found)


def ros2(rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """rosbag2 in sqlite of random message types with rosbags."""
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer

    store, kind, _, fields = ros_store(rng, "ROS2_HUMBLE")
    bag = folder / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/any", kind, typestore=store)
        for row in range(int(rng.integers(1, 30))):
            writer.write(connection, 10**18 + row * 10**7, store.serialize_cdr(ros_message(rng, store, kind, fields), kind))
    with Reader(bag) as reader:
        theirs = [(stamp, store.deserialize_cdr(data, kind)) for _, stamp, data in reader.messages()]
    (path,) = bag.glob("*.db3")
    ros_messages(path, fields, theirs, found)


# -- LeRobot --------------------------------------------------------------------------------------------------------

#: Layout → the last release of LeRobot that writes and reads it on Python 3.11, in the environment of ``make reader-peers``.
LEROBOT = {"v2.1": "0.3.3", "v3.0": "0.4.4"}


def lerobot_python(version: str) -> Path:
    """The interpreter of the environment with the release for this layout."""
    return ROOT / f".venv-lerobot-{LEROBOT[version]}" / "bin" / "python"


@functools.cache
def lerobot_sets(version: str) -> subprocess.Popen[str]:
    """The process that writes and reads sets; it ends with this one, whose pipe it reads."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    command = [str(lerobot_python(version)), "-W", "ignore", str(Path(__file__).parent / "lerobot_sets.py")]
    process = subprocess.Popen(
        command, env={**kept, "HF_HUB_OFFLINE": "1", "HF_DATASETS_DISABLE_PROGRESS_BARS": "1"},
        text=True, encoding="utf-8", stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    stated = answer(process)["version"]
    if stated != version:
        raise RuntimeError(f"{command[0]} writes the layout {stated}, not {version}")
    return process


def answer(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"{process.args!r} ended with status {process.wait()}")
    found: dict[str, Any] = json.loads(line)
    return found


def element_labels(feature: str, names: Any, count: int) -> list[str]:
    """The columns of a list: by name, by index without one; a name that is a number stands in quotes."""
    if count == 1:
        return [feature]
    names = next(iter(names.values())) if isinstance(names, dict) else names or ["" for _ in range(count)]
    quoted = [f'"{name}"' if name.isdecimal() else name for name in names]
    return [f"{feature}[{name or k}]" for k, name in enumerate(quoted)]


def lerobot(version: str, rng: np.random.Generator, folder: Path, found: Comparison) -> None:
    """LeRobot sets of random features with its own loader, episode by episode."""
    process = lerobot_sets(version)
    assert process.stdin is not None
    process.stdin.write(json.dumps({"seed": rng.integers(0, 2**31, 4).tolist(), "folder": str(folder)}) + "\n")
    process.stdin.flush()
    answer(process)
    features: Mapping[str, Any] = json.loads((folder / "set/meta/info.json").read_text("utf-8"))["features"]
    theirs = dict(np.load(folder / "loaded.npz"))
    streams = [stream for path in data_files(folder / "set") for stream in streams_of(path).values()]
    episodes = np.unique(theirs["episode_index"])
    found.names("episodes", [stream.name for stream in streams], [episode_name(int(k)) for k in episodes])
    numbers = {name for name, about in features.items() if len(about["shape"]) == 1 and about["dtype"] != "string"}
    for stream, episode in zip(streams, episodes, strict=True):
        found.names("features without a column", stream.unread, features.keys() - numbers)
        rows = theirs["episode_index"] == episode
        labels = {name: element_labels(name, features[name]["names"], features[name]["shape"][0]) for name in numbers}
        own = {label for name in numbers - {"timestamp", "episode_index"} for label in labels[name]}
        found.names(stream.name, stream.columns, own)
        for name in numbers - {"timestamp", "episode_index"}:
            values = theirs[name][rows].reshape(np.count_nonzero(rows), -1)
            for k, label in enumerate(labels[name]):
                ours = stream.columns[label]
                if features[name]["dtype"] == "float64":
                    reason = "the loader gives float64 in single precision"
                    single = ours.astype(np.float32).astype(np.float64)
                    found.by_rule[reason] = found.by_rule.get(reason, 0) + int(np.count_nonzero(single != ours))
                    ours = single
                found.column(label, ours, values[:, k])
        found.stamps(stream.name, stream, theirs["timestamp"][rows])


#: Format → the libraries beside its reader, and how a file is made and compared.
FORMATS: dict[str, tuple[str, Callable[[np.random.Generator, Path, Comparison], None]]] = {
    "C3D": ("ezc3d", c3d),
    "CAN: BLF, ASC, TRC, candump, MDF": ("python-can, cantools", can_log),
    "MDF 4": ("asammdf", mf4),
    "PX4 ULog": ("pyulog", ulog),
    "ArduPilot DataFlash": ("pymavlink", dataflash),
    "MCAP, ROS 2": ("mcap-ros2-support", mcap),
    "ROS 1 bag": ("rosbags", ros1),
    "rosbag2 in sqlite": ("rosbags", ros2),
    "Parquet": ("pyarrow", parquet),
    **{f"LeRobot {layout}": (f"lerobot {own}", functools.partial(lerobot, layout)) for layout, own in LEROBOT.items()},
}


def compare(name: str, count: int, seed: int = 0) -> Comparison:
    """``count`` random files of a format; the differences name the seed of their file."""
    found = Comparison()
    for number in range(count):
        with tempfile.TemporaryDirectory() as folder:
            before = len(found.differences)
            FORMATS[name][1](np.random.default_rng([seed, number]), Path(folder), found)
            found.differences[before:] = [f"seed {seed}, file {number}: {text}" for text in found.differences[before:]]
            found.files += 1
    return found


def table(results: dict[str, Comparison]) -> str:
    """Markdown, one row a format."""
    head = ("format", "compared with", "files", "numbers and stamps", "explained by a rule", "differences")
    rows = []
    for name, found in results.items():
        rules = "; ".join(f"{count}: {reason}" for reason, count in sorted(found.by_rule.items()))
        rows.append((name, FORMATS[name][0], str(found.files), str(found.values), rules, str(len(found.differences))))
    return markdown(head, rows, "llrrlr")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000, help="files of each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="pattern of formats; nothing is published")
    options = parser.parse_args()
    names = [name for name in FORMATS if options.only is None or re.search(options.only, name)]
    if absent := [version for version in LEROBOT if f"LeRobot {version}" in names and not lerobot_python(version).exists()]:
        parser.error(f"no LeRobot for {', '.join(absent)}: run `make reader-peers`, or leave it out with --only")
    results = {}
    for name in names:
        results[name] = compare(name, options.count, options.seed)
        print(
            f"{name}: {results[name].files} files, {results[name].values} numbers, {len(results[name].differences)} differences"
        )
        print("\n".join(results[name].differences[:5]))
    print(table(results))
    if options.only is None:
        write_tables(PAGE, table(results), "pipelines/reader_peers.py")


if __name__ == "__main__":
    main()
