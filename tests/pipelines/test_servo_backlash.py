"""Servo backlash stand, measured: the published counts, and no name for what friction may be as well."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def result(result_on_measured: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    return result_on_measured("servo_backlash")


@pytest.mark.parametrize("log", ["single", "nocomp2"])
def test_the_counts_are_the_published_ones(result: dict[str, Any], log: str) -> None:
    found = result["found"][log]
    assert [found["stretched"], found["slack"]] == pytest.approx(result["published"][log], abs=0.01)


def test_where_the_duty_of_a_count_grows_the_play_shrinks_to_a_count(result: dict[str, Any]) -> None:
    """Play of the gear does not depend on the controller; friction over its stiffness does."""
    weak, stiff = (result["found"][log] for log in ("nocomp2", "pgain_zero_db"))
    assert stiff["slope"] > 1.5 * weak["slope"]
    assert stiff["slack"] < 0.25 * weak["slack"]


def test_the_servo_stands_still_under_a_duty(result: dict[str, Any]) -> None:
    assert all(20.0 <= found["held"] <= 60.0 for found in result["found"].values())


def test_nothing_is_named(result: dict[str, Any]) -> None:
    """Neither the pull nor the motor's own angle is in the logs."""
    assert [name for name, run in result["runs"].items() if run["effects"]] == []
