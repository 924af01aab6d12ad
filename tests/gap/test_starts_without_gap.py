"""A machine that equals its plant has no gap, however its recording begins."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from start_data import BEGUN, NOISE, beyond_chance, excess, started

from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Dataset
from sysid.datasets.splits import split
from sysid.gap import find_gap


@pytest.mark.slow
@pytest.mark.parametrize("machines", [1, 10])
def test_there_is_no_gap_however_a_recording_begins(machines: int) -> None:
    """So many machines each: at rest, in motion, with commands on before the actuator moves, in mid-swing."""
    disagreeing, above, above_noise = {}, [], []
    for begun, seed in product(BEGUN, range(machines)):
        plant, recording = started(begun, seed)
        plant = replace(plant, machine=replace(plant.machine, noise=NOISE))
        parts, roles = split([replace(recording, name="run")], Splits(), "")
        found = find_gap(Dataset.of(plant.machine, parts, roles), plant)
        if found.verdict != "no_gap":  # an axis that hardly moves in the block that is held out says nothing
            assert found.verdict == "insufficient_excitation", found.headline
            assert "in the held-out recordings" in found.headline
        disagreeing |= {(begun, seed, item.signal): item for item in found.agreement if item.differs}
        above.append(excess(found.gap.before, found.gap.noise_floor))
        above_noise.append(excess(found.gap.before, NOISE))
    assert disagreeing == {}
    assert abs(beyond_chance(above)) < 1.0, above
    if machines > 1:  # enough to show that the floor needs the errors of the start
        assert beyond_chance(above_noise) > 1.0
