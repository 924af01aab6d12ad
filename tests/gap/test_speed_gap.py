"""The gap of a measured speed: in the free run and at the command stage, with its noise floor."""

from __future__ import annotations

from dataclasses import replace

import lift_motion
import numpy as np
import pytest

from sysid.datasets.recording import Dataset
from sysid.gap import find_gap
from sysid.gap.prepare.noise import noise_levels
from sysid.machine import KnownEffect
from sysid.plant import Plant, free_run, nominal_plant

NOISE = 8e-4  # of the speed [m/s]


def true_plant() -> Plant:
    plant = nominal_plant(lift_motion.lift())
    plant = plant.with_effect(KnownEffect("first_order_lag", "boom", {"time_constant": 0.1}))
    return plant.with_effect(KnownEffect("gain_error", "boom", {"ratio": 0.8}))


def dataset(speed: bool = True) -> Dataset:
    """The motion of the true plant, with a speed measured beside the position."""
    made = lift_motion.dataset()
    recordings = []
    for number, recording in enumerate(made.recordings):
        rng = np.random.default_rng(number)
        with_column = replace(recording, table=recording.table.assign(**{"boom.speed": 0.0}))
        run = free_run(true_plant(), with_column)
        columns = {"boom.cylinder": run["boom.cylinder"] + rng.normal(0.0, 2e-5, len(run))}
        if speed:
            columns["boom.speed"] = run["boom.speed"] + rng.normal(0.0, NOISE, len(run))
        recordings.append(replace(recording, table=recording.table.drop(columns="boom.joint").assign(**columns)))
    return replace(made, recordings=tuple(recordings))


def test_the_gap_of_a_speed_is_that_of_its_rate() -> None:
    measured = dataset()
    result = find_gap(measured, nominal_plant(measured.machine), localise_only=True)
    for gap in (result.gap, result.stage_gap):
        assert list(gap.before) == ["boom.cylinder", "boom.speed"]
        assert gap.noise_floor["boom.speed"] == pytest.approx(NOISE, rel=0.05)
    held_out = measured.with_role("held_out")[0]
    nominal, true = free_run(nominal_plant(measured.machine), held_out), free_run(true_plant(), held_out)
    apart = float(np.sqrt(np.mean((nominal["boom.speed"] - true["boom.speed"]) ** 2)))
    assert apart > 3.0 * NOISE
    for gap in (result.gap, result.stage_gap):  # m/s
        assert gap.before["boom.speed"] == pytest.approx(np.hypot(apart, NOISE), rel=0.05)


def test_the_true_plant_reaches_the_noise_floor_of_the_speed() -> None:
    result = find_gap(dataset(), true_plant(), localise_only=True)
    assert result.verdict == "no_gap"
    for gap in (result.gap, result.stage_gap):
        assert gap.after["boom.speed"] == pytest.approx(gap.noise_floor["boom.speed"], rel=0.08)


def test_a_speed_does_not_change_the_rest_of_the_result() -> None:
    plant = nominal_plant(lift_motion.lift())
    with_, without = (find_gap(dataset(speed), plant, localise_only=True) for speed in (True, False))
    assert with_.localised == without.localised
    assert with_.maps == without.maps
    assert with_.excitation == without.excitation
    for one, other in ((with_.gap, without.gap), (with_.stage_gap, without.stage_gap)):
        assert one.before["boom.cylinder"] == other.before["boom.cylinder"]
        assert "boom.speed" not in other.before


def test_the_noise_of_a_speed_is_estimated_from_its_own_range() -> None:
    """A speed is noisier than a position: here 2 % of its range."""
    levels = noise_levels(dataset())
    assert levels["boom.speed"] == pytest.approx(NOISE, rel=0.1)
