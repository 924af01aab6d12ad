"""What shows at several stages of the chain is one effect, named once."""

from __future__ import annotations

import pytest
from plant_data import CAPTURE, dataset_of, nominal

from sysid.gap import find_gap
from sysid.machine import KnownEffect


@pytest.mark.slow
def test_a_clock_that_shows_at_every_stage_is_named_once() -> None:
    """Cylinder against joint, joints against tip, tip against tool: the capture is late in all of them."""
    plant = nominal(streams=CAPTURE)
    late = KnownEffect("clock_offset", "capture", {"offset": 0.024})
    result = find_gap(dataset_of(plant.with_effect(late), 12.0, seed=4), plant)
    (found,) = result.effects
    assert (found.name, found.target) == ("clock_offset", "capture")
    assert abs(float(found.parameters["offset"]) - 0.024) < 2e-4  # type: ignore[arg-type]
    assert sum("clock_offset on capture shows at the" in note for note in result.notes) == 2
    assert result.unnamed == ()
