"""C3D: every storage a file may use gives the same numbers; real files of five systems; damage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import numpy.typing as npt
import pytest
from c3d_writer import PROCESSORS, Writer, trial
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.c3d import read_c3d
from sysid.logs.limits import Budget

Array = npt.NDArray[np.float64]
REAL = ("BTS.c3d", "OptiTrack_walking.c3d", "Optotrak.c3d", "Qualisys.c3d", "Vicon.c3d")


def read(path: Path, *streams: str, **options: Any) -> dict[str, Stream]:
    chosen = ReadOptions(streams=frozenset(streams) or None, **options)
    return {stream.name: stream for stream in reader_for(path).read(path, chosen)}


@pytest.mark.parametrize("integers", [False, True])
@pytest.mark.parametrize("processor", PROCESSORS)
def test_every_storage_gives_the_same_numbers(processor: str, integers: bool, tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "trial.c3d"
    more = {"ANALOG:SCALE": (2, 3), "ANALOG:OFFSET": (10, -20), "ANALOG:GEN_SCALE": 0.25, "ANALOG:UNITS": ["V", "N"]}
    residuals = np.zeros(points.shape[:2])
    residuals[4, 1] = -1
    path.write_bytes(Writer(processor, integers).file(points, analog, more, residuals=residuals))
    streams = read(path)
    assert list(streams) == ["body:Marker1", "body:Marker2", "body:Marker3", "analog"]
    expected = points * (0.5 if integers else 1.0) * 1e-3
    expected[4, 1] = np.nan
    for index in range(3):
        stream = streams[f"body:Marker{index + 1}"]
        np.testing.assert_allclose(np.column_stack([stream.columns[a] for a in "xyz"]), expected[:, index], rtol=1e-12)
        assert stream.units == {"x": "m", "y": "m", "z": "m"}
    np.testing.assert_array_equal(np.diff(stream.stamps["capture"]), 20_000_000)
    volts = streams["analog"]
    assert volts.units == {"V1": "V", "V2": "N"}
    raw = analog.reshape(-1, 2)
    np.testing.assert_allclose(volts.columns["V1"], (raw[:, 0] - 10) * 2 * 0.25)
    np.testing.assert_allclose(volts.columns["V2"], (raw[:, 1] + 20) * 3 * 0.25)
    np.testing.assert_array_equal(np.diff(volts.stamps["capture"]), 5_000_000)


@settings(max_examples=examples(60), deadline=None)
@given(
    rates=st.tuples(st.sampled_from([None, 0.0, 25.0, 50.0]), st.sampled_from([0.0, 50.0, 120.0])),
    zero_scale=st.booleans(),
    integers=st.booleans(),
    processor=st.sampled_from(list(PROCESSORS)),
)
def test_a_parameter_of_zero_is_not_stated(
    rates: tuple[float | None, float],
    zero_scale: bool,
    integers: bool,
    processor: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """The header's rate and scale count then, as in ezc3d; a contradiction is said and the parameter counts."""
    points, analog = trial()
    path = tmp_path_factory.getbasetemp() / "zero.c3d"
    parameters: dict[str, Any] = {"POINT:RATE": rates[0]} | ({"POINT:SCALE": 0.0} if zero_scale else {})
    writer = Writer(processor, integers)
    data = bytearray(writer.file(points, analog, parameters))
    data[20:24] = writer.floats([rates[1]])
    path.write_bytes(data)
    if not rates[0] and not rates[1]:
        with pytest.raises(InputError, match=r"zero\.c3d: a rate of 0\.0 frames a second"):
            read(path)
        return
    stream = read(path)["body:Marker1"]
    rate = rates[0] or rates[1]
    np.testing.assert_allclose(np.diff(stream.stamps["capture"]), 1e9 / rate, atol=1)
    np.testing.assert_allclose(stream.columns["x"], points[:, 0, 0] * 1e-3 * (0.5 if integers else 1.0))
    differ = bool(rates[0] and rates[1] and rates[0] != rates[1])
    assert [loss.split(": ")[1] for loss in stream.losses] == [
        *(["POINT:RATE is 0"] if rates[0] == 0.0 else []),
        *([f"POINT:RATE is {rate:g}, the header states {rates[1]:g}"] if differ else []),
        *(["POINT:SCALE is 0"] if zero_scale else []),
    ]


