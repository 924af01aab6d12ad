"""Free runs: starts, gaps, end stops, friction at rest, lanes, kinematics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_data import arm, arm_inputs, dataset_of, nominal, slide
from scipy.integrate import solve_ivp

from sysid.datasets.recording import Recording
from sysid.machine import KnownEffect
from sysid.plant import compile_plant, free_run, nominal_plant
from sysid.plant.model import SERIAL
from sysid.plant.stretches import held
from sysid.testing import probe_machine

Array = npt.NDArray[np.float64]


def recording(rate_hz: float = 100.0, **columns: Array | float) -> Recording:
    """A recording from arrays by signal, ``slew_command`` for ``slew.command``."""
    count = max(len(v) for v in columns.values() if isinstance(v, np.ndarray))
    table = {"time": np.arange(count) / rate_hz}
    table |= {name.replace("_", "."): np.broadcast_to(np.asarray(v, dtype=float), count) for name, v in columns.items()}
    return Recording("made", pd.DataFrame(table), rate_hz)


def drive(made: Recording, axis: str, *effects: KnownEffect) -> Array:
    """What the command drives, as its sensor reads it, (n,)."""
    model = compile_plant(nominal(*effects, machine=slide() if axis == "slide" else arm()))
    return model.drive(model.theta[None], made, axis)[0]


def test_a_run_in_blocks_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks that end inside of stretches, with them, and in gaps; both axes of the arm have gaps of their own."""
    rng = np.random.default_rng(1)
    commands = {f"{axis}_command": 0.3 * np.repeat(rng.standard_normal(30), 20) for axis in ("slew", "boom")}
    for values, gaps in zip(commands.values(), ((100, 200, 450), (90, 300)), strict=True):
        for first in gaps:
            values[first : first + 37] = np.nan
    inputs = recording(**commands, slew_joint=np.full(600, 0.2), boom_cylinder=np.full(600, 0.4))
    model, runs = compile_plant(nominal(machine=arm())), []
    for piece in (2**16, 100, 63):
        monkeypatch.setattr("sysid.scratch.PIECE", piece)
        runs.append(free_run(model, replace(inputs)))
    assert runs[0]["slew.joint"].isna().any()
    assert runs[0]["slew.joint"].nunique() > 100
    for other in runs[1:]:
        pd.testing.assert_frame_equal(runs[0], other, check_exact=True)


# -- start ----------------------------------------------------------------------------------------------------------


def test_start_is_where_the_axis_rests_in_the_first_half_second() -> None:
    measured = np.full(300, np.nan)
    measured[:50] = 0.4
    measured[[3, 8]] = 9.0  # spikes do not count
    made = recording(slew_command=np.zeros(300), slew_joint=measured)
    assert np.allclose(drive(made, "slew"), 0.4)


def test_start_while_moving_looks_through_the_motion() -> None:
    """The axis has moved by 0.044 rad when the window ends: the start is not the median of the signal itself."""
    time = np.arange(300) / 100.0
    made = recording(slew_command=np.full(300, 0.5), slew_joint=0.3 + 0.5 * 0.436 * time)
    assert np.allclose(drive(made, "slew"), made.values("slew.joint"), atol=1e-12)


@pytest.mark.parametrize("side", [-1.0, 0.0, 1.0])
def test_play_starts_on_the_side_where_the_machine_stood(side: float) -> None:
    width = 0.02
    command = np.zeros(600)
    command[100:200], command[300:400] = 0.2, -0.2
    place = 0.5 + np.concatenate([[0.0], np.cumsum(0.436 * command / 100.0)[:-1]])
    follower, values = 0.5 - side * width / 2, []
    for x in place:
        follower = min(max(follower, x - width / 2), x + width / 2)
        values.append(follower)
    out = drive(
        recording(slew_command=command, slew_joint=np.array(values)), "slew", KnownEffect("backlash", "slew", {"width": width})
    )
    # The side is found by a parabola through three tries.
    assert np.abs(out - values).max() < 0.01 * width


def test_start_of_an_unmeasured_axis_is_inside_its_range() -> None:
    made = recording(boom_command=np.zeros(50))
    assert np.allclose(drive(made, "boom"), 0.0)


# -- gaps -----------------------------------------------------------------------------------------------------------


def test_short_gaps_in_the_command_are_held_and_long_ones_restart_the_run() -> None:
    count = 400
    command = np.full(count, 0.4)
    command[50:58] = np.nan  # 0.08 s: held
    command[150:200] = np.nan  # held for 0.1 s, then nothing is known
    moved = 0.4 * 0.436 / 100 * np.arange(count)
    measured = np.where(np.arange(count) < 200, 0.1 + moved, 0.9 + moved - moved[200])
    out = drive(recording(slew_command=command, slew_joint=measured), "slew")
    assert np.isfinite(out[:160]).all()
    assert np.isnan(out[161:200]).all()
    assert out[149] - out[0] == pytest.approx(149 * 0.4 * 0.436 / 100)
    assert out[0] == pytest.approx(0.1)
    assert out[200] == pytest.approx(0.9)


