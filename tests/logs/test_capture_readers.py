"""Text exports of motion capture: Motive from 1.1 to 1.25, TRC, Vicon Nexus, Qualisys; damage of every kind."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.motive import MotiveReader


def read(path: Path, **options: Any) -> dict[str, Stream]:
    return {stream.name: stream for stream in reader_for(path).read(path, ReadOptions(**options))}


def write(path: Path, *lines: str) -> Path:
    path.write_text("\r\n".join([*lines, ""]), encoding="utf-8", newline="")
    return path


def positions(stream: Stream) -> np.ndarray:
    return np.column_stack([stream.columns[axis] for axis in "xyz"])


def quaternions(stream: Stream) -> np.ndarray:
    return np.column_stack([stream.columns[f"q{axis}"] for axis in "xyzw"])


MOTIVE_1_25 = (
    "Format Version,1.25,Take Name,t,Take Notes,one, two,"
    "Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
    "",
    ",Type,,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker,"
    "Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Marker,Marker,Marker,Bone,Bone,Bone",
    ",Name,,boom,boom,boom,boom,boom,boom,boom,boom,boom:Marker1,boom:Marker1,boom:Marker1,boom:Marker1,"
    "Unlabeled 1000,Unlabeled 1000,Unlabeled 1000,arm,arm,arm",
    ",ID,,A,A,A,A,A,A,A,A,B,B,B,B,C,C,C,D,D,D",
    ",Parent,,,,,,,,,,boom,boom,boom,boom,,,,Root,Root,Root",
    ",,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,"
    "Position,Position,Position,Marker Quality,Position,Position,Position,Position,Position,Position",
    "Frame,Time (Seconds),TimeCode,X,Y,Z,W,X,Y,Z,,X,Y,Z,,X,Y,Z,X,Y,Z",
    "0,0.000000,15:26:46:12.02,0,0,0,1,1000,2000,3000,0.5,1,2,3,0.9,4,5,6,7,8,9",
    "1,0.008333,15:26:46:12.03,0,0,0.70710678,0.70710678,1000,2000,3000,0.5,1,2,3,0.9,,,,7,8,9",
)


def test_motive_1_25_with_time_code_parents_and_all_kinds_of_columns(tmp_path: Path) -> None:
    streams = read(write(tmp_path / "take.csv", *MOTIVE_1_25))
    assert {name: stream.kind for name, stream in streams.items()} == {
        "boom": "Rigid Body", "boom:Marker1": "Rigid Body Marker", "Unlabeled 1000": "Marker", "arm": "Bone",
    }  # fmt: skip
    np.testing.assert_allclose(positions(streams["boom"]), [[1.0, 2.0, 3.0]] * 2)
    np.testing.assert_allclose(Rotation.from_quat(quaternions(streams["boom"])).as_euler("XYZ", degrees=True)[1], [0, 0, 90])
    np.testing.assert_allclose(streams["boom"].columns["error"], [0.0005, 0.0005])
    np.testing.assert_allclose(streams["boom:Marker1"].columns["quality"], [0.9, 0.9])
    np.testing.assert_allclose(positions(streams["Unlabeled 1000"]), [[0.004, 0.005, 0.006], [np.nan] * 3])
    np.testing.assert_array_equal(streams["arm"].stamps["capture"], [0, 8_333_000])


@pytest.mark.parametrize("version", ["1.2", "1.20", "1.21", "1.24"])
def test_motive_versions_without_labels_in_front(tmp_path: Path, version: str) -> None:
    lines = [
        line.replace(",Type,", ",,").replace(",Name,", ",,").replace(",ID,", ",,")
        for line in MOTIVE_1_25
        if ",Parent" not in line
    ]
    streams = read(write(tmp_path / "take.csv", lines[0].replace("1.25", version), *lines[1:]))
    np.testing.assert_allclose(positions(streams["boom"]), [[1.0, 2.0, 3.0]] * 2)


@pytest.mark.parametrize("order", ["".join(axes) for axes in permutations("XYZ")])
def test_motive_euler_angles_in_each_order(tmp_path: Path, order: str) -> None:
    rotation = Rotation.from_quat([[0.1, -0.4, 0.3, 0.85], [0.3, 0.2, -0.6, 0.7]])
    angles = rotation.as_euler(order, degrees=True)
    kind, name, channel = ",Rigid Body" * 6, ",boom" * 6, ",Rotation" * 3 + ",Position" * 3
    for header in (order, f"Euler {order}"):
        rows = [f"{i},{i / 100}," + ",".join(map(str, angles[i])) + ",1,2,3" for i in range(2)]
        axes = ",".join(order) + ",X,Y,Z"
        first = f"Format Version,1.23,Rotation Type,{header},Length Units,Meters,Coordinate Space,Global"
        path = write(
            tmp_path / "t.csv",
            first,
            "",
            f",Type{kind}",
            f",Name{name}",
            f",ID{name}",
            f",{channel}",
            f"Frame,Time (Seconds),{axes}",
            *rows,
        )
        (stream,) = read(path).values()
        read_back = Rotation.from_quat(quaternions(stream))
        assert (read_back.inv() * rotation).magnitude().max() < 1e-12
        assert MotiveReader().unstated(path) == {}


RECORDS = (
    'comment,"OptiTrack export"',
    "righthanded",
    "info,version,1.1",
    "info,framecount,3",
    "info,rigidbodycount,1",
    'rigidbody,"boom",7,3,0,0,0,1,1,1,2,2,2',
    "frame,0,0.00,1,7,1,2,3,0,0,0,1,0,0,0,2,4,5,6,11,M1,7,8,9,12,",
    'rigidbody,0,0.00,"boom",7,0,3,0,0,0',
    "frame,1,0.01,0,1,4,5,6,11,M1",
    "frame,2,0.02,1,7,-1.#IND,2,3,0,0,0.6,0.8,0,0,0,0",
)


def test_motive_1_1_records(tmp_path: Path) -> None:
    path = write(tmp_path / "take.csv", *RECORDS)
    assert MotiveReader().unstated(path) == {"length_unit": "m"}
    streams = read(path, length_unit="m")
    np.testing.assert_allclose(positions(streams["boom"]), [[1, 2, 3], [np.nan] * 3, [np.nan, 2, 3]])
    np.testing.assert_allclose(quaternions(streams["boom"])[2], [0, 0, 0.6, 0.8])
    np.testing.assert_allclose(positions(streams["M1"]), [[4, 5, 6], [4, 5, 6], [np.nan] * 3])
    np.testing.assert_allclose(positions(streams["marker 12"])[0], [7, 8, 9])
    np.testing.assert_array_equal(streams["boom"].stamps["capture"], [0, 10_000_000, 20_000_000])
    path = write(tmp_path / "cut.csv", *RECORDS, "frame,3,0.03,1,7,1,2")
    assert read(path, length_unit="m")["boom"].losses == ("cut.csv: line 11 is cut or damaged and has been left out",)
    for lines, message in (
        (("lefthanded", "info,version,1.1"), "left-handed coordinates; expected right-handed ones"),
        (("info,version,1.0",), "format version '1.0'; expected 1.1 for a file of records"),
        (("comment,x", "info,version,1.1"), "no frames"),
    ):
        with pytest.raises(InputError, match=message):
            read(write(tmp_path / "bad.csv", *lines), length_unit="m")


def test_motive_rows_and_heads_that_do_not_fit_are_named(tmp_path: Path) -> None:
    lines = list(MOTIVE_1_25)
    cases = {
        "row 3 below the head: more than 21 cells; expected 21 cells a row": [*lines, "2,0.1" + ",1" * 20],
        r"rows that do not fit the head \(.*line 11, saw 32\)": [*lines, "2,0.1" + ",1" * 30],
        "no column 'Time'": [line.replace("Time (Seconds)", "Zeit") for line in lines],
        "only Skeleton; expected one of: Rigid Body": [
            ",Type" + ",Skeleton" * 6 if line.startswith(",Type") else line for line in lines
        ],
        "no time in row 2": [*lines[:-1], "1,,"],
        "2 head rows": [lines[0], *lines[2:4], lines[-3], lines[-2]],
    }
    for message, text in cases.items():
        with pytest.raises(InputError, match=message):
            read(write(tmp_path / "take.csv", *text))


TRC = (
    "PathFileType\t4\t(X/Y/Z)\tx.trc",
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate",
    "100.00\t100.00\t2\t2\tmm\t100.00",
    "Frame#\tTime\ttip\t\t\ttip\t\t",
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
    "",
    "1\t0.00\t1000\t2000\t3000\t\t\t",
    "2\t0.01\t1001\t2000\t3000\t1\t2\t3",
)


def test_trc_with_tabs_and_with_commas(tmp_path: Path) -> None:
    for separator in ("\t", ","):
        streams = read(write(tmp_path / "x.trc", *(line.replace("\t", separator) for line in TRC)))
        np.testing.assert_allclose(positions(streams["tip"]), [[1, 2, 3], [1.001, 2, 3]])
        np.testing.assert_allclose(positions(streams["tip#2"]), [[np.nan] * 3, [0.001, 0.002, 0.003]])
        assert streams["tip"].losses == ()
    cut = write(tmp_path / "x.trc", *TRC)
    cut.write_bytes(cut.read_bytes()[:-4])
    streams = read(cut)
    assert len(streams["tip"]) == 1
    assert streams["tip"].losses[1] == "x.trc: 1 frames instead of the 2 that the head states"
    with pytest.raises(InputError, match="no marker 'top'; expected 'tip'"):
        read(write(tmp_path / "x.trc", *TRC), streams=frozenset({"top"}))
    with pytest.raises(InputError, match="expected 'PathFileType' as a TRC file begins"):
        read(write(tmp_path / "x.trc", "hello"))


def test_real_trc_files(shared_data: Path) -> None:
    gait = read(shared_data / "mocap_files/Gait.trc")
    assert len(gait) == 33
    assert len(gait["R.Shoulder"]) == 487
    assert "218 rows are longer than the head" in gait["C7"].losses[0]
    height = gait["C7"].columns["z"]
    assert 1.2 < np.nanmedian(height) < 1.8
    markers = read(shared_data / "mocap_files/markers.trc")
    assert len(markers) == 51
    assert "93 frames instead of the 652" in markers["STER"].losses[0]


VICON = (
    "Segments",
    "100",
    ",,crane:boom,,,,,",
    "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ",
    ",,deg,deg,deg,mm,mm,mm",
    "1,0,10,20,30,1000,2000,3000",
    "2,0,10,20,30,1000,,3000",
    "",
    "Devices",
    "200",
    ",,Valve - Voltage,",
    "Frame,Sub Frame,Pin1,Pin2",
    ",,V,V",
    "1,0,0.5,1",
    "1,1,0.6,2",
    "2,0,0.7,3",
    "2,1,0.8,4",
    "",
    "Trajectories",
    "100",
    ",,crane:tip,,,crane:boom,,",
    "Frame,Sub Frame,X,Y,Z,X,Y,Z",
    ",,mm,mm,mm,mm,mm,mm",
    "1,0,1,2,3,4,5,6",
    "2,0,,,,4,5,6",
)


@pytest.mark.parametrize("separator", [",", "\t"])
def test_vicon_sections(tmp_path: Path, separator: str) -> None:
    path = write(tmp_path / "trial.csv", *(line.replace(",", separator) for line in VICON))
    streams = read(path)
    assert set(streams) == {"crane:boom", "Valve - Voltage", "crane:tip", "crane:boom (Trajectories)"}
    np.testing.assert_allclose(positions(streams["crane:boom"]), [[1, 2, 3], [1, np.nan, 3]])
    assert streams["crane:boom"].units == {"x": "m", "y": "m", "z": "m", "RX": "deg", "RY": "deg", "RZ": "deg"}
    np.testing.assert_array_equal(streams["Valve - Voltage"].stamps["capture"], np.arange(4) * 5_000_000)
    np.testing.assert_allclose(streams["Valve - Voltage"].columns["Pin2"], [1, 2, 3, 4])
    assert streams["Valve - Voltage"].units["Pin1"] == "V"
    np.testing.assert_allclose(positions(streams["crane:tip"]), [[0.001, 0.002, 0.003], [np.nan] * 3])
    path.write_bytes(path.read_bytes()[:-3])
    assert len(read(path)["crane:tip"]) == 1


def test_real_vicon_export(shared_data: Path) -> None:
    streams = read(shared_data / "mocap_files/markers.csv")
    assert len(streams) == 51
    box = positions(streams["boite:gauche_ext"])
    np.testing.assert_allclose(box[0], [0.0441628, -0.276862, 0.675697])
    np.testing.assert_array_equal(streams["boite:gauche_ext"].stamps["capture"][:2], [0, 10_000_000])
    # Two markers of one box keep their distance.
    other = positions(streams["boite:gauche_int"])
    distance = np.linalg.norm(box - other, axis=1)
    assert np.nanstd(distance) < 1e-3


def test_vicon_heads_that_make_no_sense_are_named(tmp_path: Path) -> None:
    cases = {
        "rate 'fast'; expected a number of Hz": ("Trajectories", "fast", *VICON[20:]),
        "no columns .*expected 'Frame', 'Sub Frame' and axes": ("Trajectories", "100", "", "X,Y"),
        "no frames; expected a section such as 'Trajectories'": ("Events", "100", "Subject,Context"),
    }
    for message, lines in cases.items():
        with pytest.raises(InputError, match=rf"trial\.csv.*{message}"):
            read(write(tmp_path / "trial.csv", *lines))


def qualisys_3d(*extra: str) -> list[str]:
    return [
        *extra, "NO_OF_FRAMES\t2", "NO_OF_CAMERAS\t7", "NO_OF_MARKERS\t2", "FREQUENCY\t120", "NO_OF_ANALOG\t0",
        "DESCRIPTION\t--", "TIME_STAMP\t2014-06-17, 08:53:44\t912.5", "DATA_INCLUDED\t3D", "EVENT\tstart\t1\t0.0",
        "MARKER_NAMES\ttip\tboom 1", "TRAJECTORY_TYPES\tMeasured\tMeasured",
    ]  # fmt: skip


@pytest.mark.parametrize("before", [0, 1, 2])
def test_qualisys_markers_with_and_without_frame_and_time(tmp_path: Path, before: int) -> None:
    front = [["", "1\t", "1\t0.00000\t"][before], ["", "2\t", "2\t0.00833\t"][before]]
    head = [] if before < 2 else ["Frame\tTime\ttip X\ttip Y\ttip Z\tboom 1 X\tboom 1 Y\tboom 1 Z"]
    extra = ["FILE_VERSION\t2.0.0"] if before == 2 else []
    rows = [f"{front[0]}1000.000\t2000.000\t3000.000\t0.000\t0.000\t0.000\t", f"{front[1]}1\t2\t3\t\t\t\t"]
    streams = read(write(tmp_path / "m.tsv", *qualisys_3d(*extra), *head, *rows))
    np.testing.assert_allclose(positions(streams["tip"]), [[1, 2, 3], [0.001, 0.002, 0.003]])
    assert np.isnan(positions(streams["boom 1"])).all()
    np.testing.assert_allclose(streams["tip"].stamps["capture"], [0, 8_330_000], atol=5_000)


def test_qualisys_bodies_are_read_from_their_matrix(tmp_path: Path) -> None:
    """The row is of a published measurement: angles of −0.656°, 0.094°, 0.058° about x, y, z beside the matrix."""
    row = (
        "-194.91974\t2.24150\t0.99661\t-0.65630\t0.09391\t0.05772\t4.98536\t"
        "1.00000\t0.00099\t-0.00165\t-0.00101\t0.99993\t-0.01145\t0.00164\t0.01145\t0.99993"
    )
    lines = [
        "NO_OF_FRAMES\t2", "NO_OF_BODIES\t1", "FREQUENCY\t100", "DATA_INCLUDED\t6D", "BODY_NAMES\tPSVH",
        "Frame\tTime\tPSVH X\tY\tZ\tRoll\tPitch\tYaw\tResidual\t" + "\t".join(f"Rot[{i}]" for i in range(9)),
        f"1\t0.00000\t{row}", "2\t0.01000\t" + "\t".join(["0.000"] * 16),
    ]  # fmt: skip
    (body,) = read(write(tmp_path / "b_6D.tsv", *lines)).values()
    assert body.kind == "Rigid Body"
    np.testing.assert_allclose(positions(body)[0], [-0.19491974, 0.0022415, 0.00099661])
    angles = Rotation.from_quat(quaternions(body)[0]).as_euler("xyz", degrees=True)
    np.testing.assert_allclose(angles, [-0.65630, 0.09391, 0.05772], atol=2e-3)
    assert np.isnan(positions(body)[1]).all()
    assert np.isnan(quaternions(body)[1]).all()


def test_qualisys_heads_that_make_no_sense_are_named(tmp_path: Path) -> None:
    good = qualisys_3d()
    cases: dict[str, list[str]] = {
        "DATA_INCLUDED '2D'; expected '3D' or '6D'": [*(line.replace("3D", "2D") for line in good), "1\t2"],
        r"line 12: 4 columns; expected 3 for each of 2 names, frame and time": [*good, "1\t2\t3\t4"],
        "FREQUENCY: 'EXT'; expected a rate in Hz": [
            *(line.replace("\t120", "\tEXT") for line in good),
            "1\t" + "\t".join("123456"),
        ],
        "a header but no frames": good,
    }
    for message, lines in cases.items():
        with pytest.raises(InputError, match=rf"m\.tsv.*{message}"):
            read(write(tmp_path / "m.tsv", *lines))


def trc_lines(table: np.ndarray, separator: str = "\t") -> list[str]:
    rows = [separator.join([str(i + 1), f"{i / 100:.2f}", *(f"{value:g}" for value in row)]) for i, row in enumerate(table)]
    return [line.replace("\t", separator) for line in TRC[:6]] + rows


def vicon_lines(table: np.ndarray, separator: str = ",") -> list[str]:
    head = "Trajectories", "100", ",,tip,,,end,,", "Frame,Sub Frame,X,Y,Z,X,Y,Z", ",,mm,mm,mm,mm,mm,mm"
    rows = [",".join([str(i + 1), "0", *(f"{value:g}" for value in row)]) for i, row in enumerate(table)]
    return [line.replace(",", separator) for line in (*head, *rows)]


def qualisys_lines(table: np.ndarray) -> list[str]:
    rows = ["\t".join([str(i + 1), f"{i / 120:.5f}", *(f"{value:g}" for value in row)]) for i, row in enumerate(table)]
    return [*qualisys_3d(), *rows]


def motive_lines(table: np.ndarray) -> list[str]:
    head = (
        "Format Version,1.23,Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
        "",
        ",Type" + ",Marker" * 6,
        ",Name,tip,tip,tip,end,end,end",
        ",ID,1,1,1,2,2,2",
        "," + ",Position" * 6,
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z",
    )
    return [*head, *(",".join([str(i), f"{i / 100:.2f}", *(f"{v:g}" for v in row)]) for i, row in enumerate(table))]


EXPORTS: dict[str, tuple[str, Callable[[np.ndarray], list[str]]]] = {
    "trc": ("m.trc", trc_lines), "vicon": ("m.csv", vicon_lines), "qualisys": ("m.tsv", qualisys_lines),
    "motive": ("m.csv", motive_lines),
}  # fmt: skip


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), kind=st.sampled_from(sorted(EXPORTS)), frames=st.integers(1, 6))
def test_a_marker_exactly_in_the_origin_is_missing_and_counted_in_every_export(
    tmp_path: Path, data: st.DataObject, kind: str, frames: int
) -> None:
    cells = st.lists(st.sampled_from([0.0, 0.0, 1.0, -2.5]), min_size=6 * frames, max_size=6 * frames)
    table = np.array(data.draw(cells)).reshape(frames, 6)
    name, lines = EXPORTS[kind]
    path = write(tmp_path / name, *lines(table))
    streams = read(path)
    assert reader_for(path).name == kind
    lost = 0
    for number, stream in enumerate(streams.values()):
        own = table[:, 3 * number : 3 * number + 3]
        zero = (own == 0.0).all(axis=1)
        lost += int(zero.sum())
        np.testing.assert_allclose(positions(stream), np.where(zero[:, None], np.nan, own * 1e-3))
    said = [loss for stream in streams.values() for loss in stream.losses if "exactly in the origin" in loss]
    assert bool(said) == bool(lost)
    assert all(f"{name}: {lost} points exactly in the origin are treated as not visible: " in loss for loss in said)


#: Exports whose cells are not separated by commas.
TABBED: dict[str, Callable[[np.ndarray], list[str]]] = {
    "m.trc": trc_lines,
    "semicolons.trc": lambda table: trc_lines(table, ";"),
    "m.tsv": qualisys_lines,
    "m.csv": lambda table: vicon_lines(table, "\t"),
    "semicolons.csv": lambda table: vicon_lines(table, ";"),
}


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(sorted(TABBED)),
    values=st.lists(st.integers(1, 10**7).map(lambda n: n / 1000), min_size=6, max_size=24),
    mark=st.sampled_from(",."),
)
def test_decimal_commas_are_decimal_marks_in_every_export(tmp_path: Path, name: str, values: list[float], mark: str) -> None:
    table = np.array(values[: 6 * (len(values) // 6)]).reshape(-1, 6)
    lines = TABBED[name](np.round(table, 3))
    head = len(lines) - len(table)
    path = write(tmp_path / name, *lines[:head], *(line.replace(".", mark) for line in lines[head:]))
    streams = list(read(path).values())
    expected = np.array([[float(f"{value:g}") for value in row] for row in np.round(table, 3)])
    np.testing.assert_allclose(np.hstack([positions(stream) for stream in streams]), 1e-3 * expected, rtol=1e-12)
    steps = np.diff(streams[0].stamps["capture"])
    assert np.all(np.abs(steps - (8_333_333 if name == "m.tsv" else 10_000_000)) < 10_000)


@pytest.mark.parametrize("name", sorted(TABBED))
@pytest.mark.parametrize("cell", ["1.234,5", "1,234.5", "12.5", "1 234,5"])
def test_a_second_decimal_mark_is_refused(tmp_path: Path, name: str, cell: str) -> None:
    table = np.full((4, 6), 1.5)
    table[2, 3] = 77.0
    lines = [line.replace(".", ",") for line in TABBED[name](table)]
    head = len(lines) - 4
    path = write(tmp_path / name, *TABBED[name](table)[:head], *(line.replace("77", cell) for line in lines[head:]))
    with pytest.raises(
        InputError, match=rf"{name}: row 3 below the head: '{cell}'; expected numbers with a decimal comma as above"
    ):
        read(path)


def test_a_separator_is_the_first_in_its_line(tmp_path: Path) -> None:
    lines = [TRC[0].replace("x.trc", "a;b.trc"), *TRC[1:]]
    for separator in ("\t", ","):
        streams = read(write(tmp_path / "x.trc", *(line.replace("\t", separator) for line in lines)))
        np.testing.assert_allclose(positions(streams["tip"]), [[1, 2, 3], [1.001, 2, 3]])


def test_commas_that_separate_cells_and_decimals_are_refused(tmp_path: Path) -> None:
    lines = trc_lines(np.full((3, 6), 1.5), ",")
    path = write(tmp_path / "x.trc", *lines[:6], *(line.replace(".", ",") for line in lines[6:]))
    with pytest.raises(
        InputError, match=r"line 7: 15 cells for 8 numbers: commas separate cells and decimals; .*again with tabs"
    ):
        read(path)


def test_a_row_of_commas_that_is_longer_than_the_head_is_refused(tmp_path: Path) -> None:
    """Its commas may be decimal marks, beside markers that are not visible."""
    lines = trc_lines(np.full((3, 6), 1.5), ",")
    lines[7] = "2,0,010,1,500,1,500,1,500,,,"
    with pytest.raises(InputError, match=r"x\.trc: row 2 below the head: more than 8 cells|rows that do not fit the head"):
        read(write(tmp_path / "x.trc", *lines))


def test_qualisys_counts_a_first_row_in_which_nothing_is_visible(tmp_path: Path) -> None:
    streams = read(write(tmp_path / "m.tsv", *qualisys_3d(), "\t" * 5, "\t".join(["1", "2", "3", "4", "5", "6"])))
    np.testing.assert_allclose(positions(streams["tip"]), [[np.nan] * 3, [0.001, 0.002, 0.003]])
    assert len(streams["tip"]) == 2


def test_cells_that_are_no_numbers_are_counted(tmp_path: Path) -> None:
    lines = trc_lines(np.full((3, 6), 1.5))
    lines[7] = lines[7].replace("1.5", "lost", 3)
    stream = read(write(tmp_path / "x.trc", *lines))["tip"]
    assert np.isnan(positions(stream)[1]).all()
    assert stream.losses[0] == "x.trc: 3 cells are no numbers and are taken as missing"


WORDS = st.sampled_from(["Arm", "X", "Y", "Xtra", "arm_1", "ARM_1", "Time", "Frame", "Z"])


@settings(max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.data(),
    names=st.lists(st.lists(WORDS, min_size=1, max_size=3).map(" ".join), min_size=1, max_size=4, unique=True),
    before=st.integers(0, 2),
    column_names=st.booleans(),
    last_tab=st.booleans(),
)
def test_qualisys_heads_are_read_by_their_structure(
    tmp_path: Path, data: st.DataObject, names: list[str], before: int, column_names: bool, last_tab: bool
) -> None:
    """Any name of a marker; with and without frame, time, names of the columns and a tab behind the last cell."""
    seen = np.array(data.draw(st.lists(st.booleans(), min_size=3 * len(names), max_size=3 * len(names)))).reshape(3, -1)
    seen[data.draw(st.integers(0, 2))] = True  # without names of columns the last marker shows where the rows end
    end = "\t" if last_tab else ""
    lines = [line for line in qualisys_3d() if not line.startswith("MARKER_NAMES")]
    lines.append("MARKER_NAMES\t" + "\t".join(names))
    if column_names:
        axes = [f"{name} {axis}" for name in names for axis in "XYZ"]
        lines.append("\t".join([*("Frame", "Time")[:before], *axes]) + end)
    for row in range(3):
        cells = [cell for there in seen[row] for cell in (["1.5", "2", "3"] if there else [""] * 3)]
        lines.append("\t".join([*(str(row + 1), f"{row / 120:.5f}")[:before], *cells]) + end)
    streams = read(write(tmp_path / "m.tsv", *lines))
    assert list(streams) == names
    for number, stream in enumerate(streams.values()):
        expected = np.where(seen[:, number, None], [0.0015, 0.002, 0.003], np.nan)
        np.testing.assert_allclose(positions(stream), expected)


def damaged_text(draw: Callable[[Any], Any], text: bytes) -> bytes:
    """``text`` with some cells, lines or bytes changed, doubled or gone."""
    lines = text.split(b"\n")
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1))
        cells = lines[at].split(b",")
        match draw(st.sampled_from(["cell", "drop cell", "drop line", "double", "bytes"])):
            case "cell":
                cells[draw(st.integers(0, len(cells) - 1))] = draw(
                    st.sampled_from([b"", b"x", b"-1", b"1e999", b"nan", b'"', b"9" * 40])
                )
                lines[at] = b",".join(cells)
            case "drop cell":
                lines[at] = b",".join(cells[1:])
            case "drop line" if len(lines) > 1:
                del lines[at]
            case "double":
                lines.insert(at, lines[at])
            case _:
                lines[at] = draw(st.binary(max_size=20))
    return b"\n".join(lines)[: draw(st.integers(1, len(text) + 50))]


@settings(max_examples=examples(250), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.data(),
    sample=st.sampled_from(
        [
            ("take.csv", MOTIVE_1_25),
            ("take.csv", RECORDS),
            ("x.trc", tuple(line.replace("\t", ",") for line in TRC)),
            ("trial.csv", VICON),
        ]
    ),
)
def test_any_damage_to_a_text_export_ends_in_streams_or_a_reason(
    tmp_path: Path, data: st.DataObject, sample: tuple[str, tuple[str, ...]]
) -> None:
    name, lines = sample
    path = tmp_path / name
    path.write_bytes(damaged_text(data.draw, "\n".join([*lines, ""]).encode()))
    streams, refusal = attempt(
        InputError, lambda: reader_for(path).read(path, ReadOptions(length_unit=data.draw(st.sampled_from([None, "mm"]))))
    )
    assert streams is not None or name in refusal
    for stream in streams or ():
        assert all(len(values) == len(stream) for values in stream.columns.values())


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_to_a_qualisys_export_ends_in_streams_or_a_reason(tmp_path: Path, data: st.DataObject) -> None:
    text = "\n".join([*qualisys_3d(), "1\t2\t3\t4\t5\t6", "1\t2\t3\t4\t5\t6", ""]).replace("\t", ",").encode()
    path = tmp_path / "m.tsv"
    path.write_bytes(damaged_text(data.draw, text).replace(b",", b"\t"))
    streams, refusal = attempt(InputError, lambda: reader_for(path).read(path, ReadOptions()))
    assert streams is not None or "m.tsv" in refusal


def test_an_export_is_known_by_what_it_begins_with(tmp_path: Path, shared_data: Path) -> None:
    files = {
        "mocap_files/motive_1.21_quaternion.csv": "motive", "mocap_files/markers.csv": "vicon", "mocap_files/Gait.trc": "trc",
        "mcap_bags/motor_data.csv": "csv", "mcap_bags/tf_example.db3": "rosbag2", "mcap_bags/wbag_0.mcap": "mcap",
        "mcap_bags/fake_joint_state.bag": "rosbag1", "emps/DATA_EMPS.mat": "mat",
    }  # fmt: skip
    assert {name: reader_for(shared_data / name).name for name in files} == files
    marked = tmp_path / "take.csv"
    marked.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([*MOTIVE_1_25, ""]).encode())
    assert isinstance(reader_for(marked), MotiveReader)
    assert "boom" in read(marked)


@pytest.mark.parametrize("first", ["comment,time,x", "Devices,time", "info,time", "Events;time"])
def test_a_plain_table_is_not_mistaken_for_an_export(tmp_path: Path, first: str) -> None:
    assert reader_for(write(tmp_path / "a.csv", first, "1,2,3")).name == "csv"