def test_a_scale_of_zero_everywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flat.c3d"
    data = bytearray(Writer(integers=True).file(*trial(), {"POINT:SCALE": 0.0}))
    data[12:16] = bytes(4)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"flat\.c3d: a scale of 0\.0; expected a number other than zero"):
        read(path)


def test_zeros_of_a_model_output_are_values(tmp_path: Path) -> None:
    points, analog = trial()
    points[3, 1] = 0.0
    path = tmp_path / "trial.c3d"
    forces = {"POINT:FORCES": ["body:Marker2"], "POINT:FORCE_UNITS": ["N"]}
    path.write_bytes(Writer().file(points, analog, forces))
    stream = read(path)["body:Marker2"]
    assert (stream.columns["x"][3], stream.losses) == (0.0, ())


def test_unsigned_analog_samples(tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "trial.c3d"
    analog[:] = -1.0  # 65535 as an unsigned word
    unsigned = {"ANALOG:FORMAT": ["UNSIGNED"], "ANALOG:OFFSET": (-32768, -32768)}
    path.write_bytes(Writer(integers=True).file(points, analog, unsigned))
    np.testing.assert_array_equal(read(path)["analog"].columns["V1"], 65535.0 - 32768.0)


@pytest.mark.parametrize("name", REAL)
def test_real_files_hold_what_ezc3d_reads(name: str, shared_data: Path) -> None:
    path = shared_data / "mocap_files" / name
    ours, theirs = read_c3d(path, Budget.of(path.stat().st_size)), ezc3d.c3d(str(path))
    np.testing.assert_array_equal(ours.points, theirs["data"]["points"][:3].transpose(2, 1, 0))
    if ours.analog.size:
        np.testing.assert_array_equal(ours.analog, theirs["data"]["analogs"][0].T)
    assert ours.rate == theirs["parameters"]["POINT"]["RATE"]["value"][0]
    assert ours.first == theirs["header"]["points"]["first_frame"]
    assert list(ours.texts("POINT:LABELS")) == theirs["parameters"]["POINT"]["LABELS"]["value"]


def test_real_files_as_streams(shared_data: Path) -> None:
    folder = shared_data / "mocap_files"
    shapes = {}
    for name in REAL:
        streams = read(folder / name)
        markers = [stream for stream in streams.values() if stream.name != "analog"]
        missing = float(np.mean([np.isnan(stream.columns["x"]) for stream in markers]))
        shapes[name] = (len(markers), len(markers[0]), round(missing, 3), len(streams["analog"]) if "analog" in streams else 0)
    assert shapes == {
        "BTS.c3d": (22, 675, 0.516, 6750),
        "OptiTrack_walking.c3d": (12, 3361, 0.074, 0),
        "Optotrak.c3d": (54, 29, 0.038, 0),
        "Qualisys.c3d": (55, 340, 0.0, 3400),
        "Vicon.c3d": (51, 580, 0.01, 11600),
    }
    cut = read(folder / "Optotrak.c3d")["Marker_1"]
    assert cut.losses == ("Optotrak.c3d: the file is cut off: 29 of 1149 frames are there",)
    # A trial that was cropped keeps its time: frame 705 of 200 a second.
    assert read(folder / "Qualisys.c3d", "L_IAS")["L_IAS"].stamps["capture"][0] == 3_520_000_000


def test_more_than_65535_frames(tmp_path: Path) -> None:
    points = np.ones((70_000, 1, 3))
    path = tmp_path / "long.c3d"
    actual = {"TRIAL:ACTUAL_START_FIELD": (1, 0), "TRIAL:ACTUAL_END_FIELD": (70_000 - 65_536, 1)}
    data = bytearray(Writer().file(points, np.zeros((70_000, 0, 0)), actual))
    data[8:10] = b"\xff\xff"  # the header's last frame runs over
    path.write_bytes(data)
    stream = read(path)["body:Marker1"]
    assert (len(stream), stream.losses) == (70_000, ())


def test_what_lies_exactly_in_the_origin_was_not_seen(tmp_path: Path) -> None:
    points, analog = trial()
    points[[2, 3], 1] = 0.0
    path = tmp_path / "trial.c3d"
    path.write_bytes(Writer().file(points, analog))
    stream = read(path, "body:Marker2")["body:Marker2"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(stream.columns["x"])), [2, 3])
    assert stream.losses == ("trial.c3d: 2 points exactly in the origin are treated as not visible: body:Marker2 2",)


