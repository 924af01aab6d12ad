"""The pipeline of the tasks beyond inverse kinematics: its controllers, figures and page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from crane_model import Perfect, crane_plant

from sysid.machine import KnownEffect
from sysid_rl.train.tracking import InversePolicy
from sysid_rl.train.tracking_task import TrackingTask, plan_tracking

PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))


@pytest.fixture(scope="module")
def study(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("learning_tasks")


@pytest.fixture(scope="module")
def task() -> TrackingTask:
    return plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=(0.85, 0.0, 0.3))


@pytest.mark.slow
def test_a_shaper_helps_on_a_path_and_every_controller_rests_at_its_end(study: ModuleType, task: TrackingTask) -> None:
    rows = {each.name: study.sway.path_rows(task, each, task.path, 1.0)[0] for each in study.sway.on_paths(task)}
    assert all(row["settling_s"] is not None for row in rows.values())
    plain, shaped = rows["ik-lookahead"], rows["ik-lookahead, ZV shaper"]
    assert shaped["swing_mm"] < 0.5 * plain["swing_mm"]
    assert max(shaped["rmse_mm"]) < max(plain["rmse_mm"])
    assert max(rows["ik-lookahead, inverse pendulum"]["rmse_mm"]) < max(plain["rmse_mm"])


@pytest.mark.slow
def test_moves_of_a_machine_whose_pendulum_is_another_one(study: ModuleType, task: TrackingTask) -> None:
    each = study.sway.moves(task, 1)
    controllers = study.sway.at_targets(task)[1:4]
    same, longer = (study.sway.move_rows(task, controllers, each, length) for length in (1.0, 1.3))
    swing = [[row["moves"][0]["swing_mm"] for row in rows] for rows in (same, longer)]
    assert swing[0][1] < 0.5 * swing[0][0]
    assert swing[1][1] > swing[0][1], "ZV is exact only at its design frequency"
    assert swing[1][2] < swing[1][1], "ZVD is less sensitive"


def test_feedback_damps_a_swing_that_exists(study: ModuleType, task: TrackingTask) -> None:
    rows = study.sway.swing_rows(task, study.sway.in_place(task), study.sway.moves(task, 2, study.sway.SWING_SEED))
    for plain, damped in zip(rows[0]["moves"], rows[1]["moves"], strict=True):
        assert damped["settling_s"] < 0.7 * plain["settling_s"]


@pytest.mark.slow
def test_under_a_shared_pump_the_goal_of_least_time_is_reached_first(study: ModuleType, task: TrackingTask) -> None:
    shared = study.pump.with_pump(task)
    limit = shared.plant.effect("pump_flow_limit", "machine").parameters["limit"]
    assert float(np.atleast_1d(limit)[0]) < 0.61 * len(task.start)
    rows = study.pump.rows(shared, study.sway.moves(task, 3))
    times = {row["controller"]: np.array(row["arrival_s"], dtype=float) for row in rows}
    nearest, least = (times[f"{name}, coordinated motion within the flow"] for name in ("ik", "least time"))
    assert (least <= nearest + 0.05).all()
    assert least.mean() < 0.95 * nearest.mean()
    assert all(row["margin"] >= 0.0 for row in rows)


@pytest.mark.slow
def test_gradient_projection_keeps_away_from_the_limits(study: ModuleType, task: TrackingTask) -> None:
    circles = study.redundancy.circles(task, 3)
    assert len(circles) == 3
    plain, away = study.redundancy.rows(task, circles)
    assert np.median(away["mean"]) > 1.2 * np.median(plain["mean"])
    assert np.median(away["rmse_mm"]) < np.median(plain["rmse_mm"]) + 1.0


def test_a_trained_policy_is_one_row_of_all_seeds(study: ModuleType, task: TrackingTask) -> None:
    controller = study.sway.Controller("two", (lambda: InversePolicy(task.inverse), lambda: InversePolicy(task.inverse)))
    (row,) = study.sway.move_rows(task, [controller], study.sway.moves(task, 1))
    assert len(row["moves"]) == 2
    assert row["moves"][0] == row["moves"][1]


def test_the_figures_of_the_tables(study: ModuleType) -> None:
    never: dict[str, Any] = {"arrival_s": 2.0, "settling_s": None, "swing_mm": 30.0}
    done = {"arrival_s": 3.0, "settling_s": 4.0, "swing_mm": 10.0}
    text = study.page.targets([{"controller": "ik", "length": 1.2, "moves": [done, done, never]}])
    assert text.splitlines()[-1] == "| +20 % in length | ik | 3.00; 3.00 | 4.00; – | 10.0; 30.0 | 1 of 3 |"
    row = {"path": "helix", "ease_s": 0.0, "controller": "ik", "rmse_mm": [1.0, 2.0, 3.0], "max_mm": [4.0, 5.0, 6.0]}
    text = study.page.paths([{**row, "swing_mm": 7.0, "settling_s": None}])
    assert text.splitlines()[-1] == "| helix, none | ik | 1.0 / 2.0 / 3.0 | 4.0 / 5.0 / 6.0 | 7.0 | – |"
    rows = [
        {"controller": "ik", "arrival_s": [2.0, 4.0, None], "margin": 0.1},
        {"controller": "new", "arrival_s": [1.0, 5.0, 3.0], "margin": 0.0},
    ]
    assert study.page.pump(rows).splitlines()[-1] == "| new | 3.00; 5.00 | 0.88; 1.25 | 1 of 3 | 0.0 % of its range |"


def test_the_page_is_that_of_the_result(study: ModuleType) -> None:
    result = json.loads((study.REPORT / "result.json").read_text("utf-8"))
    text = study.PAGE.read_text("utf-8")
    assert len(study.page.tables(result)) == 5
    assert all(table in text for table in study.page.tables(result).values())


def test_the_versions_of_the_crane_are_made_once(study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Path] = []

    def first_look(workspace: Path) -> None:
        made.append(workspace)
        registry = study.Registry(workspace)
        for plant in (crane_plant(), PLANT):
            registry.register("autolog", "plant", plant.to_files(), {}, {})
        registry.register("autolog-forward", "forward", {"forward.json": b"{}"}, {}, {})

    monkeypatch.setattr(study.first_look, "main", first_look)
    for _ in range(2):
        study.with_versions(tmp_path)
    assert made == [tmp_path]
