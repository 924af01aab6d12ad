"""XL330, measured: friction of the motor from each log alone, beside the published parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def result(result_on_measured: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    return result_on_measured("xl330", "bam_xl330")


def repeats(view: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {item["name"]: item for item in view["stability"]}


def viscous(item: dict[str, Any]) -> list[float]:
    """The friction of each log that names it: of both directions where they differ, in the middle."""
    return [sum(values) / len(values) for values in zip(*item["parameters"].values(), strict=True)]


def test_logs_that_name_the_viscous_friction_give_the_published_one(result: dict[str, Any]) -> None:
    found = repeats(result["views"]["motor"])["viscous_friction"]
    assert len(found["named"]) >= 4
    published = result["published"]["viscous_friction"]["coefficient"]
    assert viscous(found) == pytest.approx([published] * len(found["named"]), rel=0.25)


@pytest.mark.xfail(strict=True, reason="the plant has no friction that grows with the load: few logs prove one of its formulas")
def test_every_log_gives_the_published_viscous_friction(result: dict[str, Any]) -> None:
    found = repeats(result["views"]["motor"])["viscous_friction"]
    assert found["verdict"] == "consistent"
    assert len(found["named"]) == 8
    published = result["published"]["viscous_friction"]["coefficient"]
    assert found["parameters"]["coefficient"] == pytest.approx([published] * 8, rel=0.15)


@pytest.mark.xfail(strict=True, reason="the plant has no friction that grows with the load: few logs prove one of its formulas")
def test_dry_friction_is_named_and_said_to_grow_with_the_gain(result: dict[str, Any]) -> None:
    """The authors' richer models let it grow with the load; a higher gain means more torque."""
    found = repeats(result["views"]["motor"])["coulomb_friction"]
    assert found["verdict"] == "moves"
    by_gain: dict[int, list[float]] = {}
    for run, value in zip(found["named"], found["parameters"]["force"], strict=True):
        by_gain.setdefault(int(run.rsplit("-", 1)[1]), []).append(value)
    means = [sum(values) / len(values) for _, values in sorted(by_gain.items())]
    assert means == sorted(means)
    assert means[-1] > 2.0 * means[0]


def test_the_inertia_of_the_rotor_is_adjusted_to_the_published_one(result: dict[str, Any]) -> None:
    written = {item["name"]: item["parameters"] for item in result["views"]["motor"]["together"]["written"]}
    assert written["inertial_error"]["rotor"] == pytest.approx(result["published"]["inertial_error"]["rotor"], rel=0.15)


def test_dry_friction_is_not_named_where_it_grows_with_the_load(result: dict[str, Any]) -> None:
    """The authors' richer models let it; of one value each log gives another one, from 0.02 to 0.06 N·m."""
    assert "coulomb_friction" not in repeats(result["views"]["motor"])


def test_the_servo_from_outside_gets_no_name_from_all_logs(result: dict[str, Any]) -> None:
    """A weak proportional controller under a weight is a spring; no effect of a position axis is that."""
    view = result["views"]["servo"]
    assert view["together"]["verdict"] == "unnamed"
    assert all(item["verdict"] != "consistent" for item in view["stability"])


@pytest.mark.xfail(strict=True, reason="in one log of a pendulum near its rest the sag is proportional to the reading")
def test_the_servo_from_outside_gets_no_name_from_any_log(result: dict[str, Any]) -> None:
    """A weak proportional controller under a weight is a spring; no effect of a position axis is that."""
    view = result["views"]["servo"]
    assert view["stability"] == []
    assert all(run["unnamed"] for run in view["runs"].values())