@given(st.lists(st.booleans(), min_size=1, max_size=80))
def test_held_commands(there: list[bool]) -> None:
    command = np.where(there, np.arange(1.0, len(there) + 1), np.nan)
    filled, segments = held(command, 100.0)
    covered = np.zeros(len(there), dtype=bool)
    for first, last in segments:
        assert first < last
        assert there[first], "a run starts where there is a command"
        covered[first:last] = True
    assert (covered | ~np.array(there)).all()
    for k in np.flatnonzero(covered):
        known = max(i for i in range(k + 1) if there[i])
        assert filled[k] == command[known]
        assert k - known <= 10


# -- end stops ------------------------------------------------------------------------------------------------------


def test_end_stops_hold_and_let_go() -> None:
    command = np.concatenate([np.full(400, 1.0), np.zeros(100), np.full(600, -1.0), np.zeros(100), np.full(100, 1.0)])
    out = drive(recording(boom_command=command, boom_cylinder=0.06), "boom")
    assert out.max() == pytest.approx(0.12)
    assert out.min() == pytest.approx(0.0)
    assert out[505] < 0.12, "it moves back at once"
    assert out[-1] > 0.02


def test_a_slide_that_meets_its_end_stops() -> None:
    """It stops dead and leaves with the force that pulls it back, not with the speed it came with."""
    force = np.concatenate([np.full(3000, 40.0), np.full(1500, -40.0)])
    made = recording(500.0, slide_command=force, slide_joint=np.where(np.arange(4500) < 20, 98.0, np.nan))
    out = drive(made, "slide")
    assert out.max() == 100.0
    back = np.flatnonzero(out < 100.0)
    back = back[back > 3000]
    assert abs(back[0] - 3001) <= 1
    assert out[3500] == pytest.approx(100.0 - 0.5 * 2.0 * 1.0**2, abs=0.01)


# -- friction at rest -----------------------------------------------------------------------------------------------


def test_friction_holds_without_chattering() -> None:
    force = 9.9 * np.sin(np.arange(2000) / 50.0)
    made = recording(500.0, slide_command=force, slide_joint=np.where(np.arange(2000) < 100, 0.25, np.nan))
    out = drive(made, "slide", KnownEffect("coulomb_friction", "slide", {"force": 10.0}))
    assert (np.diff(out) == 0.0).all()


@pytest.mark.parametrize("rate_hz", [500.0, 4000.0])
def test_friction_against_a_stiff_solver(rate_hz: float) -> None:
    """Stops and starts under a slow force; Coulomb friction regularised over 1 µm/s there. First order in the step."""

    def force(t: Array | float) -> Array:
        return np.asarray(30.0 * np.sin(2.0 * np.asarray(t)))

    def rates(t: float, state: Array) -> list[float]:
        friction = (12.0 if state[1] > 0 else 8.0) * np.tanh(state[1] / 1e-6) + 15.0 * state[1]
        return [state[1], (float(force(t)) - friction - 2.0) / 20.0]

    time = np.arange(round(8.0 * rate_hz)) / rate_hz
    solved = solve_ivp(rates, (0.0, 8.0), [0.0, 0.0], method="Radau", t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.01)
    start = np.where(np.arange(len(time)) < 3, 0.0, np.nan)
    out = drive(
        recording(rate_hz, slide_command=force(time + 0.5 / rate_hz), slide_joint=start),
        "slide",
        KnownEffect("coulomb_friction", "slide", {"positive": 12.0, "negative": 8.0}),
        KnownEffect("viscous_friction", "slide", {"coefficient": 15.0}),
        KnownEffect("load_bias", "slide", {"force": 2.0}),
    )
    travel = np.ptp(solved.y[0])
    assert np.abs(out - solved.y[0]).max() < 10.0 / rate_hz * travel
    rests = np.abs(solved.y[1]) < 1e-6
    assert rests.sum() > 0.02 * len(time), "the test has to stick"
    assert np.mean(np.diff(out)[rests[1:] & rests[:-1]] == 0.0) > 0.9


