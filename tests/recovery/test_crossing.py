"""Each effect hidden in turn: the workflow names it, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from cases import CASES, base, label
from plant_data import dataset_of

from sysid.gap import GapResult, find_gap
from sysid.machine import KnownEffect

#: For the fast tier; the logs of ``make demo`` hide some of command and tool, gap/test_proof.py others of sensor and force.
FAST = ("backlash-boom-drive",)
#: Recordings [s] that show what goes on for long.
SECONDS = {"temperature_drift": 90.0, "clock_skew": 90.0}


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
@pytest.mark.parametrize("truth", [c for c in CASES if label(c) not in FAST], ids=label)
def test_named_alone_in_full(truth: KnownEffect) -> None:
    named_alone(truth)
