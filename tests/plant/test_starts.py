"""Where runs start: nothing is known of what the machine did before its recording begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import arm_inputs, measured, nominal, slide, slide_inputs
from start_data import BEGUN, NOISE, Begun, beyond_chance, excess, started

from sysid.datasets.recording import Recording
from sysid.effects import gripper_sway
from sysid.gap.prepare.noise import run_floors
from sysid.machine import KnownEffect
from sysid.plant import Model, Plant, compile_plant, free_run
from sysid.plant.rollout import true_run
from sysid.plant.stepper import Stepper, held_commands, step_commands, swing_start
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]
SECONDS = 60.0


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def compared(model: Model, recording: Recording, noise: dict[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Error of the free run, and its noise floor, by signal."""
    run = free_run(model, recording)
    floor, _ = run_floors(lambda r: free_run(model, r), [(recording, run)], noise, 0)
    return {signal: rms(recording.values(signal) - run[signal].to_numpy()) for signal in noise}, floor


def ratios(model: Model, recording: Recording, noise: dict[str, float]) -> dict[str, float]:
    """Error of the free run over its noise floor, by signal."""
    error, floor = compared(model, recording, noise)
    return {signal: error[signal] / floor[signal] for signal in noise}


def cut(recording: Recording, first: int) -> Recording:
    """The recording from sample ``first`` on."""
    table = recording.table.iloc[first:].reset_index(drop=True)
    return replace(recording, table=table.assign(time=table["time"] - table["time"].iloc[0]))


# -- a machine that equals the plant --------------------------------------------------------------------------------


def test_a_machine_that_equals_the_plant_ends_at_the_noise_floor() -> None:
    """The floor of a few signals is that of a start estimated from half a second, so that a run may lie above it by chance."""
    found, above = {}, []
    for begun in BEGUN:
        for seed in range(3):
            plant, recording = started(begun, seed, SECONDS)
            error, floor = compared(compile_plant(plant), recording, NOISE)
            found |= {(begun, seed, signal): error[signal] / floor[signal] for signal in NOISE}
            above.append(excess(error, {signal: floor[signal] for signal in NOISE}))
    assert abs(beyond_chance(above)) < 1.0, above
    assert max(found.values()) < 2.0, found
    driven = [ratio for (_, _, signal), ratio in found.items() if signal in ("slew.joint", "boom.cylinder", "wrist.joint")]
    assert max(driven) < 1.1


@pytest.mark.parametrize("begun", BEGUN)
def test_stages_start_where_the_free_run_does(begun: Begun) -> None:
    """Lanes in the run of a stage, which is what a fit uses, and the whole machine."""
    plant, recording = started(begun, 7, 10.0)
    model = compile_plant(plant)
    drive, _, _ = true_run(model, recording)
    for i, axis in enumerate(model.machine.axes):
        lanes = model.drive(np.tile(model.theta, (3, 1)), recording, axis.name)
        np.testing.assert_allclose(lanes, np.tile(drive[:, i], (3, 1)), rtol=0.0, atol=1e-12)


def test_short_runs_go_on_with_the_valve_as_it_is() -> None:
    """Commands before a restart are known: without noise it changes nothing."""
    effects = [
        KnownEffect(name, axis, values)
        for axis in ("slew", "boom", "wrist")
        for name, values in (("first_order_lag", {"time_constant": 0.15}), ("input_delay", {"delay": 0.2}))
    ]
    model = compile_plant(nominal(*effects))
    run = free_run(model, arm_inputs("run", 20.0, 1))
    recording = replace(arm_inputs("run", 20.0, 1), table=arm_inputs("run", 20.0, 1).table.assign(**dict(run.items())))
    for axis in model.machine.axes:
        short = model.drive(model.theta[None], recording, axis.name, 5.0)[0]
        np.testing.assert_allclose(short, run[axis.driven], rtol=0.0, atol=1e-9)


#: What bends the way from the opening of a valve to the speed of its axis.
BENDS = {
    "asymmetric_gain": {"ratio": 0.6},
    "command_rate_limit": {"rate": 3.0},
    "valve_deadband": {"positive": 0.1, "negative": 0.05},
    "oil_compressibility": {"frequency": 5.0, "damping_ratio": 0.1},
    "stiction": {"breakaway": 0.1, "release": 0.05},
    "backlash": {"width": 0.006},
}


