"""The shipped logs, ingested by their recipe, against what the stand-in machine knows to be true."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sysid.bench import load_recipe, simulate
from sysid.datasets import Dataset, ingest

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
    assert set(dataset.recordings[0].signals) == set(dataset.machine.signals) - {"slew.cylinder", "telescope.cylinder"}


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


def test_the_second_sensor_is_checked_against_the_first(dataset: Dataset) -> None:
    for checks in dataset.quality["cross_checks"].values():
        if "machine.mcap/slew.joint" in checks:
            assert checks["machine.mcap/slew.joint"]["rms"] < np.deg2rad(0.8)
            assert checks["mocap.csv/telescope.joint"]["rms"] < 5e-4


def test_a_table_says_what_it_holds(dataset: Dataset) -> None:
    units = dataset.recordings[0].table.attrs["units"]
    assert (units["slew.command"], units["slew.joint"], units["boom.cylinder"], units["tool.z"]) == ("1", "rad", "m", "m")
    json.dumps(dataset.quality, allow_nan=True)
