"""Servos that sag under gravity, and servos with a biased encoder: what is named with and without masses."""

from __future__ import annotations

import pytest
from sagging_servo import Servos, servo_dataset

from sysid.gap import GapResult, find_gap
from sysid.plant import nominal_plant

pytestmark = pytest.mark.slow

SAG = {"shoulder": 0.09, "elbow": 0.12}  # up to 3.3° and 0.8°


def gap_of(servos: Servos, masses: bool | None) -> GapResult:
    dataset = servo_dataset(servos, masses)
    return find_gap(dataset, nominal_plant(dataset.machine))


def names(result: GapResult) -> set[tuple[str, str]]:
    return {(effect.name, effect.target) for effect in result.effects}


def of_sensors(result: GapResult) -> set[tuple[str, str]]:
    return {item for item in names(result) if item[0].startswith("sensor_")}


@pytest.fixture(scope="module")
def without_masses() -> GapResult:
    return gap_of(Servos(SAG), None)


def test_without_masses_sag_is_not_named_as_an_error_of_the_sensor(without_masses: GapResult) -> None:
    assert of_sensors(without_masses) == set()
    assert {("input_delay", "yaw"), ("first_order_lag", "yaw")} <= names(without_masses)


@pytest.mark.parametrize("axis", SAG)
def test_without_masses_sag_and_bias_tie(without_masses: GapResult, axis: str) -> None:
    (tie,) = [set(tie) for tie in without_masses.ambiguous if ("joint_compliance", axis) in tie]
    assert ("sensor_bias", f"{axis}.joint") in tie


def test_without_masses_an_axis_without_an_error_at_rest_has_no_tie(without_masses: GapResult) -> None:
    assert not [tie for tie in without_masses.ambiguous if ("joint_compliance", "yaw") in tie]


def test_the_next_recording_is_one_with_masses_or_a_known_weight(without_masses: GapResult) -> None:
    (text,) = [text for text in without_masses.next_experiment if text.startswith("Gravity of")]
    assert text.startswith("Gravity of shoulder and elbow: give the masses")
    assert "known weight" in text


def test_the_repaired_simulation_contains_the_error_at_rest(without_masses: GapResult) -> None:
    gap = without_masses.gap
    for axis in SAG:
        assert gap.after[f"{axis}.joint"] < 0.2 * gap.before[f"{axis}.joint"]
    assert {(e.name, e.target) for e in without_masses.written if e.kind == "tied"} >= {("sensor_bias", "shoulder.joint")}


def test_with_masses_the_compliance_is_named() -> None:
    result = gap_of(Servos(SAG), True)
    assert of_sensors(result) == set()
    found = {e.target: e.parameters["compliance"] for e in result.effects if e.name == "joint_compliance"}
    assert found == pytest.approx(SAG, rel=0.05)
    assert result.ambiguous == ()


def test_with_masses_a_bias_of_the_sensor_is_named() -> None:
    bias = {"yaw": 0.02, "shoulder": -0.03}
    result = gap_of(Servos(bias=bias), True)
    assert of_sensors(result) == {("sensor_bias", f"{axis}.joint") for axis in bias}
    found = {e.target: e.parameters["bias"] for e in result.effects if e.name == "sensor_bias"}
    assert found == pytest.approx({f"{axis}.joint": value for axis, value in bias.items()}, abs=5e-4)
    assert "joint_compliance" not in {name for name, _ in names(result)}


def test_on_a_vertical_axis_a_bias_needs_no_masses() -> None:
    result = gap_of(Servos(SAG, {"yaw": 0.02}), False)
    assert ("sensor_bias", "yaw.joint") in names(result)
    assert of_sensors(result) == {("sensor_bias", "yaw.joint")}
