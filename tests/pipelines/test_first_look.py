"""The whole line on the shipped logs, cut to half a minute a recording and with short training."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from short_logs import shortened

from sysid.networks import parse_recipe
from sysid.pictures import PictureCurve, svg
from sysid.workspace import open_workspace

ROOT = Path(__file__).parents[2]
AUTOLOG = ROOT / "datasets" / "autolog"
PICTURE = ROOT / "docs" / "images" / "demo.svg"
SECONDS = {"manual-01": 30.0, "manual-02": 30.0, "manual-06": 30.0, "poses": 800.0}
QUICK = {
    "actuator": {"samples": 400, "training": {"epochs": 150, "learning_rate": 1e-3}},
    "forward": {"training": {"epochs": 150}},
}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, pipeline: Callable[[str], ModuleType]) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("demo")
    logs = shortened(AUTOLOG, folder / "autolog", SECONDS)
    path = pipeline("first_look").main(folder / "workspace", logs, parse_recipe(QUICK, "test"))
    assert path == folder / "workspace" / "demo" / "result.json"
    read: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return read


def test_what_the_logs_hide_is_named(result: dict[str, Any]) -> None:
    truth = json.loads((AUTOLOG / "logs" / "truth.json").read_text("utf-8"))
    hidden = {(entry["name"], entry["target"]): entry["parameters"] for entry in truth["effects"] if entry["hidden"]}
    found = {(effect["name"], effect["target"]): effect["parameters"] for effect in result["gap"]["effects"]}
    assert result["gap"]["verdict"] == "named"
    assert found.keys() == hidden.keys()
    for effect, parameters in hidden.items():
        for name, value in found[effect].items():
            assert value == pytest.approx(parameters[name], rel=0.1), f"{effect}: {name}"


def test_the_gap_closes_on_the_recording_that_nothing_has_seen(result: dict[str, Any]) -> None:
    gap = result["gap"]["gap"]
    assert result["gap"]["held_out_recordings"] == ["manual-06"]
    for signal in ("slew.joint", "boom.cylinder", "ee.z", "tool.x", "tool.z"):
        before, after, floor = (gap[key][signal] for key in ("before", "after", "noise_floor"))
        assert before > 5.0 * floor
        assert (before - after) / (before - floor) > 0.8, signal


def test_networks_are_judged_per_output_beside_the_paper(result: dict[str, Any]) -> None:
    networks = result["networks"]
    assert set(networks) == {
        "boom.joint", "boom.cylinder", "stick.joint", "stick.cylinder", "ee.x", "ee.y", "ee.z",
    }  # fmt: skip
    assert [networks[f"ee.{letter}"]["paper_max"] for letter in "xyz"] == [0.0159, 0.0205, 0.0136]
    assert networks["boom.joint"]["unit"] == "rad"
    for output in networks.values():
        assert 0.0 < output["motion"]["rmse"] <= output["motion"]["max"]
        assert 0.0 < output["poses"]["rmse"] <= output["poses"]["max"]


def test_every_station_says_how_long_it_took_and_leaves_its_file(result: dict[str, Any]) -> None:
    stations = ["ingest", "fit actuator", "fit forward", "validate", "simulate", "gap", "report", "view"]
    assert list(result["seconds"]) == stations
    assert all(seconds > 0.0 for seconds in result["seconds"].values())
    assert result["dataset"] == "autolog@1"
    assert result["models"] == ["autolog-actuator@1", "autolog-forward@1"]
    assert result["gap"]["plant"] == {"before": "autolog@1", "after": "autolog@2"}
    assert "Three effects are missing" in Path(result["files"]["report"]).read_text("utf-8")
    assert Path(result["files"]["rerun"]).stat().st_size > 100_000


def picture(result: dict[str, Any]) -> str:
    """Height of the boom tip on the held-out recording: measured, and simulated before and after the repair."""
    place = open_workspace(Path(result["files"]["report"]).parents[1])
    dataset, (name,) = place.dataset("autolog"), result["gap"]["held_out_recordings"]
    runs, recording, signal = place.predictions(dataset, name), dataset.recording(name), "ee.z"
    time = recording.values("time") - recording.values("time")[0]
    rms = {key: f"{1e3 * result['gap']['gap'][key][signal]:.3g} mm" for key in ("before", "after", "noise_floor")}
    curves = [
        PictureCurve("simulated before", time, runs["before"][signal].to_numpy(), "#d9822b"),
        PictureCurve("measured", time, recording.values(signal), "#30363c"),
        PictureCurve("simulated after", time, runs["after"][signal].to_numpy(), "#1a7f64", dashed=True),
    ]
    errors = f"RMS {rms['before']} → {rms['after']}; noise {rms['noise_floor']}"
    return svg(
        f"Height of the boom tip: {errors}",
        f"time [s] of a recording that no fit has seen · {errors}",
        "height of the boom tip [m]",
        curves,
    )


def test_the_picture_in_the_readme_is_that_of_today(result: dict[str, Any], tmp_path: Path) -> None:
    """Texts are equal, and curves to half a pixel."""
    (tmp_path / PICTURE.name).write_text(picture(result), "utf-8")
    numbers, words = [], []
    for path in (PICTURE, tmp_path / PICTURE.name):
        text = path.read_text("utf-8")
        curves = " ".join(re.findall(r'points="([^"]*)"', text))
        numbers.append(np.array(re.split("[ ,]", curves), dtype=float))
        words.append(re.sub(r'points="[^"]*"', "", text))
    assert words[0] == words[1], f"the demo's figures have changed: look at {tmp_path / PICTURE.name} and copy it to {PICTURE}"
    np.testing.assert_allclose(numbers[1], numbers[0], rtol=0.0, atol=0.5)
