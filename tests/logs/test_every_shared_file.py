"""Every real file of motion capture, bags and CAN is read or refused with a reason; none is passed over in silence."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.logs.inspection import inspect_file
from sysid.logs.readers import is_log

#: File → (reader, streams, samples of the first one, what was lost).
READ = {
    "mocap_files/motive_1.21_quaternion.csv": ("motive", 13, 250, ""),
    "mocap_files/motive_1.22_two_rigid_bodies.csv": ("motive", 13, 227, ""),
    "mocap_files/markers.csv": ("vicon", 51, 580, ""),
    "mocap_files/markers.trc": ("trc", 51, 93, "93 frames instead of the 652 that the head states"),
    "mocap_files/Gait.trc": ("trc", 33, 487, "218 rows are longer than the head; what has no name has been left out"),
    "mcap_bags/nav2_turtlebot.mcap": ("mcap", 4, 2639, ""),
    "mcap_bags/multiple_files_0.mcap": ("mcap", 1, 1324, ""),
    "mcap_bags/wbag_0.mcap": ("mcap", 8, 174, ""),
    "mcap_bags/rigid_body_motion_ros1.bag": ("rosbag1", 4, 74, ""),
    "mcap_bags/fake_joint_state.bag": ("rosbag1", 1, 2725, ""),
    "mcap_bags/tf_example.db3": ("rosbag2", 2, 1, ""),
    "mcap_bags/motor_data.csv": ("csv", 1, 756, ""),
}
#: What stands beside logs: what rosbag2 wrote about a bag, databases of CAN.
NO_LOGS = {".yaml", ".dbc"}


@pytest.mark.parametrize("name", sorted(READ))
def test_what_is_read_of_a_file(shared_data: Path, name: str) -> None:
    reader, streams, samples, lost = READ[name]
    seen = inspect_file(shared_data / name)
    assert (seen.reader, len(seen.streams), seen.streams[0].samples, seen.refusal) == (reader, streams, samples, "")
    assert lost in " ".join(seen.losses)
    assert bool(lost) == bool(seen.losses)


@pytest.mark.parametrize("folder", ["mocap_files", "mcap_bags", "can_logs"])
def test_no_file_is_passed_over(shared_data: Path, folder: str) -> None:
    files = sorted((shared_data / folder).iterdir())
    assert len(files) > 5
    for path in files:
        if path.suffix in NO_LOGS:
            continue
        assert is_log(path), f"no reader takes {path.name}"
        seen = inspect_file(path)
        # Refused are logs in which nothing was measured: error frames, remote frames.
        assert seen.streams or "nothing but" in seen.refusal, seen.refusal
        assert all(stream.samples for stream in seen.streams)
