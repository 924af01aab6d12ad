"""The tracking error of a run, by what its sensors say: against the target when they measured, in distinct norms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flights import cycle

from sysid_rl.run.dry_run import RangeRecorder
from sysid_rl.run.transport import Measurement

PERIOD = 10_000_000
SPEED, OFF = np.array([0.2, -0.1, 0.05]), np.array([0.003, 0.0, 0.004])


def recorded(age_ns: int, turns: int = 200) -> RangeRecorder:
    """A target at constant speed, and a machine ``OFF`` beside it whose sensors are ``age_ns`` behind."""
    ranges = RangeRecorder(4, PERIOD)
    for k in range(turns):
        at = k * PERIOD
        measured = at - age_ns
        readings = {"slew.joint": Measurement(0.0, measured, at, k)}
        ee, target = SPEED * measured * 1e-9 + OFF * (1 if k % 2 else -1), SPEED * (at + PERIOD) * 1e-9
        ranges.record(replace(cycle(k), at_ns=at, readings=readings, ee=ee, target=target, enabled=True))
    return ranges


@pytest.mark.parametrize("age_ns", [0, 7_000_000, 45_000_000])
def test_a_reading_that_is_old_is_compared_with_the_target_of_then(age_ns: int) -> None:
    ranges = recorded(age_ns)
    assert ranges.tracked > 190
    assert ranges.rmse == pytest.approx([0.003, 0.0, 0.004])
    assert ranges.worst == pytest.approx([0.003, 0.0, 0.004])
    assert ranges.distance == pytest.approx({"mean": 0.005, "rmse": 0.005, "max": 0.005})


def test_nothing_is_said_where_nothing_was_tracked() -> None:
    ranges = RangeRecorder(4, PERIOD)
    ranges.record(cycle(0))
    assert ranges.rmse is None
    assert ranges.distance == {}
