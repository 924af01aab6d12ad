"""The machine's log as a ROS 2 MCAP file: CDR messages in zstd chunks, stamped in the header, published and logged later."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from sysid.bench.recipe import AXES
from sysid.bench.run import WIRED, MachineLog

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

TOPICS = ("/valves/command", "/draw_wires", "/slew_sensor")


def write_mcap(log: MachineLog, path: Path) -> None:
    """Write ``log`` in the order in which the messages arrived."""
    with path.open("wb") as file, Writer(file, chunk_size=256 * 1024, compression=CompressionType.ZSTD) as writer:
        command = writer.register_msgdef("autolog_msgs/msg/ValveCommand", VALVE_COMMAND)
        state = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        order = np.argsort(log.logged.ravel(), kind="stable")
        for place in order:
            cycle, column = divmod(int(place), len(TOPICS))
            writer.write_message(
                topic=TOPICS[column],
                schema=command if column == 0 else state,
                message=_message(log, cycle, column),
                log_time=int(log.logged[cycle, column]),
                publish_time=int(log.published[cycle, column]),
                sequence=cycle,
            )


def _message(log: MachineLog, cycle: int, column: int) -> dict[str, Any]:
    seconds, nanoseconds = divmod(int(log.stamps[cycle]), 1_000_000_000)
    header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": ""}
    if column == 0:
        return {"header": header, "name": list(AXES), "command": log.command[cycle].tolist()}
    name, position = (list(WIRED), log.wires[cycle].tolist()) if column == 1 else (["slew"], [float(log.slew[cycle])])
    return {"header": header, "name": name, "position": position, "velocity": [], "effort": []}
