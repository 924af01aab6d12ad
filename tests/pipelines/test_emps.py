"""EMPS, measured: what the rigid and the viscous-only simulation lack, beside the published figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.slow

VISCOUS, COULOMB, BIAS = 203.50, 20.394, -3.165


@pytest.fixture(scope="module")
def result(result_on_measured: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    return result_on_measured("emps")


def effects(run: dict[str, Any]) -> dict[str, dict[str, float]]:
    return {effect["name"]: effect["parameters"] for effect in run["gap"]["effects"]}


def test_least_squares_under_our_filter_repeat_the_published_parameters(result: dict[str, Any]) -> None:
    for structure, fit in result["least_squares"].items():
        for name, value in result["published"][structure]["parameters"].items():
            assert fit["parameters"][name] == pytest.approx(value, rel=0.03), f"{structure}: {name}"


@pytest.mark.parametrize("start", ["rigid", "viscous only"])
def test_one_value_an_effect(result: dict[str, Any], start: str) -> None:
    """The slide is level: its offset is what one viscous coefficient needs beside two, half their difference at the mean speed.

    38 N·s/m at 0.081 m/s are 3.1 N. It is in the plant, since it halves the error, and no load, so that it has no name.
    """
    run = result["runs"][f"{start}, simple forms"]
    found = effects(run)
    assert found["coulomb_friction"]["force"] == pytest.approx(COULOMB, rel=0.1)
    if start == "rigid":
        assert found["viscous_friction"]["coefficient"] == pytest.approx(VISCOUS, rel=0.1)
    assert "load_bias" not in found
    (offset,) = (each for each in run["gap"]["written"] if each["name"] == "load_bias")
    assert offset["kind"] == "adjusted"
    assert offset["parameters"]["force"] == pytest.approx(BIAS, rel=0.1)
    assert run["error"]["after"]["pulses"] < 1.05 * result["least_squares"]["one value each"]["error"]["pulses"]


@pytest.mark.parametrize("start", ["rigid", "viscous only"])
def test_friction_by_direction_predicts_unseen_force_as_well_as_least_squares(result: dict[str, Any], start: str) -> None:
    run = result["runs"][f"{start}, all forms"]
    found = effects(run)
    assert found["viscous_friction"]["positive"] == pytest.approx(166.7, rel=0.1)
    assert found["viscous_friction"]["negative"] == pytest.approx(240.4, rel=0.1)
    assert set(found) <= {"viscous_friction", "coulomb_friction", "load_bias"}
    best = result["least_squares"]["by direction"]["error"]["pulses"]
    assert run["error"]["after"]["pulses"] < 1.2 * best
    assert run["error"]["after"]["pulses"] < result["published"]["one value each"]["error"]["pulses"]
