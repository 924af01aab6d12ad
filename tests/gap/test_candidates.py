"""What may be missing at a stage, and from where a fit of it starts."""

from __future__ import annotations

import numpy as np
import pytest
from plant_data import CAPTURE, dataset_of, loaded_arm, nominal

from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.case import open_case, scales_of, stage_candidates
from sysid.gap.search import starting_values
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
    assert not [c for c in candidates_at(plant, plant.vector(), "command", ("boom",)) if c.effect.name == "load_dependent_flow"]


def test_starts_of_weight_effects_are_shares_of_the_load() -> None:
    plant = nominal()
    (one,) = (
        c
        for c in candidates_at(plant, plant.vector(), "command", ("boom",), Scales(loads={"boom": 40.0}))
        if c.effect.name == "load_dependent_flow"
    )
    (parameter,) = one.form.parameters
    assert np.ravel(one.starts) == pytest.approx([start / 40.0 for start in parameter.starts])
    assert one.unknowns[0].negligible == pytest.approx(parameter.negligible / 40.0)


def test_quantisation_is_tried_where_readings_come_in_steps() -> None:
    step = KnownEffect("sensor_quantisation", "boom.joint", {"step": 0.004})
    assert "sensor_quantisation(boom.joint)" in names_at(nominal(step), "joint", "boom")
    assert "sensor_quantisation(boom.joint)" not in names_at(nominal(), "joint", "boom")
    plant = nominal(step)
    case, stages = open_case(dataset_of(plant, 5.0), plant, 0)
    (joint,) = (s for s in stages if s.problem.stage == "joint")
    assert scales_of(case.plant, joint).steps == {"boom.cylinder": 0.0, "boom.joint": pytest.approx(0.004, rel=1e-9)}


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("pump_flow_limit", 0.5, 4.0),
        ("command_rate_limit", 0.5, 20.0),
        ("oil_compressibility", 4.0, 24.0),
        ("flow_saturation", 0.2, 1.6),
    ],
)
def test_an_absent_effect_is_searched_where_it_would_act(name: str, low: float, high: float) -> None:
    """Neutral values of limits are huge: starts spread up to them would all lie where nothing happens."""
    plant = nominal()
    targets = ("machine",) if name == "pump_flow_limit" else ("slew",)
    candidate: Candidate = next(c for c in candidates_at(plant, plant.vector(), "command", targets) if c.effect.name == name)
    starts = np.array(starting_values([candidate], (), 0))
    assert starts[0, 0] == candidate.unknowns[0].nominal
    assert (starts[1:, 0] >= min(low, *candidate.starts[0])).all()
    assert (starts[1:, 0] <= high).all()
    assert {start[0] for start in candidate.starts} <= set(starts[:, 0])
