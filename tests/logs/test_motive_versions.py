"""Motive exports as each version wrote them, made by hand: the same bodies and markers come out of all of them.

Heads after OptiTrack's documentation of the CSV export and after real files of 1.21, 1.22 and 1.25: 1.20 to 1.22 do not say
which head row is which, 1.23 and later do, 1.25 names parents. Units and rotation type stand in the first line where turned on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.inspection import inspect_file
from sysid.logs.motive import VERSIONS, MotiveReader

ROWS = 5
TIMES = np.arange(ROWS) / 120.0
TURNS = Rotation.from_rotvec(np.outer(np.arange(ROWS), [0.1, -0.2, 0.3]))
PLACES = np.column_stack([np.linspace(1.0, 1.4, ROWS), np.full(ROWS, 0.5), np.linspace(-2.0, 2.0, ROWS)])
CORNER = np.array([0.1, 0.0, 0.05])
UNITS = {"Meters": 1.0, "Centimeters": 100.0, "Millimeters": 1000.0}


@dataclass(frozen=True)
class Object:
    """Columns of one body or marker: kind, name, id, parent, [(channel, axis, values)]."""

    kind: str
    name: str
    number: str
    parent: str
    columns: list[tuple[str, str, np.ndarray]]


def marker(kind: str, name: str, number: str, places: np.ndarray, quality: bool = False) -> Object:
    columns = [("Position", axis, places[:, i]) for i, axis in enumerate("XYZ")]
    more = [("Marker Quality", "", np.ones(ROWS))] if quality else []
    return Object(kind, name, number, "boom", columns + more)


def body(rotation: str, units: str, error: str = "Mean Marker Error") -> list[Object]:
    """A rigid body with one marker, solved and reconstructed."""
    scale = UNITS[units]
    if rotation == "Quaternion":
        turned = [("Rotation", axis, TURNS.as_quat()[:, i]) for i, axis in enumerate("XYZW")]
    else:
        turned = [("Rotation", axis, TURNS.as_euler(rotation, degrees=True)[:, i]) for i, axis in enumerate(rotation)]
    placed = [("Position", axis, scale * PLACES[:, i]) for i, axis in enumerate("XYZ")]
    corner = scale * (PLACES + TURNS.apply(CORNER))
    return [
        Object("Rigid Body", "boom", "A1", "", [*turned, *placed, (error, "", np.full(ROWS, 0.001 * scale))]),
        marker("Rigid Body Marker", "boom:Marker1", "B1", corner, quality=True),
        marker("Marker", "boom:Marker1", "C1", corner + 0.002 * scale),
        marker("Marker", "Unlabeled 1000", "D1", corner),
    ]


def export(
    path: Path, version: str, objects: list[Object], rotation: str | None, units: str | None, numbers: bool = True
) -> Path:
    head = f"Format Version,{version},Take Name,Take 1,Capture Frame Rate,120.000000,Export Frame Rate,120.000000"
    head += f",Rotation Type,{rotation}" if rotation else ""
    head += f",Length Units,{units}" if units else ""
    columns = [(item, *column) for item in objects for column in item.columns]
    labelled = float(version) >= 1.23
    rows = {"Type": [c[0].kind for c in columns], "Name": [c[0].name for c in columns]}
    if numbers:
        rows["ID"] = [f'"{c[0].number}"' for c in columns]
    if float(version) >= 1.25:
        rows["Parent"] = [c[0].parent for c in columns]
    lines = [f"{head},Coordinate Space,Global", ""]
    lines += [",".join(["", title if labelled else "", *cells]) for title, cells in rows.items()]
    lines.append(",".join(["", "", *(c[1] for c in columns)]))
    lines.append(",".join(["Frame", "Time (Seconds)", *(c[2] for c in columns)]))
    lines += [",".join([str(i), f"{TIMES[i]:.6f}", *(f"{c[3][i]:.9f}" for c in columns)]) for i in range(ROWS)]
    path.write_text("\r\n".join([*lines, ""]), encoding="utf-8", newline="")
    return path


def read(path: Path, **options: str | None) -> dict[str, Stream]:
    return {stream.name: stream for stream in reader_for(path).read(path, ReadOptions(**options))}  # type: ignore[arg-type]


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("rotation", ["Quaternion", "XYZ", "ZYX"])
@pytest.mark.parametrize("version", VERSIONS)
def test_every_version_gives_the_same(tmp_path: Path, version: str, rotation: str, units: str, stated: bool) -> None:
    error = "Error Per Marker" if float(version) < 1.22 else "Mean Marker Error"
    path = export(
        tmp_path / "take.csv", version, body(rotation, units, error), rotation if stated else None, units if stated else None
    )
    asked = {} if stated else {"length_unit": "m"} if rotation == "Quaternion" else {"length_unit": "m", "rotation": "XYZ"}
    assert MotiveReader().unstated(path) == asked
    unit = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm"}[units]
    streams = read(path, length_unit=unit, rotation=None if rotation == "Quaternion" else rotation)
    assert {name: stream.kind for name, stream in streams.items()} == {
        "boom": "Rigid Body",
        "boom:Marker1": "Rigid Body Marker",
        "boom:Marker1 (Marker)": "Marker",
        "Unlabeled 1000": "Marker",
    }
    pose = streams["boom"].columns
    np.testing.assert_allclose(np.column_stack([pose[axis] for axis in "xyz"]), PLACES, atol=1e-8)
    turned = Rotation.from_quat(np.column_stack([pose[f"q{axis}"] for axis in "xyzw"]))
    assert (turned.inv() * TURNS).magnitude().max() < 1e-7
    np.testing.assert_allclose(pose["error"], 0.001)
    corner = PLACES + TURNS.apply(CORNER)
    for name, off in (("boom:Marker1", 0.0), ("boom:Marker1 (Marker)", 0.002), ("Unlabeled 1000", 0.0)):
        seen = np.column_stack([streams[name].columns[axis] for axis in "xyz"])
        np.testing.assert_allclose(seen, corner + off, atol=1e-8)
    np.testing.assert_allclose(streams["boom"].stamps["capture"], TIMES * 1e9, atol=1e3)
    assert streams["boom"].losses == ()


def test_without_a_row_of_ids_names_and_types_keep_them_apart(tmp_path: Path) -> None:
    path = export(tmp_path / "take.csv", "1.22", body("Quaternion", "Meters"), "Quaternion", "Meters", numbers=False)
    assert list(read(path)) == ["boom", "boom:Marker1", "boom:Marker1 (Marker)", "Unlabeled 1000"]


def test_two_assets_of_one_name_are_two_streams(tmp_path: Path) -> None:
    other = marker("Marker", "Unlabeled 1000", "E1", PLACES + 1.0)
    path = export(tmp_path / "take.csv", "1.24", [*body("Quaternion", "Meters"), other], "Quaternion", "Meters")
    streams = read(path)
    np.testing.assert_allclose(streams["Unlabeled 1000#2"].columns["x"] - 1.0, PLACES[:, 0], atol=1e-8)


def test_a_later_version_and_unknown_types_are_read_as_far_as_they_are_known_and_said(tmp_path: Path) -> None:
    strange = Object("Trained Markerset", "cable", "F1", "", [("Position", axis, PLACES[:, 0]) for axis in "XYZ"])
    path = export(tmp_path / "take.csv", "1.26", [*body("Quaternion", "Meters"), strange], "Quaternion", "Meters")
    assert inspect_file(path).losses == (
        "take.csv: format version 1.26 is newer than 1.25 and has been read like it",
        "take.csv: columns of type Trained Markerset are not read",
    )
    for version in ("1.19", "2.0", "1.251"):
        path = export(tmp_path / "other.csv", version, body("Quaternion", "Meters"), "Quaternion", "Meters")
        with pytest.raises(InputError, match=rf"format version '{version}'; expected 1\.1 or one of 1\.2, 1\.20, .*1\.25"):
            read(path)
