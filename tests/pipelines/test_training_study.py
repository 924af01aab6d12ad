"""The study of training is written while part of it is done, and gone on from elsewhere."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest

pytest.importorskip("torch")

PIPELINES = str(Path(__file__).parents[2] / "pipelines")


@pytest.fixture(scope="module")
def study() -> Iterator[ModuleType]:
    """pipelines/training.py, found as it finds its own modules."""
    sys.path.insert(0, PIPELINES)
    try:
        yield importlib.import_module("training")
    finally:
        sys.path.remove(PIPELINES)


def outcome(run: Any, distance: float) -> dict[str, Any]:
    """What a run leaves."""
    mark = {"step": 100, "cpu_seconds": 30.0, "rmse": [distance, 0.0, 0.0], "max": [2.0 * distance, 0.0, 0.0]}
    return {
        "run": asdict(run),
        "updates": 10,
        "cpu_seconds": 30.0,
        "rmse": mark["rmse"],
        "max": mark["max"],
        "rmse_searched": mark["rmse"],
        "marks": [mark],
        "episodes": [{"step": 50.0 * k, "return": 0.0, "distance": distance} for k in (1, 2)],
        "evaluations": [{"reach_max": 3.0 * distance, **{f"reach_rmse_{axis}": distance for axis in "xyz"}}],
    }


def test_tables_of_what_there_is(study: ModuleType) -> None:
    """Two seeds with feedback and one without: one pair, and no row of what nobody has trained."""
    share, seeds = study.TIERS["full"]
    todo = [run for run in study.runs(share, seeds) if run.part == "quick" and (run.arm, run.seed) != ("plain", 0)][:3]
    assert [(run.arm, run.seed) for run in todo] == [("feedback", 0), ("feedback", 1), ("plain", 1)]
    done = [outcome(run, distance) for run, distance in zip(todo, (0.009, 0.002, 0.004), strict=True)]
    figures = {"policy": "ik", "rmse_mm": [0.0, 0.1, 0.2], "max_mm": [1.0, 1.0, 1.0]}
    row = {**figures, "lookahead_s": 0.7, "settled": {"rmse_mm": [61.0, 60.0, 7.0]}}
    baselines = {"at once": [row], "by hand": [row, row], "from the plant": [row, row]}
    result = {"listed": 90, "baselines": baselines, "runs": done, "stable_baselines3": []}
    text = study.tables(result)
    assert text.startswith("3 of 90 policies; the others are not trained yet.")
    assert "in 1 of 1 seeds (quick)" in text
    assert "in 0 of 0 seeds (paper)" in text
    assert "| `quick.toml`, feedback | 2 | 5.5/0.0/0.0; 9.0/0.0/0.0 |" in text
    assert "in one step | 2 | 5.5/5.5/5.5; 9.0/9.0/9.0 | 27 away |" in text
    assert "without hindsight" not in text
    assert "| inverse kinematics | 61.0/60.0/7.0 | 61.0/60.0/7.0 |" in text
    assert "as suits it best | 61.0/60.0/7.0 (0.70 s) |" in text
    assert "driven.toml" not in text
    assert "has not been run yet" in text
    assert "| 10 | – | – | – |" in text
    drawn = ElementTree.fromstring(study.curves(result))
    assert len(list(drawn.iter("{http://www.w3.org/2000/svg}polygon"))) == 4, "two arms, exploring and alone"


def test_page_and_curves_are_those_of_the_result(study: ModuleType) -> None:
    result = json.loads((study.REPORT / "result.json").read_text("utf-8"))
    assert study.tables(result) in study.PAGE.read_text("utf-8")
    assert (study.REPORT / "tables.md").read_text("utf-8") == study.tables(result) + "\n"
    assert (study.REPORT / "curves.svg").read_text("utf-8") == study.curves(result)


def test_what_was_committed_is_not_trained_again(study: ModuleType, tmp_path: Path) -> None:
    share, seeds = study.TIERS["full"]
    first, second, *_ = todo = list(study.runs(share, seeds))
    stale = outcome(second, 0.01)
    stale["run"]["changes"] = {**stale["run"]["changes"], "learning": {"episodes": 1}}  # a recipe that is another one by now
    peer = {"seed": 2, "limit": 1.0, "updates": 1, "marks": []}
    committed = tmp_path / "result.json"
    committed.write_text(json.dumps({"runs": [outcome(first, 0.002), stale], "stable_baselines3": [peer]}))
    work = tmp_path / "work"
    work.mkdir()
    study.put_back(committed, todo, work)
    assert sorted(path.name for path in work.iterdir()) == sorted([f"{first.name}.json", "sb3-seed2.json"])
    assert study.one("nowhere", str(work), first, 0.0, lambda share, text: None)["rmse"] == [0.002, 0.0, 0.0]
    assert study.one("nowhere", str(work), second, 0.0, lambda share, text: None) is None, "its time was up before it began"
    (work / f"{second.name}.json").write_text(json.dumps(stale))
    assert study.one("nowhere", str(work), second, 0.0, lambda share, text: None) is None, "another recipe left that"
    turned = outcome(second, 0.003)
    turned["run"]["changes"] = dict(reversed(turned["run"]["changes"].items()))  # the same recipe, its tables in another order
    committed.write_text(json.dumps({"runs": [turned], "stable_baselines3": []}))
    study.put_back(committed, todo, work)
    assert study.one("nowhere", str(work), second, 0.0, lambda share, text: None)["rmse"] == [0.003, 0.0, 0.0]
    study.put_back(tmp_path / "none.json", todo, work)
