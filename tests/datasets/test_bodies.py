"""Rigid bodies to joints and points: any mount, any capture frame, any pose; mistaken bodies; missing references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sysid.datasets.channel import Channel
from sysid.datasets.channels import read_streams
from sysid.datasets.frames.bodies import find_mounts, joints_and_points, without_mistakes
from sysid.datasets.frames.rigid import body_poses, frame_pose, inverse, mean_pose, poses_at
from sysid.datasets.recipe import FramePose, PointMap, Reference, SignalMap, StreamMap
from sysid.errors import InputError, SettingsError
from sysid.logs import Stream
from sysid.machine import Machine, load_machine

Array = npt.NDArray[np.float64]
BODIES = {"b0": "column", "b1": "boom", "b2": "stick", "b3": "tip"}
REFERENCE = {"slew": 0.1, "boom": 0.5, "stick": -1.2, "telescope": 0.05}
POINT = (0.03, -0.02, 0.05)


@pytest.fixture(scope="module")
def crane() -> Machine:
    return load_machine(Path(__file__).parents[2] / "datasets/autolog/machine.toml")


def random_pose(rng: np.random.Generator) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = rng.uniform(-1, 1, 3)
    return pose


def stream(name: str, poses: Array, rate: float = 60.0, error: Array | None = None) -> Stream:
    known = ~np.isnan(poses[:, 0, 0])
    quaternions = np.full((len(poses), 4), np.nan)
    quaternions[known] = Rotation.from_matrix(poses[known, :3, :3]).as_quat()
    columns = {axis: poses[:, i, 3] for i, axis in enumerate("xyz")} | {
        f"q{axis}": quaternions[:, i] for i, axis in enumerate("xyzw")
    }
    if error is not None:
        columns["error"] = error
    return Stream(name, Path("mocap.csv"), {"capture": np.rint(np.arange(len(poses)) / rate * 1e9).astype(np.int64)}, columns)


def capture(machine: Machine, q: Array, rng: np.random.Generator, frame: FramePose) -> list[Stream]:
    """What a capture system in ``frame`` sees of bodies with random mounts while the joints are at ``q`` (n, 4)."""
    kinematics = machine.kinematics()
    assert kinematics is not None
    links = kinematics.link_poses(q)
    to_capture = inverse(frame_pose(frame))
    return [stream(body, to_capture @ links[link] @ random_pose(rng)) for body, link in BODIES.items()]


def values_of(seen: list[Channel]) -> dict[str, Array]:
    return {item.signal: item.values for item in seen}


def mapping(frame: FramePose | None = None, **changes: object) -> StreamMap:
    reference = Reference((0.0, 0.5), REFERENCE)
    values = {"files": "mocap.csv", "bodies": BODIES, "frame": frame or FramePose(), "reference": reference} | changes
    return StreamMap(**values)  # type: ignore[arg-type]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), yaw=st.floats(-3.0, 3.0))
def test_joints_come_back_whatever_the_mounts_and_the_capture_frame(crane: Machine, seed: int, yaw: float) -> None:
    rng = np.random.default_rng(seed)
    frame = FramePose((1.0, -2.0, 0.3), (1.5708, 0.2, yaw))
    q = np.column_stack([rng.uniform(*axis.limits, size=60) for axis in crane.axes if axis.limits])
    q[:31] = list(REFERENCE.values())
    streams = capture(crane, q, rng, frame)
    mounts = {body: mean_pose(np.stack(poses)) for body, poses in find_mounts(streams, mapping(frame), crane).items()}
    signals = values_of(joints_and_points(streams, mapping(frame), mounts, crane)[0])
    for index, axis in enumerate(crane.axis_names):
        values = signals[f"{axis}.joint"]
        known = ~np.isnan(values)
        np.testing.assert_allclose(values[known], q[known, index], atol=1e-9)
        assert known[:31].all()


def test_a_point_in_a_body_frame_lands_in_the_base_frame(crane: Machine) -> None:
    rng = np.random.default_rng(1)
    frame = FramePose((0.5, 0.1, -0.2), (0.1, -0.3, 2.0))
    q = np.tile(list(REFERENCE.values()), (40, 1))
    streams = capture(crane, q, rng, frame)
    points = {"ee": PointMap("b3", POINT)}
    signals = values_of(joints_and_points(streams, mapping(frame, bodies={}, points=points), {}, crane)[0])
    expected = body_poses(streams[3], frame)[0] @ np.array([*POINT, 1.0])
    np.testing.assert_allclose([signals[f"ee.{axis}"][0] for axis in "xyz"], expected[:3], atol=1e-12)


def test_axes_between_bodies_that_are_not_there_are_left_out(crane: Machine) -> None:
    rng = np.random.default_rng(2)
    q = np.tile(list(REFERENCE.values()), (40, 1))
    streams = capture(crane, q, rng, FramePose())
    few = {"b0": "column", "b2": "stick", "b3": "tip"}
    mounts = {body: poses[0] for body, poses in find_mounts(streams, mapping(bodies=few), crane).items()}
    signals = values_of(joints_and_points(streams, mapping(bodies=few), mounts, crane)[0])
    assert set(signals) == {"slew.joint", "telescope.joint"}


def trajectory(n: int = 600) -> Array:
    poses = np.tile(np.eye(4), (n, 1, 1))
    time = np.arange(n) / 60.0
    poses[:, :3, 3] = np.column_stack([0.5 * np.sin(time), 0.5 * np.cos(time), 0.1 * time])
    return poses


def test_swapped_bodies_are_flagged_and_set_to_missing() -> None:
    poses = trajectory()
    swapped = poses.copy()
    swapped[200:230, :3, 3] += [0.06, 0.0, 0.03]
    swapped[400, :3, 3] += [0.0, 2.0, 0.0]
    seconds = np.arange(600) / 60.0
    cleaned, flags = without_mistakes("b", swapped, seconds)
    bad = np.isnan(cleaned[:, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(bad), [*range(200, 230), 400])
    assert [(flag.frames, round(flag.start_s, 3)) for flag in flags] == [(30, 3.333), (1, 6.667)]
    assert "further than a machine can move" in flags[0].reason


@given(seed=st.integers(0, 10_000), size=st.floats(0.05, 0.2), start=st.integers(20, 300), length=st.integers(3, 60))
def test_a_jump_of_five_centimetres_is_seen_in_any_direction(seed: int, size: float, start: int, length: int) -> None:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    swapped = trajectory()
    swapped[:, :3, 3] += 2e-4 * rng.normal(size=(600, 3))
    swapped[start : start + length, :3, 3] += size * direction / np.linalg.norm(direction)
    cleaned, _ = without_mistakes("b", swapped, np.arange(600) / 60.0)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(cleaned[:, 0, 0])), range(start, start + length))


def test_a_body_whose_markers_do_not_fit_is_missing() -> None:
    poses = trajectory()
    error = np.full(600, 2e-4)
    error[100:110] = 0.02
    cleaned, flags = without_mistakes("b", poses, np.arange(600) / 60.0, error)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(cleaned[:, 0, 0])), range(100, 110))
    assert flags[0].reason == "markers do not fit the body"


def test_fast_motion_and_long_dropouts_are_no_mistakes() -> None:
    poses = trajectory()
    poses[:, :3, 3] *= 4.0  # 2 m/s
    poses[300:360] = np.nan
    cleaned, flags = without_mistakes("b", poses, np.arange(600) / 60.0)
    assert flags == ()
    np.testing.assert_array_equal(np.isnan(cleaned), np.isnan(poses))


def as_topic(body: Stream, stamps: Array) -> Stream:
    """The body as a PoseStamped topic of a bag."""
    names = {"x": "position.x", "y": "position.y", "z": "position.z"} | {f"q{axis}": f"orientation.{axis}" for axis in "xyzw"}
    columns = {f"pose.{names[column]}": values for column, values in body.columns.items()}
    return Stream(body.name, Path("poses.mcap"), {"header": stamps.astype(np.int64), "log": stamps.astype(np.int64)}, columns)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_bodies_on_stamps_of_their_own_are_turned_to_common_instants(crane: Machine, seed: int) -> None:
    """Two topics at 100 and 73 Hz, fast rotation of parent and child: joints as good as the interpolation of rotations."""
    rng = np.random.default_rng(seed)
    frame = FramePose((1.0, -2.0, 0.3), (0.3, 0.2, 1.0))
    rates = {"b0": 100.0, "b1": 73.0, "b2": 90.0, "b3": 61.0}
    topics = []
    mount = {body: random_pose(rng) for body in BODIES}

    def motion(time: npt.NDArray[Any]) -> Array:
        late = np.clip(time - 1.0, 0.0, None)[:, None]
        return np.asarray(list(REFERENCE.values()) + np.sin(1.2 * late) ** 2 * [0.8, 0.2, 0.3, 0.05])

    kinematics = crane.kinematics()
    assert kinematics is not None
    for body, link in BODIES.items():
        time = rng.uniform(0.0, 0.01) + np.arange(0.0, 6.0, 1.0 / rates[body])
        poses = inverse(frame_pose(frame)) @ kinematics.link_poses(motion(time))[link] @ mount[body]
        topics.append(as_topic(stream(body, poses), np.rint(1e9 * time) + 5e18))
    own = mapping(frame, clock="header")
    mounts = {body: poses[0] for body, poses in find_mounts(topics, own, crane).items()}
    seen, _ = joints_and_points(topics, own, mounts, crane)
    assert [item.signal for item in seen] == ["slew.joint", "boom.joint", "stick.joint", "telescope.joint"]
    assert [round(1e9 / np.median(np.diff(item.stamps))) for item in seen] == [100, 73, 73, 61]
    for index, item in enumerate(seen):
        truth = motion((item.stamps - int(5e18)) * 1e-9)[:, index]
        known = ~np.isnan(item.values)
        assert known.mean() > 0.98
        assert np.abs(item.values - truth)[known].max() < 1e-4  # between frames 14 ms apart, at up to 2 rad/s²


def test_a_rotation_is_interpolated_as_one_and_not_across_a_gap() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(20.0 * times, [0.0, 0.0, 1.0])).as_matrix()  # 115° from frame to frame
    poses[:, 0, 3] = times
    at = np.array([-0.1, 0.0, 0.05, 0.1, 0.17, 0.5, 0.95, 1.0, 1.1])
    made = poses_at(poses, times, at, 0.15)
    inside = np.isin(at, [0.0, 0.05, 0.1, 0.17, 0.95, 1.0])
    np.testing.assert_array_equal(~np.isnan(made[:, 0, 0]), inside)
    expected = Rotation.from_rotvec(np.outer(20.0 * at[inside], [0.0, 0.0, 1.0])).as_matrix()
    np.testing.assert_allclose(made[inside, :3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(made[inside, 0, 3], at[inside], atol=1e-12)


def test_an_analog_stream_beside_the_bodies_does_not_disturb_them(crane: Machine) -> None:
    """It may come first and has a rate of its own."""
    rng = np.random.default_rng(5)
    q = np.tile(list(REFERENCE.values()), (40, 1))
    streams = capture(crane, q, rng, FramePose())
    analog = Stream("analog", Path("a.c3d"), {"capture": np.arange(4000, dtype=np.int64) * 1_000_000}, {"v": np.zeros(4000)})
    mounts = {body: poses[0] for body, poses in find_mounts(streams, mapping(), crane).items()}
    seen, _ = joints_and_points([analog, *streams], mapping(), mounts, crane)
    assert {len(item.values) for item in seen} == {40}


def test_mistakes_are_named(crane: Machine) -> None:
    rng = np.random.default_rng(3)
    q = np.tile(list(REFERENCE.values()), (60, 1))
    streams = capture(crane, q, rng, FramePose())
    with pytest.raises(SettingsError, match="no rigid body 'b9'; expected one of: b0, b1, b2, b3"):
        find_mounts(streams, mapping(bodies={"b9": "tip"}), crane)
    with pytest.raises(SettingsError, match="no value for axis 'slew'"):
        find_mounts(streams, mapping(reference=Reference((0.0, 0.5), {"boom": 0.5})), crane)
    with pytest.raises(SettingsError, match="no reference pose"):
        find_mounts(streams, mapping(reference=None), crane)
    with pytest.raises(InputError, match=r"b0: visible in 0 frames of the reference pose.*Choose other seconds"):
        find_mounts(streams, mapping(reference=Reference((50.0, 51.0), REFERENCE)), crane)
    q[:, 0] += np.linspace(0.0, 0.5, 60)
    moving = capture(crane, q, rng, FramePose())
    with pytest.raises(InputError, match=r"moves by \d+\.\d mm in the reference pose"):
        find_mounts(moving, mapping(), crane)
    with pytest.raises(SettingsError, match="link 'gripper' is not moved by an axis"):
        find_mounts(streams, mapping(bodies={"b0": "gripper"}), crane)


@pytest.mark.parametrize(
    ("file", "topic", "frames"),
    [
        ("rigid_body_motion_ros1.bag", "/vicon/t265_tracker/t265_tracker", 57),  # TransformStamped
        ("rigid_body_motion_ros1.bag", "/camera/odom/sample", 228),  # Odometry
        ("nav2_turtlebot.mcap", "/amcl_pose", 135),  # PoseWithCovarianceStamped
    ],
)
def test_poses_of_real_bags_are_tracked_beside_other_fields(
    shared_data: Path, crane: Machine, file: str, topic: str, frames: int
) -> None:
    own = StreamMap(file, signals={"slew.joint": SignalMap("header.seq", topic)}, points={"ee": PointMap(topic)})
    streams = read_streams(shared_data / "mcap_bags" / file, own)
    seen, dropped = joints_and_points(streams, own, {}, crane)
    assert [(item.signal, len(item.values)) for item in seen] == [("ee.x", frames), ("ee.y", frames), ("ee.z", frames)]
    assert all(np.isfinite(item.values).all() for item in seen)
    assert dropped == ()
