"""SO-101, measured: the same play from recordings that share nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def result(result_on_measured: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    return result_on_measured("so101", "sage_so101")


@pytest.mark.parametrize(("joint", "width"), [("rotation", 0.020), ("wrist_roll", 0.0165)])
def test_play_of_a_joint_without_weight_is_the_same_in_every_recording(
    result: dict[str, Any], joint: str, width: float
) -> None:
    (play,) = [item for item in result["stability"] if (item["name"], item["target"]) == ("backlash", joint)]
    assert play["verdict"] == "consistent"
    assert len(play["named"]) >= 2
    assert play["parameters"]["width"] == pytest.approx([width] * len(play["named"]), rel=0.35)  # 1.0 to 1.5° have been seen


@pytest.mark.parametrize("joint", ["rotation", "wrist_roll"])
@pytest.mark.parametrize("recording", ["friction_gravity", "multisine"])
def test_the_repaired_simulation_predicts_the_last_block_better(result: dict[str, Any], recording: str, joint: str) -> None:
    gap = result["runs"][recording]["gap"]
    assert gap["after"][f"{joint}.joint"] < 0.3 * gap["before"][f"{joint}.joint"]


def test_what_sags_under_the_arm_is_left_over_and_said(result: dict[str, Any]) -> None:
    for recording in ("friction_gravity", "multisine"):
        left = {item["target"] for item in result["runs"][recording]["unnamed"]}
        assert {"pitch", "elbow"} <= left