def test_angles_of_a_model_are_no_lengths(tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "trial.c3d"
    path.write_bytes(Writer().file(points, analog, {"POINT:ANGLES": ["body:Marker2"], "POINT:ANGLE_UNITS": ["deg"]}))
    streams = read(path)
    assert streams["body:Marker2"].units["x"] == "deg"
    np.testing.assert_allclose(streams["body:Marker2"].columns["x"], points[:, 1, 0])
    np.testing.assert_allclose(streams["body:Marker1"].columns["x"], 1e-3 * points[:, 0, 0])


def test_a_file_without_a_unit_needs_the_recipe_to_state_one(tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "trial.c3d"
    path.write_bytes(Writer().file(points, analog, {"POINT:UNITS": None}))
    with pytest.raises(InputError, match=r'states no length unit.*`length_unit = "m"`'):
        read(path)
    stream = read(path, length_unit="cm")["body:Marker1"]
    np.testing.assert_allclose(stream.columns["y"], 1e-2 * points[:, 0, 1])


def test_a_unit_that_contradicts_the_recipe_is_refused(tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "trial.c3d"
    path.write_bytes(Writer().file(points, analog))
    with pytest.raises(InputError, match=r"the file states \[mm\]; expected \[m\] as in the recipe"):
        read(path, length_unit="m")


def test_labels_that_are_missing_or_double(tmp_path: Path) -> None:
    points, analog = trial(markers=4)
    path = tmp_path / "trial.c3d"
    path.write_bytes(Writer().file(points, analog, {"POINT:LABELS": ["tip", "tip", ""]}))
    assert list(read(path))[:4] == ["tip", "tip#2", "point 3", "point 4"]
    with pytest.raises(InputError, match=r"no point 'top'; expected 'tip'\?"):
        read(path, "top")


def test_a_cut_off_file_gives_what_is_left_of_it(tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "trial.c3d"
    path.write_bytes(Writer().file(points, analog)[: -(3 * (4 * 3 + 8) * 4) + 5])
    stream = read(path)["body:Marker3"]
    np.testing.assert_allclose(stream.columns["z"], 1e-3 * points[:9, 2, 2])
    assert stream.losses == ("trial.c3d: the file is cut off: 9 of 12 frames are there",)


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        (1, 0x51, "second byte 51; expected 50"),
        (0, 200, r"parameters in block 200; expected one of the \d+ blocks"),
        (515, 90, r"processor type 90; expected 84 \(Intel\)"),
        (2, 255, r"frames of \d+ bytes from block 3 on|POINT:USED"),
        (4, 99, r"2 channels of 4 samples a frame but 99 in the header"),
        (16, 250, r"frames of \d+ bytes from block 250 on; expected at least one"),
    ],
)
def test_headers_that_do_not_fit_the_file(at: int, value: int, reason: str, tmp_path: Path) -> None:
    points, analog = trial()
    path = tmp_path / "bad.c3d"
    parameters = {"POINT:USED": None} if at == 2 else None
    data = bytearray(Writer().file(points, analog, parameters))
    data[at] = value
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"bad\.c3d: {reason}"):
        read(path)


@settings(max_examples=examples(150), deadline=2000)
@given(data=st.data())
def test_damage_is_reported_never_a_crash(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.c3d"
    content = bytearray(Writer(data.draw(st.sampled_from(list(PROCESSORS)))).file(*trial()))
    for _ in range(data.draw(st.integers(1, 8))):
        end = data.draw(st.sampled_from([24, 1024, len(content)]))
        content[data.draw(st.integers(0, end - 1))] = data.draw(st.sampled_from([0, 1, 127, 128, 255]))
    path.write_bytes(content[: data.draw(st.integers(1, len(content)))])
    message, streams = "", {}
    try:
        streams = read(path)
    except InputError as error:
        message = str(error)
    assert str(path) in message or streams
    assert all(len(column) == len(stream) for stream in streams.values() for column in stream.columns.values())
