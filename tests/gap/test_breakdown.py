"""Maps show a disagreement where it is, and shares add up to the whole gap."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from plant_data import dataset_of, nominal, slide

from sysid.datasets.recording import Dataset
from sysid.gap.breakdown import maps_of, shares_of
from sysid.gap.prepare.case import open_case
from sysid.gap.result import Map, Share
from sysid.gap.unnamed.periodic import resonance_frequencies
from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant
from sysid.validate.error_analysis import SIGNED_BINS, speed_of

DEADBAND = (0.12, 0.09)
HIDDEN = (
    KnownEffect("valve_deadband", "boom", {"positive": DEADBAND[0], "negative": DEADBAND[1]}),
    KnownEffect("backlash", "slew", {"width": 0.02}, "drive"),
)


def located(dataset: Dataset, plant: Plant, repaired: Plant | None = None) -> dict[tuple[str, str, str], Map]:
    """(signal, over, quantity) → map."""
    case, stages = open_case(dataset, plant, 0)
    better = None if repaired is None else compile_plant(repaired).theta
    maps = [
        m for s in stages for m in maps_of(s.problem, case.theta, s.split.seen, s.sigma, plant.machine, dataset.units, better)
    ]
    assert len({(m.signal, m.over, m.quantity) for m in maps}) == len(maps)
    return {(m.signal, m.over, m.quantity): m for m in maps}


@pytest.fixture(scope="module")
def true() -> Plant:
    plant = nominal()
    for effect in HIDDEN:
        plant = plant.with_effect(effect)
    return plant


@pytest.fixture(scope="module")
def dataset(true: Plant) -> Dataset:
    return dataset_of(true, 20.0, seed=1)


@pytest.fixture(scope="module")
def maps(dataset: Dataset, true: Plant) -> dict[tuple[str, str, str], Map]:
    return located(dataset, nominal(), true)


def between(item: Map, low: float, high: float) -> list[int]:
    return [b for b, at in enumerate(item.at) if low <= at <= high]


def mean_over(values: Sequence[float], bins: list[int]) -> float:
    return float(np.mean([values[b] for b in bins]))


def test_a_dead_band_shows_at_small_commands(maps: dict[tuple[str, str, str], Map]) -> None:
    """Inside the band the machine stands and the simulation moves; beyond it their speeds stay apart by gain · band."""
    item = maps["boom.cylinder", "boom.command", "speed error"]
    assert (item.error_unit, item.unit) == ("m/s", "1")
    assert len(item.at) <= SIGNED_BINS
    beyond = between(item, 0.3, 1.0)
    assert mean_over(item.mean, beyond) == pytest.approx(-0.025 * DEADBAND[0], rel=0.1)
    assert mean_over(item.mean, between(item, -1.0, -0.3)) == pytest.approx(0.025 * DEADBAND[1], rel=0.1)
    (rest,) = [b for b, at in enumerate(item.at) if abs(at) < 0.02]
    assert abs(item.mean[rest]) < 1e-4
    # Measured speed as a share of the simulated one rises with the command from almost nothing towards one.
    ratio = [m / s for m, s in zip(item.measured, item.simulated, strict=True)]
    low, high = mean_over(ratio, between(item, 0.04, 0.2)), mean_over(ratio, between(item, 0.8, 1.0))
    assert low < 0.5 < 0.8 < high


def test_the_most_telling_map_of_a_dead_band_is_over_the_command(maps: dict[tuple[str, str, str], Map]) -> None:
    of_boom = [m for (signal, _, _), m in maps.items() if signal == "boom.cylinder"]
    assert of_boom == sorted(of_boom, key=lambda m: -m.explains)
    assert of_boom[0].over in ("boom.command", "speed of boom")
    assert maps["boom.cylinder", "boom.command", "speed error"].explains > 0.6
    assert maps["boom.cylinder", "slew.command", "speed error"].explains < 0.2


def test_a_play_shows_as_a_position_that_depends_on_the_direction(maps: dict[tuple[str, str, str], Map]) -> None:
    item = maps["slew.joint", "direction of slew", "error"]
    assert item.at == (-1.0, 0.0, 1.0)
    assert item.mean[0] - item.mean[2] == pytest.approx(0.02, rel=0.15)


def test_the_repair_takes_the_disagreement_away(maps: dict[tuple[str, str, str], Map]) -> None:
    item = maps["boom.cylinder", "boom.command", "speed error"]
    assert max(map(abs, item.after)) < 0.2 * max(map(abs, item.mean))


def test_counts_and_spread_are_those_of_the_rows(dataset: Dataset, maps: dict[tuple[str, str, str], Map]) -> None:
    item = maps["boom.joint", "boom.cylinder", "error"]
    rows = sum(len(r) for r in dataset.recordings if dataset.splits[r.name] != "held_out")
    assert 0.95 * rows <= sum(item.count) <= rows
    assert item.measured == () == item.simulated
    # No effect sits between cylinder and joint: what is left is noise of the joint and of the cylinder.
    np.testing.assert_allclose(item.spread, item.noise_floor, rtol=0.35)
    assert item.explains < 0.05


def test_where_nothing_differs_no_map_says_otherwise() -> None:
    plant = nominal()
    for item in located(dataset_of(plant, 20.0, seed=2), plant).values():
        assert item.explains < 0.3
        assert np.quantile(np.abs(item.mean), 0.8) < 1.5 * item.noise_floor, (item.signal, item.over)
        assert item.after == ()


def test_speed_of_a_ramp_and_at_its_ends() -> None:
    ramp = np.asarray(0.3 * np.arange(200)[:, None] / 100.0, dtype=np.float64)
    speed = speed_of(ramp, 100.0)
    assert np.isnan(speed[[0, 9, -10, -1]]).all()
    np.testing.assert_allclose(speed[10:-10], 0.3)
    assert np.isnan(speed_of(ramp[:5], 100.0)).all()


# -- shares --------------------------------------------------------------------------------------------------------------


def by_stage(shares: Sequence[Share], end: str) -> dict[tuple[str, str], float]:
    return {(s.stage, s.target): s.share for s in shares if s.end == end}


def test_shares_add_up_and_name_the_guilty_stages(dataset: Dataset) -> None:
    shares = shares_of(compile_plant(nominal()), dataset.with_role("fit"))
    assert list(dict.fromkeys(s.end for s in shares)) == ["boom.joint", "ee", "tool"]
    for end in ("boom.joint", "ee", "tool"):
        assert sum(by_stage(shares, end).values()) == pytest.approx(1.0, abs=1e-9)
    tip = by_stage(shares, "ee")
    assert tip["command", "boom"] > 0.6
    assert tip["command", "boom"] + tip["command", "slew"] > 0.98
    assert by_stage(shares, "boom.joint")["command", "boom"] > 0.99


def test_a_sway_that_is_not_simulated_is_attributed_to_the_tool() -> None:
    plant = nominal(KnownEffect("first_order_lag", "wrist", {"time_constant": 0.15}))  # a servo that jumps throws the tool
    true = plant.with_effect(KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.03}))
    dataset = dataset_of(true, 30.0, seed=3)
    shares = shares_of(compile_plant(plant), dataset.with_role("fit"))
    assert by_stage(shares, "tool")["tool", "tool"] > 0.98
    case, stages = open_case(dataset, plant, 0)
    tool = next(s for s in stages if s.problem.stage == "tool")
    natural = math.sqrt(9.81 / 0.25) / (2.0 * math.pi)
    np.testing.assert_allclose(
        resonance_frequencies(tool.problem, case.theta, tool.split.seen, tool.sigma)[:2], natural, rtol=0.05
    )
    for stage in stages:
        if stage is not tool:
            assert not resonance_frequencies(stage.problem, case.theta, stage.split.seen, stage.sigma).any()
    whole = {s.rmse for s in shares if s.end == "tool"}
    assert len(whole) == 1
    assert next(iter(whole)) > 0.2  # the tool hangs a quarter of a metre below where the simulation has it


def test_a_force_axis_has_one_stage_and_nothing_to_share() -> None:
    true = nominal(KnownEffect("coulomb_friction", "slide", {"force": 8.0}), machine=slide())
    dataset = dataset_of(true, 10.0, seed=4)
    assert shares_of(compile_plant(nominal(machine=slide())), dataset.with_role("fit")) == ()
    item = located(dataset, nominal(machine=slide()))["slide.command", "direction of slide", "error"]
    assert item.mean[0] == pytest.approx(-8.0, rel=0.2)
    assert item.mean[-1] == pytest.approx(8.0, rel=0.2)


def test_an_error_that_follows_a_swinging_motion_is_no_resonance() -> None:
    """The wrist is driven to and fro: a wrong link length behind it draws the same frequency."""
    dataset = dataset_of(nominal().with_effect(KnownEffect("link_length_error", "wrist", {"error": 0.01})), 20.0, seed=4)
    case, stages = open_case(dataset, nominal(), 0)
    (tip,) = [stage for stage in stages if stage.problem.stage == "end_effector"]
    assert not resonance_frequencies(tip.problem, case.theta, tip.split.seen, tip.sigma).any()
