"""Paths: the default helix, files, and what is refused."""

from __future__ import annotations

from pathlib import Path as File

import numpy as np
import pytest
from crane_model import crane, crane_plant

from sysid.errors import InputError, SettingsError
from sysid_rl.train.inverse_kinematics import InverseKinematics, chain_of_plant
from sysid_rl.train.paths import Path, centre_for, check_reach, circle, helix, lowest_height, read_path
from sysid_rl.train.reach import reach_of

PLANT = crane_plant()
REACH = reach_of(PLANT)
INVERSE = InverseKinematics.of(chain_of_plant(PLANT), REACH.low, REACH.high)


def written(folder: File, text: str) -> File:
    file = folder / "square.csv"
    file.write_text(text, "utf-8")
    return file


def test_the_default_helix() -> None:
    path = helix([0.8, 0.0, 0.3])
    assert len(path.points) == 3001
    assert path.time[-1] == pytest.approx(30.0)
    assert path.speed == pytest.approx(np.hypot(2.0 * np.pi * 0.2 / 10.0, 0.002), rel=1e-4)
    np.testing.assert_allclose(np.hypot(*(path.points[:, :2] - [0.8, 0.0]).T), 0.2)
    np.testing.assert_allclose(path.points[[0, 1500, 3000], 2], [0.27, 0.3, 0.33], atol=1e-12)
    np.testing.assert_array_equal(path.at(np.array([0, 5000])), path.points[[0, 3000]])


def test_a_circle_closes() -> None:
    path = circle([0.8, 0.1, 0.3])
    np.testing.assert_allclose(path.points[0], path.points[-1], atol=1e-12)
    assert np.ptp(path.points[:, 2]) == 0.0


def test_the_centre_is_where_the_helix_fits_best() -> None:
    floor = lowest_height(crane())
    assert floor == pytest.approx(0.05 + 0.22)  # the gripper hangs 0.22 m below the tip
    centre = centre_for(INVERSE, REACH.ee_low, REACH.ee_high, floor=floor)
    path = helix(centre)
    assert path.points[:, 2].min() >= floor - 1e-9
    joints = check_reach(path, INVERSE)
    assert INVERSE.margin(joints).min() > 0.1
    np.testing.assert_allclose(chain_of_plant(PLANT).predict(joints), path.points, atol=1e-5)
    with pytest.raises(SettingsError, match=r"no place for a helix of radius 3\.0 m"):
        centre_for(INVERSE, REACH.ee_low, REACH.ee_high, radius=3.0)


def test_a_file_is_read_and_put_on_the_grid(tmp_path: File) -> None:
    file = written(tmp_path, "t,x,y,z\n1.0,0.8,0,0.3\n1.5,0.85,0,0.3\n2.0,0.85,0.1,0.35\n")
    path = read_path(file, 100.0)
    assert (path.name, len(path.points)) == ("square", 101)
    np.testing.assert_allclose(path.points[25], [0.825, 0.0, 0.3])
    np.testing.assert_allclose(path.points[-1], [0.85, 0.1, 0.35])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z\n1,2,3\n", "line 1: columns x,y,z; expected t,x,y,z in seconds and metres"),
        ("", "line 1: columns none"),
        ("t,x,y,z\n0,1,2\n", "line 2: 0,1,2; expected four numbers: t,x,y,z"),
        ("t,x,y,z\n0,1,2,3\n1,1,two,3\n", "line 3: 1,1,two,3; expected four numbers"),
        ("t,x,y,z\n0,1,2,nan\n", "line 2: 0,1,2,nan"),
        ("t,x,y,z\n0,1,2,3\n", "1 points; expected at least two"),
        ("t,x,y,z\n0,1,2,3\n2,1,2,3\n1.5,1,2,3\n", "time 1.5 s follows 2 s; expected increasing time"),
    ],
)
def test_a_file_that_is_no_path_is_refused(tmp_path: File, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_path(written(tmp_path, text), 100.0)


def test_a_missing_file_is_named(tmp_path: File) -> None:
    with pytest.raises(InputError, match="no such file; expected helix, circle or a CSV file"):
        read_path(tmp_path / "none.csv", 100.0)


def test_points_out_of_reach_are_refused_with_time_and_distance() -> None:
    away = np.linspace([0.8, 0.0, 0.3], [1.6, 0.0, 0.3], 101)
    with pytest.raises(InputError, match=r"path out: at 0\.\d\d s \(.*\) the machine stays \d+ mm away, and \d+ mm at 1.00 s"):
        check_reach(Path("out", 100.0, away), INVERSE)
