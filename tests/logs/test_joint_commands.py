"""ROS 2 commands of several joints as they are recorded: the names of a message address the arrays of what it contains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from sysid.logs import ReadOptions, Stream
from sysid.logs.mcap import McapReader
from sysid.logs.messages import flatten

LINE = "=" * 80
HEADER = f"""{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{LINE}
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""
POINT = f"""{LINE}
MSG: trajectory_msgs/JointTrajectoryPoint
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
"""
TRAJECTORY = f"""std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint[] points
{POINT}{HEADER}"""
STATE = f"""std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
{POINT}{HEADER}"""
JOG = f"""std_msgs/Header header
string[] joint_names
float64[] displacements
float64[] velocities
float64 duration
{HEADER}"""
NAMES = ["shoulder", "elbow"]


def header(k: int) -> dict[str, Any]:
    return {"stamp": {"sec": 10, "nanosec": 20_000_000 * k}, "frame_id": ""}


def point(values: list[float], speeds: list[float] | None = None) -> dict[str, Any]:
    wait = {"sec": 0, "nanosec": 20_000_000}
    return {"positions": values, "velocities": speeds or [], "accelerations": [], "effort": [], "time_from_start": wait}


def recorded(path: Path, kind: str, definition: str, messages: list[dict[str, Any]], options: ReadOptions) -> Stream:
    with path.open("wb") as file, Writer(file) as writer:
        schema = writer.register_msgdef(kind, definition)
        for k, message in enumerate(messages):
            writer.write_message("/arm", schema, message, log_time=20_000_000 * k, publish_time=20_000_000 * k)
    (stream,) = McapReader().read(path, options)
    return stream


def wanted(*fields: str) -> ReadOptions:
    return ReadOptions(streams=frozenset({"/arm"}), fields={"/arm": frozenset(fields)})


@pytest.mark.parametrize("chosen", [False, True])
def test_a_streamed_trajectory_has_the_names_of_its_joints(chosen: bool, tmp_path: Path) -> None:
    rows = [[0.1 * k, -0.2 * k] for k in range(8)]
    messages = [{"header": header(k), "joint_names": NAMES, "points": [point(row)]} for k, row in enumerate(rows)]
    options = wanted("points[0].positions[elbow]") if chosen else ReadOptions()
    stream = recorded(tmp_path / "log.mcap", "trajectory_msgs/msg/JointTrajectory", TRAJECTORY, messages, options)
    np.testing.assert_array_equal(stream.columns["points[0].positions[elbow]"], [row[1] for row in rows])
    assert np.diff(stream.stamps["header"]).tolist() == [20_000_000] * 7


def test_names_in_another_order_address_the_same_joint(tmp_path: Path) -> None:
    messages = [
        {"header": header(k), "joint_names": NAMES[::sign], "points": [point([1.0 + k, 5.0][::sign], [0.1, 0.5][::sign])]}
        for k, sign in enumerate((1, -1, 1, -1))
    ]
    stream = recorded(tmp_path / "log.mcap", "trajectory_msgs/msg/JointTrajectory", TRAJECTORY, messages, ReadOptions())
    np.testing.assert_array_equal(stream.columns["points[0].positions[shoulder]"], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(stream.columns["points[0].velocities[elbow]"], [0.5] * 4)


def test_the_state_of_a_controller(tmp_path: Path) -> None:
    messages = [
        {"header": header(k), "joint_names": NAMES, "reference": point([0.1 * k, 2.0]), "feedback": point([0.09 * k, 2.0])}
        for k in range(5)
    ]
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    stream = recorded(
        tmp_path / "log.mcap", kind, STATE, messages, wanted("reference.positions[shoulder]", "feedback.positions[shoulder]")
    )
    np.testing.assert_allclose(stream.columns["reference.positions[shoulder]"], 0.1 * np.arange(5))
    np.testing.assert_allclose(stream.columns["feedback.positions[shoulder]"], 0.09 * np.arange(5))


def test_jog_commands(tmp_path: Path) -> None:
    messages = [
        {"header": header(k), "joint_names": NAMES, "displacements": [], "velocities": [0.1 * k, -1.0], "duration": 0.02}
        for k in range(5)
    ]
    stream = recorded(tmp_path / "log.mcap", "control_msgs/msg/JointJog", JOG, messages, ReadOptions())
    np.testing.assert_allclose(stream.columns["velocities[shoulder]"], 0.1 * np.arange(5))
    assert not [name for name in stream.columns if name.startswith("displacements")]


def test_json_messages_have_the_same_names() -> None:
    found: dict[str, float] = {}
    flatten({"joint_names": NAMES, "points": [point([0.5, 0.7])], "stamps": [{"a": [1.0, 2.0, 3.0]}]}, "", found)
    assert found["points[0].positions[elbow]"] == found["points[0].positions[1]"] == 0.7
    assert not [name for name in found if name.startswith("stamps") and "elbow" in name]
