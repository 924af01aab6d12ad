"""Recordings of one stage do not always have the same variables, or any."""

from __future__ import annotations

import numpy as np

from sysid.gap.unnamed.periodic import find_periodic_disturbance
from sysid.gap.unnamed.residual_series import BIN, PARTS, Factor, ResidualSeries, modulations


def series(number: int, *variables: str) -> ResidualSeries:
    """A minute of a residual that turns once in 4 s."""
    time = np.arange(PARTS * 601) * BIN / PARTS
    target = np.sin(0.5 * np.pi * BIN * np.arange(600)) + 0.01 * np.random.default_rng(number).standard_normal(600)
    return ResidualSeries(f"run-{number}", target, {"time": time} | {name: np.cos(time) for name in variables}, True, BIN)


def test_a_ripple_is_modulated_by_what_all_recordings_contain() -> None:
    names = "direction of a", "speed of a"
    whole = [series(number, *names) for number in range(3)]
    assert (Factor("abs", "direction of a"),) in modulations(whole)
    parted = [*whole, series(3)]
    assert modulations(parted) == [()]
    found = find_periodic_disturbance(parted, 0.0)
    assert found is not None
    assert abs(found.period - 4.0) < 0.05