@pytest.mark.parametrize("name", BENDS)
def test_other_effects_leave_no_offset(name: str) -> None:
    """Cut in mid-motion: what is wrong about the opening of the valve dies out, and nothing stays."""
    noise = 5e-4
    lag, delay = (
        KnownEffect("first_order_lag", "slew", {"time_constant": 0.1}),
        KnownEffect("input_delay", "slew", {"delay": 0.2}),
    )
    plant, offsets = nominal(lag, delay, KnownEffect(name, "slew", BENDS[name])), []
    for seed in range(4):
        rng, inputs = np.random.default_rng(seed), arm_inputs("run", 40.0, seed)
        joint = free_run(plant, inputs)["slew.joint"].to_numpy()
        whole = replace(inputs, table=inputs.table.assign(**{"slew.joint": joint + rng.normal(0.0, noise, len(joint))}))
        recording = cut(whole, 800 + 137 * seed)
        left = recording.values("slew.joint") - free_run(plant, recording)["slew.joint"].to_numpy()
        offsets.append(float(left[300:].mean()) / noise)
    assert np.abs(offsets).max() < 0.5, offsets


@pytest.mark.parametrize("seed", range(4))
def test_a_drive_anywhere_in_its_backlash_is_found_by_the_first_motion(seed: int) -> None:
    """Ten seconds of rest, in which the joint shows nothing of its drive: no offset remains once it moves."""
    noise, width, rate, first = 5e-4, 0.010, 100, 450
    plant = nominal(
        KnownEffect("first_order_lag", "slew", {"time_constant": 0.06}),
        KnownEffect("input_delay", "slew", {"delay": 0.04}),
        KnownEffect("backlash", "slew", {"width": width}),
    )
    inputs = arm_inputs("run", 40.0, seed)
    command = inputs.values("slew.command").copy()
    command[3 * rate : 13 * rate] = 0.0
    inputs = replace(inputs, table=inputs.table.assign(**{"slew.command": command}))
    joint = free_run(plant, inputs)["slew.joint"].to_numpy()
    read = joint + np.random.default_rng(seed).normal(0.0, noise, len(joint))
    whole = replace(inputs, table=inputs.table.assign(**{"slew.joint": read}))
    left = free_run(plant, cut(whole, first))["slew.joint"].to_numpy() - joint[first:]
    assert np.abs(left[9 * rate :]).max() < 0.2 * noise


# -- force axes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.0, 30.0])
def test_a_force_axis_starts_at_its_speed(friction: float) -> None:
    """Without friction an error of the speed grows for ever."""
    plant = nominal(KnownEffect("viscous_friction", "slide", {"positive": friction, "negative": friction}), machine=slide())
    for seed in range(3):
        inputs = slide_inputs("run", 25.0, seed)
        inputs = replace(inputs, table=inputs.table.drop(columns="at_samples"))
        recording = cut(measured(plant, inputs, seed), 2511)
        assert ratios(compile_plant(plant), recording, {"slide.joint": 5e-6})["slide.joint"] < 2.5


# -- the hanging tool -----------------------------------------------------------------------------------------------


def with_sway(plant: Plant, length: float) -> Model:
    return compile_plant(plant.with_effect(KnownEffect("gripper_sway", "tool", {"length": length, "damping_ratio": 0.03})))


@pytest.mark.parametrize("factor", [0.05, 0.3, 0.8, 1.3, 3.0, 12.0])
def test_a_wrong_length_starts_no_wild_swing(factor: float) -> None:
    """The estimated start fits its stretch no worse than a tool that begins to hang still."""
    plant, recording = started("in mid-swing", 3, 20.0)
    sway = plant.effect("gripper_sway", "tool")
    assert sway is not None
    model = with_sway(plant, factor * float(sway.parameters["length"]))  # type: ignore[arg-type]
    signals = point_signals("tool")
    unknown = replace(recording, table=recording.table.assign(**dict.fromkeys(signals, np.nan)))
    said = np.column_stack([recording.values(signal) for signal in signals])
    errors = [rms((said - model.tool(model.theta[None], r)[0])[:300, :2]) for r in (recording, unknown)]
    assert errors[0] < 1.05 * errors[1]


