"""The whole line on the shipped logs, cut to twenty seconds a recording and with short training."""

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

import sysid
from sysid.gap import GapResult as GapValues
from sysid.gap import find_gap
from sysid.networks import parse_recipe
from sysid.workspace import open_workspace

ROOT = Path(__file__).parents[2]
AUTOLOG = ROOT / "datasets" / "autolog"
PICTURES = ROOT / "docs" / "images"
README = (ROOT / "README.md").read_text("utf-8")
SECONDS = {"manual-01": 20.0, "manual-02": 20.0, "manual-06": 20.0, "poses": 800.0}
QUICK = {
    "actuator": {"samples": 400, "training": {"epochs": 80, "learning_rate": 1e-3}},
    "forward": {"training": {"epochs": 150}},
}


@pytest.fixture(scope="module")
def searched() -> list[GapValues]:
    """What the search of :func:`result` found, as the front gets it."""
    return []


@pytest.fixture(scope="module")
def result(
    tmp_path_factory: pytest.TempPathFactory, pipeline: Callable[[str], ModuleType], searched: list[GapValues]
) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("demo")
    logs = shortened(AUTOLOG, folder / "autolog", SECONDS)

    def search(*args: Any, **named: Any) -> GapValues:
        searched.append(find_gap(*args, **named))
        return searched[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid.front.gap.find_gap_in", search)
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
    stations = ["ingest", "fit actuator", "fit forward", "gap", "report", "view"]
    assert list(result["seconds"]) == stations
    assert all(seconds > 0.0 for seconds in result["seconds"].values())
    assert result["dataset"] == "autolog@1"
    assert result["models"] == ["autolog-actuator@1", "autolog-forward@1"]
    assert result["gap"]["plant"] == {"before": "autolog@1", "after": "autolog@2"}
    assert "Three effects are missing" in Path(result["files"]["report"]).read_text("utf-8")
    assert Path(result["files"]["rerun"]).stat().st_size > 100_000


def points(text: str) -> np.ndarray[Any, Any]:
    return np.array(re.split("[ ,]", " ".join(re.findall(r'points="([^"]*)"', text))), dtype=float)


def words(text: str) -> set[str]:
    """Kinds of lines, without curves and figures: ticks have other numbers."""
    return set(re.sub(r"[−\d.,]+", "0", re.sub(r'points="[^"]*"', "", text)).splitlines())


def drawn(path: Path, pipeline: Callable[[str], ModuleType]) -> dict[str, str]:
    """The pictures of a finished demo."""
    place = open_workspace(path.parents[1])
    dataset = place.dataset("autolog")
    found: dict[str, str] = pipeline("demo_picture").pictures(dataset, place.gap(dataset))
    return found


@pytest.mark.parametrize("name", ["demo-light.svg", "demo-dark.svg"])
def test_the_picture_in_the_readme_is_drawn_as_today(
    name: str, result: dict[str, Any], pipeline: Callable[[str], ModuleType]
) -> None:
    """Short logs and short training have other figures than the demo: those are compared below."""
    kept = (PICTURES / name).read_text("utf-8")
    now = drawn(Path(result["files"]["report"]), pipeline)[name]
    assert words(now) == words(kept), "draw them again: python pipelines/demo_picture.py WORKSPACE"
    assert now.count("<polyline") == kept.count("<polyline")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_picture_and_answer_of_the_readme_are_those_of_the_demo(tmp_path: Path, pipeline: Callable[[str], ModuleType]) -> None:
    """Curves to half a pixel, figures of the picture to a twentieth, the answer to the letter."""
    pipeline("first_look").main(tmp_path / "workspace")
    for name, now in drawn(tmp_path / "workspace" / "demo" / "result.json", pipeline).items():
        kept = (PICTURES / name).read_text("utf-8")
        np.testing.assert_allclose(points(now), points(kept), rtol=0.0, atol=0.5, err_msg=name)
        figures = [
            np.array(re.findall(r"\d+(?:\.\d+)?", re.sub(r'points="[^"]*"', "", text)), dtype=float) for text in (now, kept)
        ]
        np.testing.assert_allclose(*figures, rtol=0.05, err_msg=name)
    place = open_workspace(tmp_path / "workspace")
    dataset = place.dataset("autolog")
    found = place.gap(dataset)
    assert found is not None
    text = repr(sysid.GapResult(found, dataset, place, place.plant(dataset)))
    shown = [line.split() for line in text.splitlines()]
    assert [line for line in answer().splitlines()[1:] if line.split() not in shown] == []


def answer() -> str:
    return next(block for block in re.findall(r"```text\n(.*?)```", README, re.DOTALL) if "Backlash" in block)


def test_the_answer_in_the_readme_is_that_of_the_demo(result: dict[str, Any]) -> None:
    """It has the effects that are found here, on short logs, with values inside of their intervals."""
    rows = {
        row[0].strip(): row[1:] for row in (re.split(r" {2,}", line.strip()) for line in answer().splitlines()) if len(row) > 2
    }
    shown = {
        ("backlash", "slew", "width"): np.radians(number(rows["Backlash of slew"][0])),
        ("valve_deadband", "boom", "positive"): number(rows["Valve dead-band of boom"][0]),
        ("gripper_sway", "tool", "length"): 1e-3 * number(rows["Swinging tool of tool"][0]),
    }
    found = {(e["name"], e["target"]): e for e in result["gap"]["effects"]}
    assert {key[:2] for key in shown} == found.keys()
    for (name, target, parameter), value in shown.items():
        assert value == pytest.approx(found[name, target]["parameters"][parameter], rel=0.03)


def number(text: str) -> float:
    """``positive 0.1200`` → 0.12, ``width 0.6025°`` → 0.6025."""
    return float(re.search(r"[\d.]+", text).group())  # type: ignore[union-attr]


def test_the_python_of_the_readme_runs_as_it_is(
    result: dict[str, Any],
    searched: list[GapValues],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In the workspace of the demo, with what its search found: its dataset and its networks are those of the short logs."""
    monkeypatch.setattr("sysid.front.gap.find_gap_in", lambda *_, **__: searched[0])
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(block.splitlines()) <= 10
    workspace = Path(result["files"]["report"]).parents[1]
    monkeypatch.setenv("SYSID_WORKSPACE", str(workspace))
    monkeypatch.setattr(sysid, "demo_logs", lambda: workspace.parent / "autolog")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert names["dataset"].reference == "autolog@1"
    assert {(effect.name, effect.target) for effect in names["gap"].effects} == {
        ("backlash", "slew"), ("valve_deadband", "boom"), ("gripper_sway", "tool"),
    }  # fmt: skip
    assert "Backlash of slew" in capsys.readouterr().out
    assert (tmp_path / "tool.svg").read_text("utf-8").count("<polyline") == 3
    assert json.loads((tmp_path / "repaired" / "replay.json").read_text("utf-8"))["target"] == "json"
