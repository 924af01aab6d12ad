"""A machine that equals its plant has no gap, however its recording begins."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from start_data import BEGUN, NOISE, started

from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Dataset
from sysid.datasets.splits import split
from sysid.gap import find_gap

ABOVE = 1.1


@pytest.mark.parametrize("machines", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_there_is_no_gap_however_a_recording_begins(machines: int) -> None:
    """So many machines each: at rest, in motion, with commands on before the actuator moves, in mid-swing."""
    disagreeing, ratios = {}, {}
    for begun, seed in product(BEGUN, range(machines)):
        plant, recording = started(begun, seed)
        plant = replace(plant, machine=replace(plant.machine, noise=NOISE))
        parts, roles = split([replace(recording, name="run")], Splits(), "")
        found = find_gap(Dataset.of(plant.machine, parts, roles), plant)
        if found.verdict != "no_gap":  # an axis that hardly moves in the block that is held out says nothing
            assert found.verdict == "insufficient_excitation", found.headline
            assert "in the held-out recordings" in found.headline
        disagreeing |= {(begun, seed, item.signal): item for item in found.agreement if item.differs}
        gap = found.gap
        ratios |= {(begun, seed, signal): gap.before[signal] / floor for signal, floor in gap.noise_floor.items()}
    assert disagreeing == {}
    above = {key: ratio for key, ratio in ratios.items() if ratio > ABOVE}
    assert len(above) <= 0.05 * len(ratios), above
