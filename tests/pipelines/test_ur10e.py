"""UR10e, measured: friction of every joint, and a payload of published mass from either log with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

#: Share of the torque that may be left on the first three joints of held-out motion.
LEFT = 0.1
LOADED = ("harmonics_14_load", "harmonics_15_load")


@pytest.fixture(scope="module")
def result(result_on_measured: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    pytest.importorskip("pinocchio", reason="the extra dynamics is not installed")
    return result_on_measured("ur10e", "ur10e_arm")


def names(run: dict[str, Any]) -> set[tuple[str, str]]:
    return {(effect["name"], effect["target"]) for effect in run["effects"]}


def test_friction_of_every_joint_is_named_and_nothing_else(result: dict[str, Any]) -> None:
    axes = {signal.partition(".")[0] for signal in result["left"]["ur10e"]}
    due = {(name, axis) for name in ("coulomb_friction", "viscous_friction") for axis in axes}
    loaded = {("load_dependent_friction", axis) for axis in ("shoulder_lift", "elbow")}
    assert names(result["runs"]["ur10e"]) == due | loaded


def test_little_torque_of_the_first_three_joints_is_left(result: dict[str, Any]) -> None:
    left = [result["left"]["ur10e"][f"{axis}.command"] for axis in ("shoulder_pan", "shoulder_lift", "elbow")]
    assert max(left) < LEFT


@pytest.mark.parametrize("log", LOADED)
def test_the_payload_alone_is_named_with_an_interval_that_contains_its_mass(result: dict[str, Any], log: str) -> None:
    (effect,) = result["runs"][log]["effects"]
    assert (effect["name"], effect["target"]) == ("payload", "tool")
    low, high = effect["interval95"]["mass"]
    assert low < result["published"]["payload"] < high
    assert effect["parameters"]["mass"] == pytest.approx(result["published"]["payload"], rel=0.03)


def test_both_logs_give_the_same_mass(result: dict[str, Any]) -> None:
    """Force constants and masses of the links are those of one repaired plant, which is where their common error lies."""
    first, second = (result["payload"][log] for log in LOADED)
    assert first == pytest.approx(second, rel=0.03)
