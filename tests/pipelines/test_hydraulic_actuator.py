"""Hydraulic actuator, measured: what motion says about pressure, beside a linear model and the literature."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def result(result_on_measured: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    return result_on_measured("hydraulic_actuator", "hyd_actuator")


def test_the_linear_model_scores_what_the_literature_says(result: dict[str, Any]) -> None:
    assert result["pressure"]["linear, lags 3 and 3"] == pytest.approx(result["literature"]["linear"], rel=0.01)


def test_pressure_follows_the_motion(result: dict[str, Any]) -> None:
    """Inertia, friction and weight at the measured motion; a gain for each direction brings the simulated one near."""
    errors = result["pressure"]
    assert errors["measured motion"] < 0.65
    assert errors["measured motion"] < errors["simulated motion, gain by direction"] < 0.95
    assert errors["simulated motion, gain by direction"] < errors["simulated motion, nominal"]


def test_no_name_is_given_that_only_one_block_supports(result: dict[str, Any]) -> None:
    """Each half minute has another ratio of the speeds: what one block suggests fails on the other."""
    assert all(item["verdict"] == "consistent" for item in result["stability"])
    assert result["gap"]["verdict"] in ("named", "unnamed")
    assert result["gap"]["gap"]["after"]["arm.joint"] <= 1.02 * result["gap"]["gap"]["before"]["arm.joint"]
