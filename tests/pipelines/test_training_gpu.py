"""The trainer on a GPU: the page is that of the result, and a part of a training gives the time of the whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import ModuleType

import pytest
from training_case import FORWARD, PLANT, recipe


@pytest.fixture(scope="module")
def study(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("training_gpu")


def test_the_page_is_that_of_the_result(study: ModuleType) -> None:
    result = json.loads((study.REPORT / "result.json").read_text("utf-8"))
    assert study.tables(result) in study.PAGE.read_text("utf-8")


def test_the_whole_time_follows_from_a_part(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "TIMED_UPDATES", 400)
    settings = recipe()
    row = study.whole_steps(settings, PLANT, FORWARD, "cpu")
    assert row["ms_per_step"] > 0.0
    assert row["estimated_s"] == pytest.approx(1e-3 * row["ms_per_step"] * settings.total_steps)


def test_every_trainer_makes_its_updates(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "CASES", ((32, (16, 16), 5),))
    monkeypatch.setattr(study, "REPEATS", 1)
    rows = study.updates_per_second()
    assert {"ours, CPU, one thread", "Stable-Baselines3, CPU, one thread"} <= {row["trainer"] for row in rows}
    assert all(row["updates_per_second"][0] > 0.0 for row in rows)
