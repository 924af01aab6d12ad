"""The predicted speed: rate of what the command drives, for valves, servos and force axes, and the sensor that measures it."""

from __future__ import annotations

from dataclasses import replace

import lift_motion
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, compile_plant, free_run, nominal_plant
from sysid.plant.rate import rate_of

Array = npt.NDArray[np.float64]


def recording(speed: bool = True) -> Recording:
    made = lift_motion.recording("run", 3, seconds=20.0)
    return with_speed(made) if speed else made


def with_speed(made: Recording) -> Recording:
    return replace(made, table=made.table.assign(**{"boom.speed": rate_of(made.values("boom.cylinder"), made.rate_hz)}))


def lift(actuation: str = "velocity", drives: str = "cylinder", **keys: float) -> Plant:
    text = lift_motion.MACHINE.replace("ACTUATION", actuation).replace("limits = [-0.4, 1.2]", "limits = [-0.4, 1.2]\nEXTRA")
    text = text.replace("EXTRA", "\n".join(f"{key} = {value}" for key, value in keys.items()))
    if drives == "joint":
        text = text.replace('drives = "cylinder"', 'drives = "joint"').replace("stroke = [0.0, 0.2]\n", "")
    return nominal_plant(machine_from_files({"machine.toml": text}, "lift"))


@given(hnp.arrays(np.float64, st.integers(3, 30), elements=st.floats(-1.0, 1.0)), st.floats(0.1, 1000.0))
def test_the_rate_of_a_parabola_is_exact_at_every_inner_sample(values: Array, rate_hz: float) -> None:
    time = np.arange(len(values)) / rate_hz
    a, b = values[0], values[1]
    found = rate_of((a * time**2 + b * time)[None], rate_hz)[0]
    np.testing.assert_allclose(found[1:-1], (2.0 * a * time + b)[1:-1], atol=1e-6 * (1.0 + rate_hz * time[-1] ** 2))


def test_the_rate_beside_missing_values_is_one_sided_and_missing_in_them() -> None:
    values = np.array([np.nan, 1.0, 3.0, 4.0, np.nan, 7.0, np.nan, 2.0, 5.0])
    expected = [np.nan, 2.0, 1.5, 1.0, np.nan, np.nan, np.nan, 3.0, 3.0]
    np.testing.assert_array_equal(rate_of(values, 1.0), expected)


def test_a_valve_axis_stops_at_its_end() -> None:
    plant, rate = lift(), lift_motion.RATE
    command = np.concatenate([np.zeros(25), np.ones(200)])
    table = pd.DataFrame({"time": np.arange(225) / rate, "boom.command": command, "boom.cylinder": 0.1, "boom.speed": 0.0})
    run = free_run(plant, Recording("run", table, rate))
    speed = run["boom.speed"].to_numpy()
    np.testing.assert_array_equal(speed[:25], 0.0)
    assert speed[25] == pytest.approx(0.5 * lift_motion.GAIN)  # the mean of the steps before and after the sample
    np.testing.assert_allclose(speed[26:120], lift_motion.GAIN, rtol=1e-9)
    np.testing.assert_array_equal(speed[-60:], 0.0)  # at the end stop, whatever the valve lets through
    assert run["boom.cylinder"].to_numpy()[-1] == 0.2


@pytest.mark.parametrize(("actuation", "drives"), [("velocity", "cylinder"), ("velocity", "joint"), ("position", "joint")])
def test_the_speed_is_the_rate_of_the_driven_signal(actuation: str, drives: str) -> None:
    plant = lift(actuation, drives).with_effect(KnownEffect("first_order_lag", "boom", {"time_constant": 0.1}))
    if drives == "joint":
        plant = plant.with_effect(KnownEffect("backlash", "boom", {"width": 0.004}, "drive"))
    run = free_run(plant, recording())
    expected = rate_of(run[f"boom.{drives}"].to_numpy(), lift_motion.RATE)
    np.testing.assert_allclose(run["boom.speed"].to_numpy(), expected, atol=1e-12)
    assert np.abs(expected).max() > 0.01


def test_the_speed_of_a_force_axis_is_that_of_its_state() -> None:
    """Mean of the mean speeds of both steps: the state at the sample up to a quarter of its second difference."""
    plant = lift("force", "joint", inertia=2.0)
    rate = 200.0
    time = np.arange(400) / rate
    force = 0.3 * np.sin(2.0 * np.pi * time)
    table = pd.DataFrame({"time": time, "boom.command": force, "boom.joint": 0.2, "boom.speed": 0.0})
    speed = free_run(plant, Recording("run", table, rate))["boom.speed"].to_numpy()
    state = np.concatenate([[0.0], np.cumsum(force[:-1]) / rate / 2.0])
    away = speed - state - np.median(speed - state)  # the start speed is estimated from the measured motion
    assert np.abs(away)[1:-1].max() < 0.26 * np.abs(np.diff(state, 2)).max() + 1e-12
    assert np.abs(state).max() > 0.04


def test_a_recording_without_a_speed_gets_none() -> None:
    plant = lift()
    with_, without = free_run(plant, recording()), free_run(plant, recording(speed=False))
    assert "boom.speed" in with_
    assert "boom.speed" not in without
    pd.testing.assert_frame_equal(with_.drop(columns="boom.speed"), without)


def test_the_sensor_of_a_speed_has_errors_of_its_own() -> None:
    plant, made = lift(), recording()
    true = free_run(plant, made)
    wrong = plant.with_effect(KnownEffect("sensor_scale", "boom.speed", {"scale": 1.1}))
    wrong = wrong.with_effect(KnownEffect("sensor_bias", "boom.speed", {"bias": 0.003}))
    run = free_run(wrong, made)
    np.testing.assert_allclose(run["boom.speed"], 1.1 * true["boom.speed"] + 0.003)
    pd.testing.assert_frame_equal(run.drop(columns="boom.speed"), true.drop(columns="boom.speed"))
    # the position's sensor does not change the speed
    other = free_run(plant.with_effect(KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.1})), made)
    inner = slice(20, None)  # the start of the run is estimated from the measured position
    np.testing.assert_allclose(other["boom.speed"][inner], true["boom.speed"][inner], atol=1e-9)


def test_the_stage_predicts_it_for_many_plants_at_once() -> None:
    plant, made = lift(), recording()
    thetas = np.stack([plant.vector(), plant.with_effect(KnownEffect("gain_error", "boom", {"ratio": 0.8})).vector()])
    model = compile_plant(plant)
    drive, speed = model.drive(thetas, made, "boom"), model.speed(thetas, made, "boom")
    assert speed.shape == (2, len(made))
    np.testing.assert_allclose(speed, rate_of(drive, made.rate_hz), atol=1e-12)


def test_a_misspelt_signal_suggests_the_speed() -> None:
    with pytest.raises(SettingsError, match=r"boom\.speed"):
        lift().with_effect(KnownEffect("sensor_scale", "boom.sped", {"scale": 1.1}))
