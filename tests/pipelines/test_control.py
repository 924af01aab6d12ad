"""The pipeline of the cylinder controller: each row knows one thing more, and the page says what was measured."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import fields
from types import ModuleType

from crane_model import Perfect, crane_plant

from sysid.machine import KnownEffect
from sysid_rl.control import AxisTuning, tune
from sysid_rl.train.tracking_task import plan_tracking

PLANT = crane_plant(KnownEffect("backlash", "slew", {"width": 0.01}, "drive"))


def changed(one: tuple[AxisTuning, ...], other: tuple[AxisTuning, ...]) -> set[str]:
    return {
        field.name
        for a, b in zip(one, other, strict=True)
        for field in fields(a)
        if getattr(a, field.name) != getattr(b, field.name)
    }


def test_each_row_has_one_thing_more(pipeline: Callable[[str], ModuleType]) -> None:
    task = plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=(0.85, 0.0, 0.3))
    rows = pipeline("control").stages(task, tune(crane_plant()))
    steps = [changed(one[1], other[1]) for one, other in itertools.pairwise(rows)]
    assert steps[0] <= {"up", "down", "exponent", "positive", "negative", "limit", "creep"}
    assert steps[1:6] == [{"proportional"}, {"feed"}, {"backlash"}, {"integral"}, set()]
    assert rows[5][1] == task.tuning
    assert [row[2] for row in rows] == [0.0] * 6 + [task.dead_time, 0.0]


def test_the_page_shows_the_figures_after_the_first_second(pipeline: Callable[[str], ModuleType]) -> None:
    late = {"rmse_mm": [61.5, 0.4, 1.25], "max_mm": [86.4, 1.0, 2.0]}
    row = {"policy": "P", "settled": late, "quiet": {"settled": {**late, "rmse_mm": [1.0, 2.0, 3.0]}}}
    text = pipeline("control").page([row])
    assert text.splitlines()[-1] == "| P | 62 / 0.40 / 1.25 | 86 / 1.00 / 2.00 | 1.00 / 2.00 / 3.00 |"
