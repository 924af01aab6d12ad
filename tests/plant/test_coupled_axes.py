"""Axes that share a pump and hang on each other's weight: free runs of the whole machine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from plant_data import LOADS, arm_inputs, loaded_arm, measured, nominal
from weight import slopes

from sysid.datasets.recording import Recording
from sysid.machine import KnownEffect, Machine
from sysid.plant import compile_plant, free_run

Array = npt.NDArray[np.float64]
RATE = 100.0
GAINS = {"slew": 0.436, "boom": 0.025}


def commanded(slew: Array, boom: Array, wrist: Array | float = 0.0) -> Recording:
    """Commands, and where the machine stands at first."""
    first = np.where(np.arange(len(slew)) < 20, 1.0, np.nan)
    table = {"time": np.arange(len(slew)) / RATE, "slew.command": slew, "boom.command": boom, "wrist.command": wrist}
    table |= {"slew.joint": 0.0 * first, "boom.cylinder": 0.06 * first}
    return Recording("made", pd.DataFrame(table), RATE)


def speeds(run: pd.DataFrame) -> dict[str, Array]:
    """Speed of slew and boom in shares of full speed, (n − 1,)."""
    return {
        "slew": np.diff(run["slew.joint"]) * RATE / GAINS["slew"],
        "boom": np.diff(run["boom.cylinder"]) * RATE / GAINS["boom"],
    }


# -- pump -----------------------------------------------------------------------------------------------------------


def test_all_axes_slow_down_by_one_factor() -> None:
    count = 300
    slew, boom = np.zeros(count), np.zeros(count)
    slew[50:250], boom[100:200] = 0.9, -0.5
    plant = nominal(KnownEffect("pump_flow_limit", "machine", {"limit": 1.0}))
    run = speeds(free_run(plant, commanded(slew, boom)))
    assert run["slew"][60] == pytest.approx(0.9), "alone it has enough"
    assert run["slew"][150] == pytest.approx(0.9 / 1.4)
    assert run["boom"][150] == pytest.approx(-0.5 / 1.4)
    assert run["slew"][220] == pytest.approx(0.9)


def test_what_comes_before_the_pump_counts_and_a_position_axis_does_not() -> None:
    """The demand is that of the axes' own speeds, behind dead-band and gain; the wrist is no customer of the pump."""
    count = 200
    effects = (
        KnownEffect("pump_flow_limit", "machine", {"limit": 0.8}),
        KnownEffect("valve_deadband", "slew", {"positive": 0.2, "negative": 0.2}),
        KnownEffect("gain_error", "boom", {"ratio": 1.5}),
    )
    wrist = 0.5 * np.sin(np.arange(count) / 10.0)
    made = commanded(np.full(count, 0.8), np.full(count, -0.4), wrist)
    run = free_run(nominal(*effects), made)
    demand = 0.6 + 0.6
    assert speeds(run)["slew"][100] == pytest.approx(0.6 * 0.8 / demand)
    assert speeds(run)["boom"][100] == pytest.approx(-0.6 * 0.8 / demand)
    assert np.allclose(run["wrist.joint"][1:], wrist[:-1], atol=1e-12)


def test_an_axis_at_its_end_stop_still_takes_its_part() -> None:
    """Its relief valve is open: the oil is gone."""
    count = 1200
    plant = nominal(KnownEffect("pump_flow_limit", "machine", {"limit": 1.0}))
    run = free_run(plant, commanded(np.full(count, 0.2), np.ones(count)))
    assert run["boom.cylinder"].iloc[-1] == pytest.approx(0.12)
    assert speeds(run)["boom"][-1] == 0.0
    assert speeds(run)["slew"][-1] == pytest.approx(0.2 / 1.2)


# -- weight ---------------------------------------------------------------------------------------------------------


def moments(machine: Machine, run: pd.DataFrame, rows: Array) -> Array:
    """Gravity moment about the boom at the simulated joints, by the slope of the energy."""
    (urdf,) = (text for name, text in machine.files().items() if name.endswith(".urdf"))
    found = []
    for k in rows:
        joints = {f"{axis}_joint": float(run[f"{axis}.joint"].iloc[k]) for axis in ("slew", "boom", "wrist")}
        found.append(slopes(urdf, joints, "tip")[1])
    return np.array(found)


@pytest.mark.parametrize("coefficient", [0.008, -0.004])
def test_flow_follows_the_load_of_the_simulated_joints(coefficient: float) -> None:
    """Only the first 0.2 s are measured; while the arm is raised and the wrist turns, the boom's speed follows its load."""
    count = 600
    boom = 0.7 * np.sign(np.sin(2 * np.pi * np.arange(count) / 300.0))
    wrist = 1.5 * np.sin(2 * np.pi * np.arange(count) / 450.0)
    machine = loaded_arm()
    plant = nominal(KnownEffect("load_dependent_flow", "boom", {"coefficient": coefficient}), machine=machine)
    run = free_run(plant, commanded(np.full(count, 0.1), boom, wrist))
    rows = np.arange(30, count - 1, 23)
    load = moments(machine, run, rows)
    assert np.ptp(load) > 10.0
    u = boom[rows]
    expected = u * (1.0 - coefficient * load * np.sign(u))
    np.testing.assert_allclose(speeds(run)["boom"][rows], expected, rtol=1e-5)


