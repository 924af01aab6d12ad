"""What may be missing at a stage, and from where a fit of it starts."""

from __future__ import annotations

import numpy as np
import pytest
from plant_data import CAPTURE, dataset_of, loaded_arm, nominal

from sysid.gap.candidates import Scales, candidates_at
from sysid.gap.prepare.case import open_case, stage_candidates
from sysid.machine import KnownEffect
from sysid.plant import Plant


def names_at(plant: Plant, stage: str, target: str) -> set[str]:
    case, stages = open_case(dataset_of(plant, 5.0), plant, 0)
    (found,) = (s for s in stages if (s.problem.stage, s.problem.target) == (stage, target))
    return {f"{c.effect.name}({c.target})" for c in stage_candidates(case, found)}


def test_clocks_are_candidates_where_two_streams_meet() -> None:
    joint = names_at(nominal(streams=CAPTURE), "joint", "boom")
    assert {"clock_offset(capture)", "clock_skew(capture)"} <= joint
    assert {"clock_offset(capture)", "clock_skew(capture)"} <= names_at(nominal(streams=CAPTURE), "tool", "tool")
    assert not any(name.startswith("clock") for name in names_at(nominal(), "joint", "boom"))
    assert not any(name.startswith("clock") for name in names_at(nominal(streams=CAPTURE), "command", "slew"))


def test_a_stream_called_like_the_machine_is_not_the_pump_s_target() -> None:
    """Logs of the machine itself often are ``machine.mcap``; they carry the commands, with which others are compared."""
    plant = nominal(streams={"machine": ("slew.command", "slew.joint", "boom.cylinder"), **CAPTURE})
    found = names_at(plant, "command", "slew")
    assert "pump_flow_limit(machine)" in found
    assert not any(name.startswith("clock") for name in found)


def test_effects_of_the_weight_are_offered_where_there_is_weight() -> None:
    command = names_at(nominal(machine=loaded_arm()), "command", "slew")
    assert "load_dependent_flow(slew)" not in command, "nothing hangs on an upright axis"
    assert "load_dependent_flow(boom)" in names_at(nominal(machine=loaded_arm()), "command", "boom")
    plant = nominal()
    assert not [
        c for c in candidates_at(plant, plant.vector(), ("command",), ("boom",)) if c.effect.name == "load_dependent_flow"
    ]


@pytest.mark.parametrize("values", [{"breakaway": 0.2, "release": 0.1}, {"spool_breakaway": 0.2, "spool_release": 0.01}])
def test_an_effect_of_the_plant_is_offered_in_its_form(values: dict[str, float | list[float]]) -> None:
    plant = nominal(KnownEffect("stiction", "boom", values))
    found = [c for c in candidates_at(plant, plant.vector(), ("command",), ("boom",)) if c.effect.name == "stiction"]
    assert [c.form.names for c in found] == [tuple(values)]
    free = nominal()
    assert len([c for c in candidates_at(free, free.vector(), ("command",), ("boom",)) if c.effect.name == "stiction"]) == 2


def test_starts_of_weight_effects_are_shares_of_the_load() -> None:
    plant = nominal()
    (one,) = (
        c
        for c in candidates_at(plant, plant.vector(), ("command",), ("boom",), Scales(loads={"boom": 40.0}))
        if c.effect.name == "load_dependent_flow"
    )
    (parameter,) = one.form.parameters
    assert np.ravel(one.starts) == pytest.approx([start / 40.0 for start in parameter.starts])
    assert one.unknowns[0].negligible == pytest.approx(parameter.negligible / 40.0)
