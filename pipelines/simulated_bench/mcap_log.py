"""The machine's log as a ROS 2 MCAP file: CDR messages in zstd chunks, stamped in the header, published and logged later."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.reader import make_reader
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer

from simulated_bench.recipe import AXES, WIRED
from simulated_bench.run import MachineLog

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Octets = npt.NDArray[np.uint8]

_SEPARATOR = "=" * 80

_HEADER = f"""{_SEPARATOR}
MSG: std_msgs/Header
# Standard metadata for higher-level stamped data types.
builtin_interfaces/Time stamp
string frame_id
{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

VALVE_COMMAND = f"""# Commands to the proportional valves, one entry an axis, between -1 and 1.
std_msgs/Header header
string[] name
float64[] command
{_HEADER}"""

JOINT_STATE = f"""# State of a set of joints: rad for revolute, m for prismatic ones. Empty arrays where nothing is measured.
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER}"""

VALVES = ("autolog_msgs/msg/ValveCommand", VALVE_COMMAND)
STATES = ("sensor_msgs/msg/JointState", JOINT_STATE)
TOPICS = ("/valves/command", "/draw_wires", "/slew_sensor")

#: A message begins with four bytes of encapsulation, then its stamp: seconds and nanoseconds, four bytes each.
_STAMP = 4


#: Placeholder for a number in the template message of a topic.
_PLACEHOLDER = -1.2345e-67


def write_mcap(log: MachineLog, path: Path) -> None:
    """Write ``log`` in the order in which the messages arrived."""
    fields = (("command", AXES, log.command), ("position", WIRED, log.wires), ("position", ("slew",), log.slew[:, None]))
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=256 * 1024, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="sysid.bench")
        channels, payloads = [], []
        schemas: dict[str, int] = {}
        for topic, (field, names, values) in zip(TOPICS, fields, strict=True):
            kind, text = VALVES if field == "command" else STATES
            if kind not in schemas:
                schemas[kind] = writer.register_schema(kind, SchemaEncoding.ROS2, text.encode())
            channels.append(writer.register_channel(topic, MessageEncoding.CDR, schemas[kind]))
            payloads.append(_encoded(kind, text, field, names, log.stamps, values))
        for place in np.argsort(log.logged.ravel(), kind="stable"):
            cycle, column = divmod(int(place), len(TOPICS))
            writer.add_message(
                channels[column],
                log_time=int(log.logged[cycle, column]),
                publish_time=int(log.published[cycle, column]),
                sequence=cycle,
                data=payloads[column][cycle].tobytes(),
            )
        writer.finish()  # type: ignore[no-untyped-call]


def _encoded(kind: str, text: str, field: str, names: Sequence[str], stamps: Counts, values: Array) -> Octets:
    """All messages of a topic, (n, bytes): a template encoded by the library, with stamps and numbers inserted."""
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    message: dict[str, Any] = {"header": header, "name": list(names), field: [_PLACEHOLDER] * len(names)}
    if field == "position":
        message |= {"velocity": [], "effort": []}
    buffer = BytesIO()
    with Writer(buffer) as writer:
        writer.write_message("/one", writer.register_msgdef(kind, text), message)
    (_, _, one), *_ = make_reader(BytesIO(buffer.getvalue())).iter_messages()
    numbers = one.data.index(struct.pack("<d", _PLACEHOLDER))
    encoded = np.tile(np.frombuffer(one.data, np.uint8), (len(stamps), 1))
    clock = np.stack(np.divmod(stamps, 1_000_000_000), axis=1).astype("<u4")
    encoded[:, _STAMP : _STAMP + 8] = clock.view(np.uint8)
    encoded[:, numbers : numbers + 8 * len(names)] = np.ascontiguousarray(values, "<f8").view(np.uint8)
    return encoded