def test_sag_follows_the_load_of_the_simulated_joints() -> None:
    """One sample late: the load is that of the pose before."""
    machine, compliance, count = loaded_arm(), 4e-4, 300
    made = commanded(np.zeros(count), 0.4 * np.sin(np.arange(count) / 20.0), np.linspace(0.0, 1.5, count))
    soft = KnownEffect("joint_compliance", "boom", {"compliance": compliance}, "drive")
    stiff_run, run = (free_run(nominal(*effects, machine=machine), made) for effects in ((), (soft,)))
    rows = np.arange(10, count, 17)
    sag = (stiff_run["boom.joint"] - run["boom.joint"]).to_numpy()[rows]
    load = moments(machine, run, rows)
    assert np.ptp(load) > 3.0
    np.testing.assert_allclose(sag, compliance * load, rtol=0.01)


def test_the_weight_of_one_axis_slows_another() -> None:
    """The wrist alone changes the boom's load: two free runs that differ in its command differ in the boom."""
    count = 200
    effect = KnownEffect("load_dependent_flow", "boom", {"coefficient": 0.01})
    plant = nominal(effect, machine=loaded_arm())
    runs = [free_run(plant, commanded(np.zeros(count), np.full(count, 0.3), wrist)) for wrist in (0.0, 2.0)]
    stretched, folded = (run["boom.cylinder"].iloc[-1] for run in runs)
    assert folded > stretched + 1e-4


# -- stage by stage and all at once ---------------------------------------------------------------------------------

COUPLED = {
    "load": (KnownEffect("load_dependent_flow", "boom", {"coefficient": 0.01}),),
    "pump": (KnownEffect("pump_flow_limit", "machine", {"limit": 0.8}),),
    "sag": (
        KnownEffect("joint_compliance", "boom", {"compliance": 3e-4}, "drive"),
        KnownEffect("joint_compliance", "wrist", {"compliance": 3e-4}, "structure"),
    ),
    "all": (
        KnownEffect("load_dependent_flow", "boom", {"coefficient": 0.01}),
        KnownEffect("pump_flow_limit", "machine", {"limit": 0.8}),
        KnownEffect("joint_compliance", "boom", {"compliance": 3e-4}, "drive"),
        KnownEffect("oil_compressibility", "boom", {"frequency": 6.0, "damping_ratio": 0.1}),
        KnownEffect("temperature_drift", "slew", {"fraction": 0.2, "time_constant": 10.0}),
        KnownEffect("first_order_lag", "boom", {"time_constant": 0.05}),
        KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.02}),
        KnownEffect("sensor_bias", "ee.z", {"bias": 0.01}),
        KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.05}),
    ),
}


@pytest.mark.parametrize("name", COUPLED)
def test_stages_and_free_run_agree_on_data_of_the_plant_itself(name: str) -> None:
    """Every stage driven by its recorded input gives what the free run gave; the load is a sample late in one of them."""
    plant = nominal(*COUPLED[name], machine=loaded_arm())
    recording = measured(plant, arm_inputs("run", 20.0, 5), 0, noise=0.0)
    model = compile_plant(plant)
    theta = model.theta[None]
    tip, tool = model.tip(theta, recording)[0], model.tool(theta, recording)[0]
    stages = {
        "slew.joint": model.drive(theta, recording, "slew")[0],
        "boom.cylinder": model.drive(theta, recording, "boom")[0],
        "wrist.joint": model.drive(theta, recording, "wrist")[0],
        "boom.joint": model.joint(theta, recording, "boom")[0],
        **{f"ee.{c}": tip[:, k] for k, c in enumerate("xyz")},
        **{f"tool.{c}": tool[:, k] for k, c in enumerate("xyz")},
    }
    run = free_run(model, recording)
    for signal, values in stages.items():
        error = np.sqrt(np.mean((values - run[signal]) ** 2))
        assert error < 2e-4 * np.ptp(run[signal]), signal
    without = free_run(nominal(machine=loaded_arm()), recording)
    apart = max(np.abs(run[s] - without[s]).max() / np.ptp(run[s]) for s in stages)
    assert apart > 5e-3, "the effects matter"


def test_measured_loads_are_not_asked_for_in_a_free_run() -> None:
    """What the joint sensors say later on changes nothing."""
    plant = nominal(*LOADS, machine=loaded_arm())
    recording = measured(plant, arm_inputs("run", 8.0, 6), 0, noise=0.0)
    wrong = recording.table.copy()
    for signal in ("boom.joint", "wrist.joint"):
        wrong.loc[100:, signal] += 0.5
    one, other = free_run(plant, recording), free_run(plant, replace(recording, table=wrong))
    assert np.array_equal(one["boom.cylinder"], other["boom.cylinder"])


def test_lanes_share_a_demand_and_keep_their_own_limits() -> None:
    """Parameter vectors with one limit, another, none, and another gain, side by side, are what each is alone."""
    variants = [(0.6, 1.0), (0.9, 1.0), (None, 1.0), (0.6, 1.4)]
    plants = [
        nominal(
            *((KnownEffect("pump_flow_limit", "machine", {"limit": limit}),) if limit is not None else ()),
            KnownEffect("gain_error", "boom", {"ratio": ratio}),
        )
        for limit, ratio in variants
    ]
    model, thetas = compile_plant(plants[0]), np.array([plant.vector() for plant in plants])
    made = commanded(0.8 * np.sin(np.arange(300) / 20.0), np.full(300, -0.7))
    together = model.share(thetas, made)
    assert together == pytest.approx(np.concatenate([model.share(theta[None], made) for theta in thetas]))
    assert together[2] == pytest.approx(1.0)
    assert together[0].min() < together[1].min() < 1.0
    assert together[3].min() < together[0].min()