def test_a_film_of_oil_against_a_stiff_solver() -> None:
    """Stribeck friction, stick and slip: the error falls with the step, and a stick is a stick."""
    static, dynamic, film = 14.0, 8.0, 0.04

    def force(t: Array | float) -> Array:
        return np.asarray(26.0 * np.sin(2.0 * np.asarray(t)))

    def rates(t: float, state: Array) -> list[float]:
        v = state[1]
        dry = dynamic + (static - dynamic) * np.exp(-((v / film) ** 2))
        return [v, (float(force(t)) - dry * np.tanh(v / 1e-6) - 15.0 * v) / 20.0]

    grid = np.arange(800) / 100.0
    solved = solve_ivp(rates, (0.0, 8.0), [0.0, 0.0], method="Radau", t_eval=grid, rtol=1e-8, atol=1e-10, max_step=0.01)
    errors = []
    for rate_hz in (500.0, 4000.0):
        time = np.arange(round(8.0 * rate_hz)) / rate_hz
        out = drive(
            recording(
                rate_hz, slide_command=force(time + 0.5 / rate_hz), slide_joint=np.where(time < 2.5 / rate_hz, 0.0, np.nan)
            ),
            "slide",
            KnownEffect(
                "stribeck_friction", "slide", {"static_force": static, "coulomb_force": dynamic, "stribeck_velocity": film}
            ),
            KnownEffect("viscous_friction", "slide", {"coefficient": 15.0}),
        )
        errors.append(np.abs(out[:: round(rate_hz / 100.0)] - solved.y[0]).max() / np.ptp(solved.y[0]))
        rests = np.abs(np.interp(time, grid, solved.y[1])) < 1e-6
        assert rests.mean() > 0.02, "the test has to stick"
        assert np.mean(np.diff(out)[rests[1:] & rests[:-1]] == 0.0) > 0.9
    assert errors[0] < 0.02
    assert errors[1] < 0.3 * errors[0]


# -- lanes, joints, tip ---------------------------------------------------------------------------------------------


def test_lanes_equal_single_runs() -> None:
    model = compile_plant(nominal())
    made = arm_inputs("run", 30.0, 1)
    thetas = np.stack(
        [nominal(KnownEffect("gain_error", "slew", {"ratio": ratio})).vector() for ratio in np.linspace(0.5, 1.5, 12)]
    )
    assert len(thetas) * len(made) > SERIAL, "so that the lanes run in parallel"
    together = model.drive(thetas, made, "slew")
    for k in range(len(thetas)):
        assert np.array_equal(together[k], model.drive(thetas[k : k + 1], made, "slew")[0])


@settings(deadline=None)  # the first call compiles
@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 4), min_size=1, max_size=20))
def test_tip_is_the_kinematics_of_the_machine(poses: list[tuple[float, ...]]) -> None:
    machine = probe_machine()
    kinematics = machine.kinematics()
    assert kinematics is not None
    model = compile_plant(nominal_plant(machine))
    joints = np.array(poses)
    made = recording(**{f"{name}_joint": joints[:, i] for i, name in enumerate(machine.axis_names)})
    assert np.allclose(model.tip(model.theta[None], made)[0], kinematics.tip_position(joints), atol=1e-12)


def test_a_missing_joint_leaves_the_tip_out() -> None:
    model = compile_plant(nominal())
    made = recording(slew_joint=np.zeros(3), boom_joint=np.zeros(3), wrist_joint=np.array([0.0, np.nan, 0.0]))
    assert np.isnan(model.tip(model.theta[None], made)[0]).all(axis=1).tolist() == [False, True, False]


def test_free_run_has_every_signal_and_no_noise() -> None:
    plant = nominal(KnownEffect("gripper_sway", "tool", {"length": 0.2, "damping_ratio": 0.05}))
    dataset = dataset_of(plant, 8.0)
    one = dataset.recordings[0]
    run = free_run(plant, one)
    assert {str(c) for c in run.columns} == {*one.signals, "time"} - {s for s in one.signals if s.endswith(".command")}
    for signal in run.columns[1:]:
        error = one.values(str(signal)) - run[signal].to_numpy()
        assert np.sqrt(np.mean(error**2)) < 1.5 * max(dataset.machine.noise[str(signal)], 3e-4), signal


def test_tool_hangs_below_the_tip_where_it_does_not_swing() -> None:
    plant = nominal()
    run = free_run(plant, arm_inputs("run", 2.0, 0))
    assert np.array_equal(run["tool.z"], run["ee.z"])


def test_a_recording_without_commands_predicts_nothing() -> None:
    run = free_run(nominal(), replace(arm_inputs("run", 2.0, 0), table=pd.DataFrame({"time": np.arange(200) / 100.0})))
    assert run.drop(columns="time").isna().all().all()


def test_behind_a_lag_a_release_of_nothing_comes_as_well() -> None:
    """What is asked for fades and never gets to zero; after three seconds the axis stands, and sticks."""
    time = np.arange(800) / 100.0
    command = np.where(time < 1.0, 0.5, np.where(time < 4.0, 0.0, 0.05))
    start = np.where(time < 0.005, 1.0, np.nan)
    table = {"time": time, "slew.command": command, "boom.command": 0.0, "wrist.command": 0.0}
    table |= {"slew.joint": 0.0 * start, "boom.cylinder": 0.06 * start}
    lag = KnownEffect("first_order_lag", "slew", {"time_constant": 0.1})
    sticks = KnownEffect("stiction", "slew", {"breakaway": 0.1, "release": 0.0})
    run = free_run(compile_plant(nominal(lag, sticks)), Recording("run", pd.DataFrame(table), 100.0))
    place = run["slew.joint"].to_numpy()
    assert place[150] > 0.1
    assert place[-1] == place[395]
