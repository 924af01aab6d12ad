"""The speed at full command that recordings show without a model, and how certain it is."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from plant_data import arm

from sysid.datasets.quality.responses import Direction, responses_in
from sysid.datasets.recording import Recording

Array = npt.NDArray[np.float64]
RATE, SPEED = 100.0, 0.05


def pushed(seconds: float, noise: float, seed: int) -> Direction:
    """The positive direction of a boom that is pushed at full command for some time, with noise of its sensor."""
    rng, rest, held = np.random.default_rng(seed), np.zeros(100), round(seconds * RATE)
    command = np.concatenate([rest, np.ones(held), rest, -np.ones(held), rest])
    place = 0.5 + np.cumsum(SPEED * command) / RATE + rng.normal(0.0, noise, len(command))
    time = np.arange(len(command)) / RATE
    table = pd.DataFrame({"time": time, "boom.command": command, "boom.cylinder": place})
    found = {each.axis: each for each in responses_in([Recording("r", table, RATE)], arm(), {})}
    assert found["boom"].positive is not None
    return found["boom"].positive


def test_the_interval_contains_the_speed() -> None:
    """At 95 % of the machines, and it is as narrow as the noise allows."""
    noise, found = 5e-4, [pushed(4.0, 5e-4, seed) for seed in range(60)]
    inside = [each.full95[0] <= SPEED <= each.full95[1] for each in found]
    assert np.mean(inside) >= 0.88, "three standard deviations below 95 % of 60"
    widths = [each.full95[1] - each.full95[0] for each in found]
    assert max(widths) < 4.0 * noise / 0.15


def test_a_short_push_has_no_interval() -> None:
    """A few samples of one window of the derivative are one value."""
    found = pushed(0.4, 1e-3, 0)
    assert math.isfinite(found.full)
    assert math.isnan(found.full95[0])


@pytest.mark.parametrize("seconds", [1.0, 3.0, 10.0])
def test_the_median_is_in_its_interval(seconds: float) -> None:
    found = pushed(seconds, 1e-3, 1)
    assert found.full95[0] <= found.full <= found.full95[1]
