"""Motive exports: real files of two versions, gaps, units, conventions, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream
from sysid.logs.motive import MotiveReader

HEADER = (
    "Format Version,{version},Take Name,t,Export Frame Rate,100.0,Rotation Type,{rotation},{length}Coordinate Space,{space}"
)
BODY = [
    ",Type" + ",Rigid Body" * 8,
    ",Name" + ",body one" * 8,
    ",ID" + ',"ABCD"' * 8,
    ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error",
    "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,",
]


def export(
    path: Path,
    rows: list[str],
    version: str = "1.23",
    length: str = "Length Units,Millimeters,",
    space: str = "Global",
    rotation: str = "Quaternion",
) -> Path:
    head = HEADER.format(version=version, length=length, space=space, rotation=rotation)
    path.write_text("\r\n".join([head, "", *BODY, *rows, ""]), encoding="utf-8", newline="")
    return path


def read(path: Path, **options: str) -> tuple[Stream, ...]:
    return MotiveReader().read(path, ReadOptions(**options))  # type: ignore[arg-type]


def test_positions_are_metres_and_gaps_are_missing(tmp_path: Path) -> None:
    path = export(tmp_path / "m.csv", ["0,0.0,0,0,0,1,1000,2000,-3000,0.5", "1,0.01,,,,,,,,", "2,0.02,0,0,0,2,1,1,1,0.1"])
    (body,) = read(path)
    assert body.name == "body one"
    np.testing.assert_allclose(body.columns["x"], [1.0, np.nan, 0.001])
    np.testing.assert_allclose(body.columns["error"], [0.0005, np.nan, 0.0001])
    np.testing.assert_array_equal(body.stamps["capture"], [0, 10_000_000, 20_000_000])
    # A quaternion that is no rotation is a missing one.
    np.testing.assert_array_equal(body.columns["qw"], [1.0, np.nan, np.nan])


def local_markers(streams: tuple[Stream, ...], body: str) -> dict[str, np.ndarray]:
    """Markers of ``body`` in its frame; of a rigid body they stand still there."""
    by_name = {stream.name: stream.columns for stream in streams}
    pose = by_name[body]
    turn = Rotation.from_quat(np.column_stack([pose[f"q{axis}"] for axis in "xyzw"]))
    return {
        name: turn.inv().apply(np.column_stack([columns[axis] - pose[axis] for axis in "xyz"]))
        for name, columns in by_name.items()
        if name.startswith(f"{body}:")
    }


def test_real_export_1_21_with_quaternions(shared_data: Path) -> None:
    streams = read(shared_data / "mocap_files/motive_1.21_quaternion.csv")
    markers = local_markers(streams, "Rigid Body 1")
    assert len(markers) == 3
    for positions in markers.values():
        assert len(positions) == 250
        assert positions.std(axis=0).max() < 2e-5


def test_real_export_1_22_with_euler_angles(shared_data: Path) -> None:
    """The markers of the moving body stand still in its frame only with the right unit and order of angles."""
    path = shared_data / "mocap_files/motive_1.22_two_rigid_bodies.csv"
    right = local_markers(read(path, length_unit="cm", rotation="XYZ"), "RigidBody 01")
    wrong = local_markers(read(path, length_unit="cm", rotation="ZYX"), "RigidBody 01")
    assert max(positions.std(axis=0).max() for positions in right.values()) < 2e-5
    assert max(positions.std(axis=0).max() for positions in wrong.values()) > 5e-5


def test_what_the_header_does_not_say_has_to_be_stated(shared_data: Path) -> None:
    path = shared_data / "mocap_files/motive_1.22_two_rigid_bodies.csv"
    with pytest.raises(InputError, match=r'states no length unit.*State it in the recipe: `length_unit = "m"`'):
        read(path)
    with pytest.raises(InputError, match=r'Euler angles without a stated order.*`rotation = "XYZ"`'):
        read(path, length_unit="cm")


def test_a_unit_that_contradicts_the_header_is_refused(tmp_path: Path) -> None:
    path = export(tmp_path / "m.csv", ["0,0.0,0,0,0,1,1,2,3,0"])
    with pytest.raises(InputError, match=r"the file states \[Millimeters\]; expected \[m\] as in the recipe"):
        read(path, length_unit="m")


def test_other_versions_are_refused(tmp_path: Path) -> None:
    path = export(tmp_path / "m.csv", ["0,0.0,0,0,0,1,1,2,3,0"], version="2.0")
    with pytest.raises(
        InputError, match=r"format version '2\.0'; expected 1\.1 or one of 1\.2, 1\.20, 1\.21, 1\.22, 1\.23, 1\.24, 1\.25"
    ):
        read(path)


def test_local_coordinates_are_refused(tmp_path: Path) -> None:
    path = export(tmp_path / "m.csv", ["0,0.0,0,0,0,1,1,2,3,0"], space="Local")
    with pytest.raises(InputError, match="coordinate space 'Local'; expected 'Global'"):
        read(path)


def test_a_last_row_without_line_end_is_left_out(tmp_path: Path) -> None:
    path = export(tmp_path / "m.csv", ["0,0.0,0,0,0,1,1,2,3,0", "1,0.01,0,0,0,1,1,2,3,0"])
    path.write_bytes(path.read_bytes()[:-7])
    (body,) = read(path)
    assert len(body) == 1
    assert "may be cut" in body.losses[0]


def test_other_csv_files_and_empty_ones_are_refused(tmp_path: Path, shared_data: Path) -> None:
    with pytest.raises(InputError, match="first cell 'Trajectories'; expected 'Format Version'"):
        read(shared_data / "mocap_files/markers.csv")
    empty = tmp_path / "m.csv"
    empty.touch()
    with pytest.raises(InputError, match="the file is empty"):
        read(empty)
    with pytest.raises(InputError, match="a header but no frames"):
        read(export(tmp_path / "n.csv", []))


def test_an_export_is_the_same_in_pieces_and_may_be_left_after_its_first_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [f"{k},{0.01 * k:.2f},0,0,0,1,{k},{'' if k % 9 == 4 else 'lost' if k % 9 == 7 else k},3,0.5" for k in range(200)]
    path = export(tmp_path / "m.csv", rows)
    (whole,) = read(path)
    assert len(whole) == 200
    for cells in (1, 100, 330, 5000):
        monkeypatch.setattr("sysid.logs.table.CELLS", cells)
        (body,) = read(path)
        for name, values in whole.columns.items():
            np.testing.assert_array_equal(body.columns[name], values)
        (begun,) = MotiveReader().read(path, ReadOptions(seconds=0.5))
        assert 51 <= len(begun) <= max(52 + cells // 11, 51)
        np.testing.assert_array_equal(begun.columns["x"], whole.columns["x"][: len(begun)])
        for stream in (whole, begun):  # of the rows that were read
            texts = sum(k % 9 == 7 for k in range(len(stream)))
            assert stream.losses == (f"m.csv: {texts} cells are no numbers and are taken as missing",)
    path.write_text(path.read_text("utf-8") + "200,2.0,0,0,0,1,1,1,1,1,9\r\n", "utf-8")
    monkeypatch.setattr("sysid.logs.table.CELLS", 100)
    with pytest.raises(InputError, match="row 201 below the head: more than 10 cells"):
        read(path)
