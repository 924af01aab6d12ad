"""Networks along a motion: the page says what the committed result holds, and the benchmark of the pressure is a free run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest


@pytest.fixture(scope="module")
def along(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("networks_along")


def test_the_page_shows_the_committed_result(along: ModuleType) -> None:
    result = json.loads(along.RESULT.read_text("utf-8"))
    assert along.tables(result) in along.PAGE.read_text("utf-8")


def test_history_helps_where_there_is_play_and_is_no_worse_where_there_is_none(along: ModuleType) -> None:
    """Of the committed figures."""
    found = json.loads(along.RESULT.read_text("utf-8"))["history"]
    for entry in found["1 mm of play"]["outputs"].values():
        assert entry["history"]["rmse"] < 0.7 * entry["static"]["rmse"]
    for entry in found["no play"]["outputs"].values():
        assert entry["history"]["rmse"] < 1.02 * entry["static"]["rmse"]


def test_the_run_over_the_second_half_knows_nothing_of_it(along: ModuleType, shared_data: Path) -> None:
    raw = shared_data / "hyd_actuator"
    if not raw.exists():
        pytest.skip("no hyd_actuator among the measured data")
    valve, oil, _ = along.columns(raw, 20.0)
    network = along.fit_motion(along.pressure_data(valve, oil), _recipe(along))["arm"]
    changed = oil.copy()
    changed[along.HALF :] = 0.0
    error, moved = (along.second_half(network, valve, values) for values in (oil, changed))
    assert error < 1.6, "below the RMS of the pressure itself"
    depth = network.window.depth
    run = network.roll(valve[511 - depth : 1023][None], oil[511 - depth : 512][None])[0, 1:]
    assert moved == pytest.approx(float(np.sqrt(np.mean(run**2))))


def _recipe(along: ModuleType) -> object:
    training = {"learning_rate": 3e-3, "batch": 32, "epochs": 40, "patience": 20}
    return along.parse_recipe({"motion": along.PRESSURE["two commands, three pressures"] | {"training": training}}, "test")
