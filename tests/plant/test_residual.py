"""``unnamed_residual`` in a plant: bounded, the same in steps as in one run, kept whole by files, or refused."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_data import LOADS, arm_inputs, loaded_arm, measured, nominal, slide, slide_inputs

from sysid.errors import SettingsError, StoreError
from sysid.machine import Machine
from sysid.networks.cell import REACH, state_size
from sysid.plant import Plant, compile_plant, free_run, plant_from_files
from sysid.plant.force import force_inputs
from sysid.plant.residual import STATES, Residual, ResidualStage, input_names, new_memory, residual_arrays, update
from sysid.plant.stepper import Stepper, held_commands, step_commands

Array = npt.NDArray[np.float64]
ARM = loaded_arm()
BARE = nominal(*LOADS, machine=ARM)


def network(
    machine: Machine, stage: ResidualStage, target: str, bound: float, interval: float = 0.05, seed: int = 0
) -> Residual:
    """Random weights: it says something all the time."""
    rng, units = np.random.default_rng([seed, len(target)]), 8
    count, axes = len(input_names(machine, target)), len(machine.axis_names)
    scale = np.array([1.0] * axes + [20.0, 30.0, 0.02, 1.0, 1.0])
    if stage != "command":
        scale[:axes] = 0.0
    if stage == "force":
        scale[axes + 2] = 0.0
    gates = rng.normal(0.0, 0.7, (4 * units, count)), rng.normal(0.0, 0.5, (4 * units, units)), rng.normal(0.0, 0.3, 4 * units)
    head = rng.normal(0.0, 1.0, units), rng.normal(0.0, 0.3, 1)
    return Residual(stage, target, bound, interval, np.zeros(count), scale, *gates, *head, {"dataset": "arm@1"}, 0.03)


CARRYING = (
    BARE.with_residual(network(ARM, "command", "slew", 0.1))
    .with_residual(network(ARM, "command", "boom", 0.1))
    .with_residual(network(ARM, "command", "wrist", 0.01))
    .with_residual(network(ARM, "joint", "boom", 0.01))
)


def test_steps_and_one_run_are_the_same() -> None:
    recording = measured(CARRYING, arm_inputs("run", 20.0, 1), 1)
    run, plain = free_run(CARRYING, recording), free_run(BARE, recording)
    stepper, commands = Stepper(CARRYING, 100.0, 2), step_commands(ARM, held_commands(ARM, recording))
    states = [stepper.begin(recording, 0), *(stepper.step(commands[k]) for k in range(len(recording) - 1))]
    for i, axis in enumerate(ARM.axis_names):
        joint = run[f"{axis}.joint"].to_numpy()
        assert np.array_equal(np.array([state.joints[1, i] for state in states]), joint)
        assert np.abs(joint - plain[f"{axis}.joint"].to_numpy()).max() > 1e-3, "it does something"
    tips = np.array([state.ee[0] for state in states])
    assert np.array_equal(tips, run[["ee.x", "ee.y", "ee.z"]].to_numpy())


def test_lanes_begin_anew_each_for_itself() -> None:
    stepper, one = Stepper(CARRYING, 100.0, 2), Stepper(CARRYING, 100.0)
    start, command = np.array([0.1, 0.5, 0.2]), np.array([0.6, -0.4, 0.3])
    stepper.reset(start)
    for _ in range(60):
        stepper.step(command)
    stepper.reset(start, which=[1])
    one.reset(start)
    for _ in range(40):
        both, alone = stepper.step(command), one.step(command)
        assert np.array_equal(both.joints[1], alone.joints[0])
        assert not np.array_equal(both.joints[0], alone.joints[0])


def test_stages_are_those_of_the_whole_chain() -> None:
    recording = measured(CARRYING, arm_inputs("run", 20.0, 2), 2)
    model = compile_plant(CARRYING)
    for axis in ARM.axes:
        runs = [m.drive(m.theta[None], recording, axis.name)[0] for m in (model, compile_plant(BARE))]
        error, plain = (float(np.sqrt(np.mean((run - recording.values(axis.driven)) ** 2))) for run in runs)
        noise = ARM.noise[axis.driven]
        assert error < 3.0 * noise, f"{axis.name}: the load that it looks at is one at measured joints here"
        assert plain > 10.0 * error, axis.name
    joint = model.joint(model.theta[None], recording, "boom")[0]
    assert np.sqrt(np.mean((joint - recording.values("boom.joint")) ** 2)) < 2.0 * ARM.noise["boom.joint"]


def test_force_of_a_motion_and_motion_of_a_force_agree() -> None:
    machine = slide()
    truth = nominal(machine=machine).with_residual(network(machine, "force", "slide", 8.0, 0.02))
    recording = measured(truth, slide_inputs("run", 6.0, 1), 1)
    left = []
    for plant in (truth, nominal(machine=machine)):
        model, inputs = compile_plant(plant), force_inputs(recording, machine.axes[0])
        left.append(np.sqrt(np.mean((inputs.force - inputs.model_force(model, model.theta[None], "slide")[0]) ** 2)))
    assert left[0] < 0.03 * left[1]
    assert left[1] > 1.0


finite = st.floats(-1e6, 1e6)


@settings(max_examples=60)
@given(st.integers(0, 9), st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=30))
def test_it_never_says_more_than_its_bound(seed: int, seen: list[tuple[float, float, float]]) -> None:
    nets = residual_arrays(ARM, [network(ARM, "command", "boom", 0.2, seed=seed)])
    assert nets is not None
    memory = new_memory(nets)[0]
    for command, position, load in seen:
        said = update(nets, 0, memory, np.full(3, command), position, load, 0.05)
        assert abs(said) <= 0.2


def test_it_is_an_lstm_behind_a_bound() -> None:
    """The compiled steps against torch, looking every fifth sample and holding what it said in between."""
    import torch

    item = network(ARM, "command", "boom", 0.2)
    nets = residual_arrays(ARM, [item])
    assert nets is not None
    memory, rng = new_memory(nets)[0], np.random.default_rng(0)
    samples = 101
    commands, position, load = (
        rng.uniform(-1, 1, (samples, 3)),
        np.cumsum(rng.normal(0, 1e-3, samples)),
        rng.normal(30, 5, samples),
    )
    said = np.array([update(nets, 0, memory, commands[k], position[k], load[k], 0.01) for k in range(samples)])
    at = np.arange(0, samples, 5)
    speed = np.concatenate([[0.0], np.diff(position[at]) / 0.05])
    turn = 2.0 * np.pi * position[at] / item.period
    x = np.column_stack([commands[at], position[at], speed, load[at], np.sin(turn), np.cos(turn)])
    x = np.clip((x - item.mean) * item.scale, -REACH, REACH)
    cell = torch.nn.LSTM(x.shape[1], item.units, dtype=torch.float64)
    with torch.no_grad():
        for parameter, values in zip(cell.parameters(), (item.W, item.U, item.b, 0.0 * item.b), strict=True):
            parameter.copy_(torch.from_numpy(values))
        h = cell(torch.from_numpy(x))[0].numpy()
    expected = 0.2 * np.tanh(h @ item.w + item.w0)
    assert np.allclose(said[at], expected, atol=1e-12)
    assert all(len(set(said[k : k + 5])) == 1 for k in at[:-1])
    assert STATES + state_size(len(item.mean), item.units) == len(memory)


def test_a_rest_stays_a_rest() -> None:
    """What it adds to a speed is a share of that speed."""
    stepper = Stepper(BARE.with_residual(network(ARM, "command", "boom", 0.5)), 100.0)
    first = stepper.reset([0.0, 0.5, 0.0])
    for _ in range(200):
        last = stepper.step(np.zeros(3))
    assert np.array_equal(last.drive, first.drive)


def test_files_keep_it_whole() -> None:
    files = CARRYING.to_files()
    assert set(files) == {"plant.json", "linkages.safetensors", "residuals.safetensors"}
    again = plant_from_files(files, "arm@7")
    assert [item.to_json() for item in again.residuals] == [item.to_json() for item in CARRYING.residuals]
    assert again.to_files() == files
    recording = arm_inputs("run", 5.0, 3)
    assert free_run(again, recording).equals(free_run(CARRYING, recording))
    content = json.loads(files["plant.json"])
    assert content["schema"] == 2
    assert {entry["name"] for entry in content["residuals"]} == {"unnamed_residual"}
    assert "unnamed_residual" not in {effect["name"] for effect in content["effects"]}
    assert json.loads(BARE.to_files()["plant.json"])["schema"] == 1, "plants without one are stored as before"


@pytest.mark.parametrize("damage", ["gone", "cut", "shape"])
def test_damaged_weights_are_refused(damage: str) -> None:
    files = dict(CARRYING.to_files())
    weights = files.pop("residuals.safetensors")
    if damage == "cut":
        files["residuals.safetensors"] = weights[: len(weights) // 2]
    if damage == "shape":
        other = replace(CARRYING, residuals=tuple(replace(r, W=r.W[:, :-1]) for r in CARRYING.residuals[:0]))
        files["residuals.safetensors"] = other.with_residual(network(ARM, "command", "slew", 0.1)).to_files()[
            "residuals.safetensors"
        ]
    with pytest.raises(StoreError, match=r"arm@7.*no weights of unnamed_residual"):
        plant_from_files(files, "arm@7")


def test_a_schema_from_the_future_is_refused() -> None:
    files = dict(BARE.to_files())
    files["plant.json"] = files["plant.json"].replace(b'"schema": 1', b'"schema": 9')
    with pytest.raises(StoreError, match="schema 9; expected schema 1 to 3"):
        plant_from_files(files)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stage": "end_effector"}, "stage 'end_effector'; expected one of command, joint, force"),
        ({"stage": "force"}, "stage 'force' of a velocity-actuated cylinder; expected a force axis"),
        (
            {"stage": "joint", "target": "slew"},
            "stage 'joint' of a velocity-actuated joint; expected a cylinder with a linkage",
        ),
        ({"target": "stick"}, "'stick'"),
        ({"bound": 0.0}, "bound = 0.0; expected a positive number"),
        ({"bound": float("inf")}, "bound = inf"),
        ({"w": np.full(8, np.nan)}, r"w of shape \(8,\); expected finite numbers of shape \(8,\)"),
        ({"W": np.zeros((32, 3))}, r"W of shape \(32, 3\); expected finite numbers of shape \(32, 8\)"),
        ({"period": -1.0}, "period = -1.0"),
    ],
)
def test_what_is_no_network_of_this_machine_is_refused(change: Mapping[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        BARE.with_residual(replace(network(ARM, "command", "boom", 0.1), **change))  # type: ignore[arg-type]


def test_a_slower_rate_than_it_learned_at_is_refused() -> None:
    with pytest.raises(
        SettingsError, match=r"unnamed_residual on slew \(command stage\): steps of 0.1 s; expected at most 0.05 s"
    ):
        Stepper(CARRYING, 10.0)
    slow = arm_inputs("run", 5.0, 1)
    slow = replace(
        slow, table=slow.table.iloc[::10].assign(time=slow.table["time"].iloc[::10]).reset_index(drop=True), rate_hz=10.0
    )
    with pytest.raises(SettingsError, match=r"steps of 0\.1 s"):
        free_run(CARRYING, slow)


def test_one_stage_carries_one() -> None:
    other = network(ARM, "command", "boom", 0.3, seed=5)
    plant = CARRYING.with_residual(other)
    assert len(plant.residuals) == len(CARRYING.residuals)
    assert other in plant.residuals
    bare: Plant = plant
    for stage, target in [item.key for item in plant.residuals]:
        bare = bare.without_residual(stage, target)
    assert bare.residuals == ()
    assert bare.to_files() == BARE.to_files()
    assert BARE.without_residual("command", "boom") is BARE


def test_the_world_runs_it() -> None:
    """Without masses, since bodies in the world need inertias as well."""
    from plant_data import arm

    from sysid.world import World

    machine = arm()
    plant = nominal(machine=machine).with_residual(network(machine, "command", "boom", 0.3))
    plant = plant.with_residual(network(machine, "joint", "boom", 0.01))
    recording = arm_inputs("run", 3.0, 1)
    with World(plant) as world:
        there = world.rollout(recording)
    run, plain = free_run(plant, recording), free_run(nominal(machine=machine), recording)
    assert np.abs(run["boom.joint"] - plain["boom.joint"]).max() > 1e-3
    for signal in ("boom.cylinder", "boom.joint", "ee.z"):
        assert np.abs(there[signal] - run[signal]).max() < 1e-6, signal
