"""Each effect hidden in turn: the workflow names it, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from cases import CASES, base, label
from plant_data import dataset_of

from sysid.gap import GapResult, find_gap
from sysid.machine import KnownEffect

#: One effect of each stage for the fast tier.
FAST = ("valve_deadband-slew", "backlash-boom-drive", "joint_offset-boom", "gripper_sway-tool", "load_bias-slide")


#: Recordings [s] that show what goes on for long.
SECONDS = {"temperature_drift": 90.0, "clock_skew": 90.0}
#: Cases in which something else is named as well, and why.
NOT_YET = {
    "sensor_scale-boom.joint": "the next stage believes the joint that was measured: joint_offset of the boom is named there",
    "sensor_bias-boom.joint": "the next stage believes the joint that was measured: joint_offset of the boom is named there",
}


def named_alone(truth: KnownEffect) -> GapResult:
    plant = base(truth)
    result = find_gap(dataset_of(plant.with_effect(truth), SECONDS.get(truth.name, 30.0), seed=4), plant)
    assert [(e.name, e.target, e.side) for e in result.effects] == [(truth.name, truth.target, truth.side)], result.verdict
    return result


@pytest.mark.parametrize("truth", [c for c in CASES if label(c) in FAST], ids=label)
def test_named_alone(truth: KnownEffect) -> None:
    result = named_alone(truth)
    for key, value in truth.parameters.items():
        found = result.effects[0].parameters[key]
        assert np.allclose(found, value, rtol=0.0, atol=0.05 * np.max(np.abs(value))), f"{key}: {found} for {value}"


@pytest.mark.slow
@pytest.mark.parametrize("truth", [c for c in CASES if label(c) not in (*FAST, *NOT_YET)], ids=label)
def test_named_alone_in_full(truth: KnownEffect) -> None:
    named_alone(truth)


@pytest.mark.slow
@pytest.mark.parametrize("truth", [c for c in CASES if label(c) in NOT_YET], ids=label)
def test_named_with_what_follows_from_it(truth: KnownEffect) -> None:
    """The effect itself is named, with its value; what is named beside it is not right yet."""
    plant = base(truth)
    result = find_gap(dataset_of(plant.with_effect(truth), 30.0, seed=4), plant)
    (found,) = (e for e in result.effects if (e.name, e.target) == (truth.name, truth.target))
    for key, value in truth.parameters.items():
        assert found.parameters[key] == pytest.approx(value, rel=0.05), key
    assert len(result.effects) > 1, "named alone: take it out of NOT_YET"


def test_what_is_not_named_alone_yet_is_a_case() -> None:
    assert set(NOT_YET) <= {label(case) for case in CASES}
    assert not set(NOT_YET) & set(FAST)
