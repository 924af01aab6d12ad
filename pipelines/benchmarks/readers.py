"""One reading of a ROS 2 bag in a process of its own: the last line of its output is JSON, with the time and the most memory.

``ours`` and its neighbours make pandas tables of states and poses; ``mapped``, ``inspect`` and ``everything`` are ours alone.

.venv/bin/python pipelines/benchmarks/readers.py ours|rerun|mcap_ros2|…|rosbags|mapped|inspect|everything BAG WARM_UP_BAG
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.bags import JOINTS
from benchmarks.rows import seconds

STATES, POSES = "/joint_states", "/pose"
_ARRAYS = ("position", "velocity", "effort")
_PLACES = (*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw"))
#: Topic → columns of its table: two clocks [ns] and every number.
COLUMNS = {
    STATES: ("log", "header", *(f"{array}[{joint}]" for array in _ARRAYS for joint in JOINTS)),
    POSES: ("log", "header", *_PLACES),
}

Tables = dict[str, pd.DataFrame]


def ours(path: Path) -> Tables:
    from sysid.logs import ReadOptions, reader_for

    tables = {}
    for stream in reader_for(path).read(path, ReadOptions()):
        found = {"log": stream.stamps["log"], "header": stream.stamps["header"], **stream.columns}
        tables[stream.name] = pd.DataFrame({name: found[name] for name in COLUMNS[stream.name]}, copy=False)
    return tables


def rerun(path: Path) -> Tables:
    """Whole messages as Arrow structures (its other decoders make float32 of poses), flattened without a Python loop."""
    from rerun.chunk import McapReader

    parts: dict[str, list[Any]] = {}
    for chunk in McapReader(path, decoders=["ros2_reflection"]).stream():
        batch = chunk.to_record_batch()
        if "message_log_time" in batch.schema.names:
            parts.setdefault(str(chunk.entity_path), []).append(batch)
    return {topic: _flattened(topic, batches) for topic, batches in parts.items()}


def _flattened(topic: str, batches: list[Any]) -> pd.DataFrame:
    import pyarrow as pa

    columns: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in COLUMNS[topic]}
    for batch in batches:
        (index,) = (i for i, name in enumerate(batch.schema.names) if name.endswith(":message"))
        message = batch.column(index).flatten()
        stamp = message.field("header").field("stamp")
        columns["log"].append(batch.column("message_log_time").cast(pa.int64()).to_numpy())
        columns["header"].append(stamp.field("sec").to_numpy() * np.int64(10**9) + stamp.field("nanosec").to_numpy())
        if topic == POSES:
            for name in _PLACES:
                value = message
                for part in name.split("."):
                    value = value.field(part)
                columns[name].append(value.to_numpy())
            continue
        names = np.asarray(message.field("name").flatten().dictionary_encode().indices).reshape(len(message), -1)
        if np.any(names != np.arange(len(JOINTS))):
            raise SystemExit("this flattening takes joints in one order alone")
        for array in _ARRAYS:
            values = message.field(array).flatten().to_numpy().reshape(len(message), -1)
            for place, joint in enumerate(JOINTS):
                columns[f"{array}[{joint}]"].append(values[:, place])
    return pd.DataFrame({name: np.concatenate(column) for name, column in columns.items()}, copy=False)


def mcap_ros2(path: Path) -> Tables:
    """As it is called without a word: in the order of the log times."""
    return _mcap_ros2(path, log_time_order=True)


def mcap_ros2_file_order(path: Path) -> Tables:
    """In the order of the file, as `sysid` does."""
    return _mcap_ros2(path, log_time_order=False)


def _mcap_ros2(path: Path, log_time_order: bool) -> Tables:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(log_time_order=log_time_order)
        return _from_objects((channel.topic, message.log_time, value) for _, channel, message, value in messages)


def rosbags(path: Path) -> Tables:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        return _from_objects((c.topic, t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages())


def _from_objects(messages: Iterator[tuple[str, int, Any]]) -> Tables:
    """A row a message, the way one fills a table from a reader of messages."""
    rows: dict[str, list[list[float]]] = {STATES: [], POSES: []}
    place = attrgetter(*_PLACES)
    for topic, log_time, message in messages:
        stamp = message.header.stamp
        numbers = place(message) if topic == POSES else (*message.position, *message.velocity, *message.effort)
        rows[topic].append([log_time, stamp.sec * 10**9 + stamp.nanosec, *numbers])
    return {topic: pd.DataFrame(found, columns=list(COLUMNS[topic])) for topic, found in rows.items()}


def mapped(path: Path) -> int:
    """Messages of the joint states, of which four positions are read: what ingest does."""
    from sysid.logs import ReadOptions, reader_for

    fields = {STATES: frozenset(f"position[{joint}]" for joint in JOINTS[:4])}
    return sum(len(stream) for stream in reader_for(path).read(path, ReadOptions(streams=frozenset(fields), fields=fields)))


def inspect(path: Path) -> int:
    """All messages, as far as a look into the file needs them."""
    from sysid.logs.inspection import inspect_file

    return sum(stream.samples for stream in inspect_file(path).streams)


def everything(path: Path) -> int:
    """All messages with every number."""
    from sysid.logs import ReadOptions, reader_for

    return sum(len(stream) for stream in reader_for(path).read(path, ReadOptions()))


TABLES: dict[str, Callable[[Path], Tables]] = {
    reader.__name__: reader for reader in (ours, rerun, mcap_ros2, mcap_ros2_file_order, rosbags)
}
STREAMS: dict[str, Callable[[Path], int]] = {reader.__name__: reader for reader in (mapped, inspect, everything)}


def peak() -> int:
    """The most memory this process has had so far [bytes]."""
    lines = Path("/proc/self/status").read_text("ascii").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


def rows_of(reader: str, path: Path) -> int:
    """Read with ``reader`` and count the rows while the tables are there."""
    return STREAMS[reader](path) if reader in STREAMS else sum(len(table) for table in TABLES[reader](path).values())


def main() -> None:
    reader, path, warm_up = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    rows_of(reader, warm_up)
    before = peak()
    rows: list[int] = []
    taken = seconds(lambda: rows.append(rows_of(reader, path)))
    print(json.dumps({"seconds": taken, "rows": rows[0], "peak": peak(), "before": before}))


if __name__ == "__main__":
    main()
