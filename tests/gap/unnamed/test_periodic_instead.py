"""A periodic disturbance takes the names of a drive whose error it explains, and those only."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from unnamed_data import BASE, MACHINE, MODEL, Rate, disturbed, disturbed_dataset, nothing, pulsing

from sysid.gap import find_gap
from sysid.gap.problem import drive_problem
from sysid.gap.unnamed.instead import _better, _series
from sysid.gap.unnamed.residual_series import ResidualSeries, residual_series
from sysid.machine import KnownEffect

Array = npt.NDArray[np.float64]
DRIVE = drive_problem(MODEL, MACHINE.axis("boom"))


def series(rate: Rate, ratio: float) -> list[ResidualSeries]:
    """Residuals of a plant whose boom moves by ``ratio`` of its speed."""
    theta = BASE.with_effect(KnownEffect("gain_error", "boom", {"ratio": ratio})).vector()
    found = (residual_series(DRIVE, theta, disturbed(f"run-{k}", rate, k), MACHINE, 0) for k in range(3))
    return [part for part in found if part is not None]


def slower(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A gain error of 10 %, beside a pump that pulsates by 5 %."""
    return -0.1 * v + 0.25 * pulsing(v, x, load, t, dice)


def much_slower(v: float, x: float, load: float, t: float, dice: float) -> float:
    return -0.1 * v


@pytest.mark.parametrize(
    ("rate", "before", "after", "better"),
    [
        pytest.param(pulsing, 1.0, 0.96, True, id="a gain that is not there"),
        pytest.param(slower, 1.0, 0.9, False, id="a gain beside a pulsation"),
        pytest.param(much_slower, 1.0, 0.9, False, id="a gain alone"),
        pytest.param(nothing, 1.0, 1.0, False, id="nothing"),
    ],
)
def test_it_has_to_explain_more_than_the_names_and_they_little_beside_it(
    rate: Rate, before: float, after: float, better: bool
) -> None:
    assert _better(series(rate, before), series(rate, after)) == better


def strongly(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A pump that pulsates by 60 % of the speed."""
    return 3.0 * pulsing(v, x, load, t, dice)


def test_a_recording_in_which_the_axis_stands_still_is_left_out() -> None:
    """It has no speed that could modulate the amplitude."""
    moving = disturbed("moving", pulsing, 0)
    rest = 0.06 + np.random.default_rng(0).normal(0.0, MACHINE.noise["boom.cylinder"], len(moving))
    still = replace(moving, name="still", table=moving.table.assign(**{"boom.command": 0.0, "boom.cylinder": rest}))
    stage: Any = SimpleNamespace(problem=DRIVE, split=SimpleNamespace(seen=(moving, still)))
    assert list(_series(stage, BASE.vector(), MACHINE)) == ["moving"]


@pytest.mark.slow
def test_a_pump_that_pulsates_strongly_is_described_and_gets_no_name() -> None:
    """The plant keeps its values."""
    found = find_gap(disturbed_dataset(strongly), BASE)
    assert found.verdict == "unnamed"
    assert not found.effects
    (drive,) = (item for item in found.unnamed if item.target == "boom" and item.stage == "command")
    assert drive.period == pytest.approx(1.0 / 0.7, rel=0.02)
    assert drive.explains is not None
    assert drive.explains > 0.9
