"""The shipped logs, ingested by their recipe, against what the simulated test bench knows to be true."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simulated_bench import load_recipe, simulate
from sysid.datasets import Dataset, Store, ingest
from sysid.errors import InputError, SysidError

AUTOLOG = Path(__file__).parents[2] / "datasets/autolog"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return ingest(AUTOLOG, tmp_path_factory.mktemp("workspace"))


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    recordings: dict[str, Any] = json.loads((AUTOLOG / "logs/truth.json").read_text())["recordings"]
    return recordings


def test_recordings_and_splits(dataset: Dataset) -> None:
    assert len(dataset.of_kind("motion")) == 6
    assert [len(dataset.with_role(role)) for role in ("fit", "select", "held_out")] == [3, 2, 1]
    assert dataset.with_role("held_out")[0].name == "manual-06"
    assert len(dataset.recording("poses")) == 500
    unmeasured = {"slew.cylinder", "telescope.cylinder", *(f"{axis}.speed" for axis in dataset.machine.axis_names)}
    assert set(dataset.recordings[0].signals) == set(dataset.machine.signals) - unmeasured


def test_clocks_are_right_to_a_tenth_of_a_millisecond(dataset: Dataset, truth: dict[str, Any]) -> None:
    for record in dataset.clocks:
        clock, start = truth[record.recording]["capture_clock"], dataset.recording(record.recording).start_ns
        skew = 1e-6 * clock["skew_ppm"]
        first = record.stream_start_ns * 1e-9
        at_start = first * (1.0 + skew) + clock["offset_s"] - (start - truth[record.recording]["start_ns"]) * 1e-9
        assert record.applied
        if record.recording == "poses":
            assert abs(record.offset_s - at_start) < 0.4
            continue
        errors = [record.offset_s - at_start + t * (1e-6 * record.skew_ppm - skew) for t in (0.0, 30.0, 60.0)]
        assert np.abs(errors).max() < 1.5e-4
        assert record.offset_interval95[0] < at_start < record.offset_interval95[1]
        assert record.skew_interval95[0] < clock["skew_ppm"] < record.skew_interval95[1]
        assert {"boom.cylinder", "boom.joint", "slew.joint"} <= set(record.used_signals)


@pytest.mark.parametrize("name", ["manual-03", "poses"])
def test_joints_and_points_are_right(dataset: Dataset, name: str) -> None:
    run = simulate(load_recipe(AUTOLOG / "bench.toml"), name)
    recording = dataset.recording(name)
    time = recording.values("time") + (recording.start_ns - run.start_ns) * 1e-9
    limits = {"slew": (1e-4, 6e-4), "boom": (1e-4, 1.1e-3), "stick": (1e-4, 1.1e-3), "telescope": (1e-5, 5e-5)}
    for index, axis in enumerate(dataset.machine.axis_names):
        error = recording.values(f"{axis}.joint") - np.interp(time, run.truth.time, run.truth.joint[:, index])
        assert abs(np.nanmean(error)) < limits[axis][0]
        assert np.nanstd(error) < limits[axis][1]
        assert np.nanmax(np.abs(error)) < 6 * limits[axis][1]
    points = {"ee": run.truth.ee} | ({"tool": run.truth.tool} if name != "poses" else {})
    for point, positions in points.items():
        for index, axis in enumerate("xyz"):
            error = recording.values(f"{point}.{axis}") - np.interp(time, run.truth.time, positions[:, index])
            assert abs(np.nanmean(error)) < 5e-5
            assert np.nanmax(np.abs(error)) < 1.2e-3


def test_occlusions_stay_gaps_and_the_swap_is_flagged(dataset: Dataset, truth: dict[str, Any]) -> None:
    (swap,) = truth["manual-03"]["swaps"]
    dropped = dataset.quality["dropped"]["manual-03"]
    assert [flag["body"] for flag in dropped] == [swap["body"]]
    assert dropped[0]["from_s"] == pytest.approx(swap["start"], abs=0.02)
    assert dropped[0]["to_s"] == pytest.approx(swap["end"], abs=0.02)
    clock = truth["manual-01"]["capture_clock"]
    recording = dataset.recording("manual-01")
    for dropout in truth["manual-01"]["dropouts"]:
        if dropout["body"] == "tip_body":
            time = recording.values("time") + (recording.start_ns - truth["manual-01"]["start_ns"]) * 1e-9
            inside = (time > dropout["start"] + clock["offset_s"] + 0.05) & (time < dropout["end"] + clock["offset_s"] - 0.05)
            assert inside.any()
            assert np.isnan(recording.values("ee.x")[inside]).all()


def test_the_flags_are_what_happened_and_nothing_else(dataset: Dataset, truth: dict[str, Any]) -> None:
    """Every occlusion and the swap, in every signal that the body gives; no spike, jump, stuck sensor or jitter."""
    rows = dataset.quality["flags"]
    assert {row["kind"] for row in rows} == {"dropout", "marker_swap"}
    seen_by = {
        "column_body": ("slew.joint", "boom.joint"),
        "boom_body": ("boom.joint", "stick.joint"),
        "stick_body": ("stick.joint", "telescope.joint"),
        "tip_body": ("telescope.joint", "ee.x", "ee.y", "ee.z"),
        "gripper_body": ("tool.x", "tool.y", "tool.z"),
    }
    expected = []
    for name in (recording.name for recording in dataset.of_kind("motion")):
        shift = (truth[name]["start_ns"] - dataset.recording(name).start_ns) * 1e-9
        clock = truth[name]["capture_clock"]
        for kind, events in (("dropout", truth[name]["dropouts"]), ("marker_swap", truth[name].get("swaps", []))):
            for event in events:
                middle = 0.5 * (event["start"] + event["end"])
                at = middle * (1.0 + 1e-6 * clock["skew_ppm"]) + clock["offset_s"] + shift
                expected += [(name, signal, kind, at, event["end"] - event["start"]) for signal in seen_by[event["body"]]]
    assert len(rows) == len(expected)
    for name, signal, kind, at, seconds in expected:
        (row,) = [
            r
            for r in rows
            if (r["recording"], r["signal"], r["kind"]) == (name, signal, kind) and r["from_s"] <= at <= r["to_s"]
        ]
        assert row["to_s"] - row["from_s"] == pytest.approx(seconds, abs=0.04)
        assert row["source"] == "mocap.csv"


def test_the_second_sensor_is_checked_against_the_first(dataset: Dataset) -> None:
    for checks in dataset.quality["cross_checks"].values():
        if "machine.mcap/slew.joint" in checks:
            assert checks["machine.mcap/slew.joint"]["rms"] < np.deg2rad(0.8)
            assert checks["mocap.csv/telescope.joint"]["rms"] < 5e-4


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """Recipe, machine and the first three recordings, to be spoiled."""
    root = tmp_path / "autolog"
    root.mkdir()
    for name in ("recipe.toml", "machine.toml", "autolog.urdf"):
        shutil.copy(AUTOLOG / name, root)
    for name in ("manual-01", "manual-02", "manual-06"):
        shutil.copytree(AUTOLOG / "logs" / name, root / "logs" / name)
    return root


def test_of_a_cut_off_log_the_rest_is_ingested_and_the_loss_reported(copied: Path, tmp_path: Path) -> None:
    path = copied / "logs/manual-02/machine.mcap"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    made = ingest(copied, tmp_path / "ws")
    losses = {source.path: source.losses for source in made.sources if source.losses}
    assert list(losses) == ["manual-02/machine.mcap"]
    assert "the file is cut off at byte" in losses["manual-02/machine.mcap"][0]
    assert 30.0 < len(made.recording("manual-02")) / 100.0 < 45.0
    assert len(made.recording("manual-01")) == 6000
    assert all(record.applied for record in made.clocks)


def test_what_spoils_a_recording_is_named_with_its_file(copied: Path, tmp_path: Path) -> None:
    capture = copied / "logs/manual-02/mocap.csv"
    text = capture.read_text()
    capture.write_text(text.replace("Format Version,1.23", "Format Version,1.19", 1))
    with pytest.raises(InputError, match=r"manual-02/mocap\.csv: format version '1\.19'; expected 1\.1 or one of 1\.2, "):
        ingest(copied, tmp_path / "ws")
    capture.write_text(text)
    recipe = copied / "recipe.toml"
    original = recipe.read_text()
    for old, new, message in (
        (
            'field = "command[slew]"',
            'field = "command[slow]"',
            r"no field 'command\[slow\]' in '/valves/command'; expected 'command\[slew\]'\?",
        ),
        (
            '"/draw_wires", field = "position[boom]"',
            '"/draw_wire", field = "position[boom]"',
            "no topic '/draw_wire'; expected '/draw_wires'",
        ),
        (
            'field = "position[boom]", unit = "m"',
            'field = "position[boom]", unit = "deg"',
            r"a unit of \[rad\] \(deg\); expected a unit of \[m\]",
        ),
        ('boom_body = "boom"', 'boom_bdy = "boom"', r"no rigid body or marker 'boom_bdy'; expected 'boom_body'\?"),
        ('boom_body = "boom"', 'boom_body = "bom"', r"unknown link 'bom'; expected 'boom'\?"),
        ('recording = "manual-*"', 'recording = "x"', r"reference\.recording: no recording 'x'"),
    ):
        recipe.write_text(original.replace(old, new, 1))
        with pytest.raises(SysidError, match=message):
            ingest(copied, tmp_path / "ws")
    assert Store(tmp_path / "ws").list() == ()


def test_a_table_says_what_it_holds(dataset: Dataset) -> None:
    units = dataset.recordings[0].table.attrs["units"]
    assert (units["slew.command"], units["slew.joint"], units["boom.cylinder"], units["tool.z"]) == ("1", "rad", "m", "m")
    json.dumps(dataset.quality, allow_nan=True)
