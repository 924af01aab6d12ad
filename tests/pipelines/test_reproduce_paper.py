"""The paper's workflow: which policies it trains, and the rows of its table."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sysid_rl.train.tracking import TrackingResult


@pytest.fixture(scope="module")
def paper(pipeline: Callable[[str], ModuleType]) -> Any:
    """The pipeline's file; its parts are importable from then on."""
    return pipeline("reproduce_paper")


def tracked(error: tuple[float, float, float]) -> TrackingResult:
    time, nothing = np.arange(4) * 0.01, np.full((4, 3), np.nan)
    ee = np.zeros((4, 3))
    ee[2] = error
    return TrackingResult("p", "helix", 0.0, time, np.zeros((4, 3)), ee, np.zeros((4, 4)), np.zeros((4, 4)), nothing, nothing)


def test_policies_differ_in_the_feedback_alone(paper: Any) -> None:
    chosen = paper.policies.recipes(0.1, 0)
    first, second = (chosen[arm].recipe() for arm in ("feedback", "plain"))
    assert (first.exploration.candidates, second.exploration.candidates) == (10, 1)
    assert first.learning == second.learning
    assert first.learning.episodes == 150


def test_rows_of_simulation(paper: Any) -> None:
    returns = {"feedback": np.linspace(0.0, 10.0, 101), "plain": np.linspace(0.0, 5.0, 101)}
    errors = {"feedback": (0.010, -0.020, 0.004), "plain": (0.030, 0.002, 0.010)}
    trained = {arm: paper.policies.TrainedRun(f"paper-{arm}@1", returns[arm], tracked(errors[arm])) for arm in returns}
    rows = {row.quantity: row for row in paper.policies.rows(trained, 150, 0)}
    assert rows["policy 1 on the helix, max x / y / z"].ours == pytest.approx((10.0, 20.0, 4.0))
    assert rows["policy 1 on the helix, max x / y / z"].paper == (27.2, 14.5, 26.3)
    assert rows["policy 2 on the helix, RMSE x / y / z"].ours == pytest.approx((15.0, 1.0, 5.0))
    rewards = rows["mean return of the last fifth of the episodes, policy 1 / policy 2"]
    assert rewards.paper is None
    assert rewards.ours == pytest.approx((9.05, 4.525), abs=0.01)
    text = paper.table([row.to_json() for row in rows.values()])
    assert "| policy 1 on the helix, max x / y / z | 27.2 / 14.5 / 26.3 | 10.0 / 20.0 / 4.0 | mm |" in text


def test_the_best_stands_beside_what_the_paper_states(paper: Any) -> None:
    row = paper.policies.PaperRow("table", "max x / y / z", "on a bench", (75.2, 80.1, 73.1), (66.7, 74.2, 59.2), "mm", 0)
    other = paper.policies.PaperRow("figure", "returns", "", None, (1.0,), "1", 0)
    found = paper.best.Best((4.0, 19.0, 5.1), "sysid gap autolog --add", 12.3)
    rows = [{**row.to_json(), **paper.best_columns(found)}, {**other.to_json(), **paper.best_columns(None)}]
    lines = paper.best_table(rows).splitlines()
    assert len(lines) == 3
    cells = [cell.strip() for cell in lines[2].strip("|").split("|")]
    assert cells[:4] == ["max x / y / z", "75.2 / 80.1 / 73.1", "66.7 / 74.2 / 59.2", "4.0 / 19.0 / 5.1"]
    assert cells[4:] == ["mm", "sysid gap autolog --add", "12 s"]


def test_the_committed_best_is_ahead_of_the_paper_in_every_row(paper: Any) -> None:
    rows = json.loads((paper.REPORT / "result.json").read_text("utf-8"))["rows"]
    stated = [row for row in rows if row["paper"] is not None]
    assert stated
    for row in stated:
        assert all(mine < theirs for mine, theirs in zip(row["best"], row["paper"], strict=True)), row["quantity"]
        assert row["command"]
        assert row["seconds"] > 0.0


def test_rows_of_the_machine_state_who_controlled_it(paper: Any) -> None:
    from loop.flight import Flight

    time, target = np.linspace(0.0, 1.0, 5), np.zeros((5, 3))
    tool = target + np.array([[0.0, 0.03, 0.0]])
    flight = Flight(
        "helix", time, target, target, tool, np.zeros((5, 4)), "done", "", Path(), {"track": 0.75, "fallback": 0.25}
    )
    (row,) = paper.machine.rows({"helix": flight}, "policy 1", 0)
    assert row.paper == (75.2, 80.1, 73.1)
    assert row.ours == pytest.approx((0.0, 30.0, 0.0))
    assert "75 % of the cycles by policy 1" in row.condition