@pytest.mark.parametrize("width", [0.05, 0.4, 0.65, 0.8])
def test_a_wide_swing_starts_where_it_was(width: float) -> None:
    """Its period depends on its width, and its plane turns: a linear pendulum does not find it."""
    length, dt, count = 0.19, 0.01, 600
    plant = nominal(KnownEffect("gripper_sway", "tool", {"length": length, "damping_ratio": 0.014}))
    ee = np.full((count, 3), [0.8, -0.6, 1.2])
    state, tool = np.full(gripper_sway.MEMORY, 0.0), np.empty((count, 3))
    state[:2], state[2:4], state[4:7] = ee[0, :2] + length * np.array([width, 0.1]), [0.1, 0.5], ee[0]
    parameters = np.array([length, 0.014])
    for k in range(count):
        gripper_sway.step(*ee[k], parameters, 0, state, 0, dt, tool[k])
    noise = np.random.default_rng(1).normal(0.0, 5e-4, tool.shape)
    begun = swing_start(plant, ee, tool + noise, 1.0 / dt)
    again = np.empty((count, 3))
    for k in range(count):
        gripper_sway.step(*ee[k], parameters, 0, begun, 0, dt, again[k])
    assert rms((again - tool)[:, :2]) < 0.2 * 5e-4


def test_noise_alone_starts_no_swing() -> None:
    count, rng = 2000, np.random.default_rng(0)
    plant, recording = started("at rest", 0, 20.0)
    at = recording.table.iloc[0]
    still = {f"ee.{c}": np.full(count, at[f"ee.{c}"]) for c in "xyz"}
    hung = {f"tool.{c}": np.full(count, at[f"ee.{c}"]) + rng.normal(0.0, 5e-4, count) for c in "xyz"}
    model, recording = with_sway(plant, 0.25), replace(recording, table=recording.table.assign(**still, **hung))
    beside = model.tool(model.theta[None], recording)[0] - [at[signal] for signal in point_signals("ee")]
    assert 0.0 < rms(beside[:, :2]) < 1e-4


# -- the stepper ----------------------------------------------------------------------------------------------------


def test_the_stepper_begins_where_one_axis_restarts_and_the_others_go_on() -> None:
    plant, recording = started("in motion", 4, 10.0)
    command = recording.values("slew.command").copy()
    command[300:380] = np.nan
    recording = replace(recording, table=recording.table.assign(**{"slew.command": command}))
    drive, joints, _ = true_run(compile_plant(plant), recording)
    stepper = Stepper(plant, recording.rate_hz)
    states = [stepper.begin(recording, 380)]
    commands = step_commands(plant.machine, held_commands(plant.machine, recording)[380:])
    states += [stepper.step(row) for row in commands]
    np.testing.assert_allclose([state.drive[0] for state in states], drive[380:], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose([state.joints[0] for state in states], joints[380:], rtol=0.0, atol=1e-11)


def test_lanes_of_other_plants_begin_in_the_same_place_and_go_on_as_themselves() -> None:
    plant, recording = started("in motion", 5, 10.0)
    slower = plant.with_effect(KnownEffect("input_delay", "slew", {"delay": 0.4})).with_effect(
        KnownEffect("first_order_lag", "slew", {"time_constant": 0.3})
    )
    stepper = Stepper(plant, recording.rate_hz, 2, np.array([plant.vector(), slower.vector()]))
    begun = stepper.begin(recording, 0)
    np.testing.assert_array_equal(begun.drive[0, :2], begun.drive[1, :2])
    ahead = [stepper.step([1.0, 0.0, begun.drive[0, 2]]).drive[:, 0] for _ in range(300)]
    assert np.diff(ahead, axis=0)[-1] == pytest.approx(0.436 / recording.rate_hz, rel=1e-3)
    # Later by the dead time and the lag, from the same opening of the valve at the beginning.
    assert ahead[-1][0] > ahead[-1][1]
