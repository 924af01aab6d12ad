"""The pipeline of the tasks beyond inverse kinematics: its controllers, figures and page."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from crane_model import Perfect, crane_plant

from sysid.machine import KnownEffect
from sysid.rl.tracking_task import TrackingTask, plan_tracking

PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))


@pytest.fixture(scope="module")
def study(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("learning_tasks")


@pytest.fixture(scope="module")
def task() -> TrackingTask:
    return plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=(0.85, 0.0, 0.3))


def test_a_shaper_helps_on_a_path_and_every_controller_rests_at_its_end(study: ModuleType, task: TrackingTask) -> None:
    rows = {each.name: study.sway.path_row(task, each, task.path, 1.0) for each in study.sway.on_paths(task)}
    assert all(row["settling_s"] is not None for row in rows.values())
    plain, shaped = rows["ik-lookahead"], rows["ik-lookahead, ZV shaper"]
    assert shaped["swing_mm"] < 0.5 * plain["swing_mm"]
    assert max(shaped["rmse_mm"]) < max(plain["rmse_mm"])
    assert max(rows["ik-lookahead, inverse pendulum"]["rmse_mm"]) < max(plain["rmse_mm"])


def test_moves_of_a_machine_whose_pendulum_is_another_one(study: ModuleType, task: TrackingTask) -> None:
    each = study.sway.moves(task, 1)
    controllers = study.sway.at_targets(task)[1:]
    same, longer = (study.sway.move_rows(task, controllers, each, length) for length in (1.0, 1.3))
    swing = [[row["moves"][0]["swing_mm"] for row in rows] for rows in (same, longer)]
    assert swing[0][1] < 0.5 * swing[0][0]
    assert swing[1][1] > swing[0][1], "ZV is exact only at its design frequency"
    assert swing[1][2] < swing[1][1], "ZVD is less sensitive"


def test_the_figures_of_the_tables(study: ModuleType) -> None:
    never: dict[str, Any] = {"arrival_s": 2.0, "settling_s": None, "swing_mm": 30.0}
    done = {"arrival_s": 3.0, "settling_s": 4.0, "swing_mm": 10.0}
    text = study.targets_table([{"controller": "ik", "length": 1.2, "moves": [done, done, never]}])
    assert text.splitlines()[-1] == "| +20 % in length | ik | 3.00; 3.00 | 4.00; – | 10.0; 30.0 | 1 of 3 |"
    row = {"path": "helix", "ease_s": 0.0, "controller": "ik", "rmse_mm": [1.0, 2.0, 3.0], "max_mm": [4.0, 5.0, 6.0]}
    text = study.paths_table([{**row, "swing_mm": 7.0, "settling_s": None}])
    assert text.splitlines()[-1] == "| helix, none | ik | 1.0 / 2.0 / 3.0 | 4.0 / 5.0 / 6.0 | 7.0 | – |"


def test_the_page_is_that_of_the_result(study: ModuleType) -> None:
    result = json.loads((study.REPORT / "result.json").read_text("utf-8"))
    assert study.page(result) in study.PAGE.read_text("utf-8")
