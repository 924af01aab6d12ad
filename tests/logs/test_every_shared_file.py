"""Real files of motion capture and bags: what is read of each. All files: reports/formats/, tests/pipelines/test_formats.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.logs import ReadOptions, reader_for
from sysid.logs.inspection import inspect_file

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


@pytest.mark.parametrize("name", sorted(READ))
def test_what_is_read_of_a_file(shared_data: Path, name: str) -> None:
    reader, streams, samples, lost = READ[name]
    seen = inspect_file(shared_data / name)
    assert (seen.reader, len(seen.streams), seen.streams[0].samples, seen.refusal) == (reader, streams, samples, "")
    assert lost in " ".join(seen.losses)
    assert bool(lost) == bool(seen.losses)


def test_the_text_export_of_a_trial_holds_what_its_c3d_file_holds(shared_data: Path) -> None:
    """Two files of one Vicon trial, two readers: the same names, stamps and gaps, positions to the last digit of the text."""
    folder = shared_data / "mocap_files"
    text, binary = (
        {stream.name: stream for stream in reader_for(folder / name).read(folder / name, ReadOptions())}
        for name in ("markers.csv", "Vicon.c3d")
    )
    assert binary.keys() - text.keys() == {"analog"}
    for name, stream in text.items():
        np.testing.assert_array_equal(stream.stamps["capture"], binary[name].stamps["capture"])
        for axis in "xyz":
            np.testing.assert_allclose(stream.columns[axis], binary[name].columns[axis], atol=5.1e-6)
