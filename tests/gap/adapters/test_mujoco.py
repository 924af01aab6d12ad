"""A MuJoCo model under test: its runs, what is missing in it, and the repaired file."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from mjcf_logs import NOISE, commands_for, dataset_of_runs, machine_of, run_model
from robots import robot

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import InputError, SettingsError
from sysid.gap import find_gap
from sysid.gap.adapters.mujoco import native
from sysid.gap.adapters.mujoco.repair import (
    RepairedModel,
    open_mujoco,
    read_side_file,
    repaired_effects,
    side_file,
    write_repaired,
)
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.adapters.simulator import joint_start
from sysid.gap.disagreement import run_rmse
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import KnownEffect, Machine

Array = npt.NDArray[np.float64]


def with_start(machine: Machine, commands: pd.DataFrame, start: float = 0.1) -> Recording:
    """A recording of commands, of which only the starting position is measured: that of a servo is its first command."""
    at = {axis.name: commands[f"{axis.name}.command"][0] if axis.follows_positions else start for axis in machine.axes}
    joints = {f"{axis}.joint": np.full(len(commands), value) for axis, value in at.items()}
    return Recording("run", commands.assign(**joints), machine.rate_hz)


@pytest.mark.parametrize("name", ["joint", "servo_arm", "velocity_crane"])
def test_runs_are_those_of_the_model(name: str) -> None:
    machine = machine_of(name)
    recording = with_start(machine, commands_for(machine, 1, 3.0))
    simulator = MujocoSimulator(robot(name), machine, threads=2)
    full = {axis.name: axis.gain if axis.actuation == "velocity" else 1.0 for axis in machine.axes}

    def controls(commands: pd.DataFrame) -> dict[str, Array]:
        return {axis: gain * commands[f"{axis}.command"].to_numpy() for axis, gain in full.items()}

    model = mujoco.MjModel.from_xml_path(str(robot(name)))
    positions = simulator.start_positions(recording)
    expected = run_model(model, machine, recording.table, controls, positions)
    found = simulator.simulate(recording)
    for signal, values in expected.items():
        np.testing.assert_allclose(found[signal], values, atol=1e-9)
    names = [f"{axis.name}.command" for axis in machine.axes]
    lanes = {signal: np.stack([recording.values(signal)] * 3) for signal in names}
    many = simulator.simulate_many(recording, lanes)
    for signal, values in many.items():
        np.testing.assert_array_equal(values[2], found[signal], err_msg=signal)


def moving(name: str, machine: Machine, first: int, noise: float) -> tuple[Recording, dict[str, Array]]:
    """A recording of a model that begins in motion, at row ``first`` of a longer one, and its joints without noise."""
    commands = commands_for(machine, 4, 6.0)
    for k, axis in enumerate(machine.axes):  # no jumps: servos follow
        commands[f"{axis.name}.command"] = 0.4 * np.sin((2.0 + 0.7 * k) * commands["time"] + 0.3 * k)
    model, scale = mujoco.MjModel.from_xml_path(str(robot(name))), {a.name: a.gain for a in machine.axes}

    def controls(table: pd.DataFrame) -> dict[str, Array]:
        return {axis.name: scale[axis.name] * table[f"{axis.name}.command"].to_numpy() for axis in machine.axes}

    whole = run_model(model, machine, commands, controls, np.zeros(model.nq))
    rng = np.random.default_rng(1)
    noisy = {signal: values + rng.normal(0.0, noise, len(values)) for signal, values in whole.items()}
    table = commands.assign(**noisy)[first:].reset_index(drop=True)
    table["time"] -= table["time"][0]
    return Recording("cut", table, machine.rate_hz), {signal: values[first:] for signal, values in whole.items()}


@pytest.mark.parametrize(("name", "share"), [("servo_arm", 0.02), ("velocity_crane", 0.1)])
def test_a_recording_may_begin_in_motion(name: str, share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = machine_of(name)
    recording, truth = moving(name, machine, round(2.3 * machine.rate_hz), 1e-4)
    signals, half = [f"{axis}.joint" for axis in machine.axis_names], len(recording) // 2

    def errors() -> Array:
        found = MujocoSimulator(robot(name), machine).simulate(recording)
        return np.array([np.sqrt(np.mean((found[s] - truth[s])[:half] ** 2)) / np.std(truth[s]) for s in signals])

    found = errors()
    assert found.max() < share
    monkeypatch.setattr("sysid.gap.adapters.simulator.CERTAIN", np.inf)  # at rest
    assert found.max() < 0.5 * errors().max()


@pytest.mark.parametrize("seed", range(5))
def test_a_joint_at_rest_starts_at_rest(seed: int) -> None:
    """Also where it begins to move soon, and where its sensor has steps."""
    rng, t = np.random.default_rng(seed), np.arange(60) / 100.0
    noise = rng.normal(0.0, 1e-4, 60)
    for values in (noise, np.maximum(t - 0.07, 0.0) + noise, np.round(noise / 5e-4) * 5e-4, 0.5 + 0.0 * t):
        table = pd.DataFrame({"time": t, "arm.joint": values})
        found = joint_start(Recording("rest", table, 100.0), "arm.joint")
        assert found.speed == 0.0
    moving = pd.DataFrame({"time": t, "arm.joint": 0.3 + 0.5 * t + 2.0 * t**2 + noise})
    found = joint_start(Recording("moving", moving, 100.0), "arm.joint")
    assert (found.position, found.speed) == (pytest.approx(0.3, abs=5e-4), pytest.approx(0.5, abs=0.02))
    slow = Recording("slow", moving[::10], 10.0)
    assert joint_start(slow, "arm.joint").speed == 0.0, "too few samples"
    assert joint_start(slow, "other.joint", 0.7).position == 0.7


def test_a_delay_is_the_one_of_the_model() -> None:
    machine = machine_of("servo_arm")
    recording = with_start(machine, commands_for(machine, 2, 2.0))
    simulator = MujocoSimulator(robot("servo_arm"), machine)
    signals = simulator.simulate(recording)
    elbow = recording.values("elbow.command")
    jump = int(np.argmax(np.abs(np.diff(elbow)) > 0.1)) + 1
    speed = np.diff(signals["elbow.joint"].to_numpy())
    assert abs(speed[jump - 1]) < 0.2 * np.abs(speed).max()
    ends = machine.kinematics()
    assert ends is not None
    joints = np.column_stack([signals[f"{axis}.joint"] for axis in machine.axis_names])
    np.testing.assert_allclose(np.column_stack([signals[f"ee.{c}"] for c in "xyz"]), ends.tip_position(joints), atol=1e-9)


def test_a_passive_tool_hangs_at_the_start() -> None:
    machine = machine_of("velocity_crane", tool="hook_point")
    table = commands_for(machine, 3, 2.0)
    still = table.assign(**{name: 0.0 for name in table if name.endswith(".command")})
    signals = MujocoSimulator(robot("velocity_crane"), machine).simulate(with_start(machine, still, 0.5))
    offset = np.array([signals[f"tool.{c}"][0] - signals[f"ee.{c}"][0] for c in "xyz"])
    np.testing.assert_allclose(offset, [0.0, 0.0, -0.6], atol=5e-3)


@functools.cache
def hidden_delay() -> Dataset:
    """A joint whose actuator is one and a half samples late."""
    machine, tables, spec = machine_of("joint"), [], mujoco.MjSpec.from_file(str(robot("joint")))
    spec.actuators[0].delay, spec.actuators[0].nsample, spec.actuators[0].interp = 0.03, 10, 1
    model = spec.compile()
    for seed in range(4):
        rng = np.random.default_rng([5, seed])
        commands = commands_for(machine, seed, 8.0)
        start = [float(commands["hinge.command"][0])]
        joints = run_model(model, machine, commands, lambda c: {"hinge": c["hinge.command"].to_numpy()}, start)
        tables.append(commands.assign(**{s: x + rng.normal(0.0, NOISE, len(x)) for s, x in joints.items()}))
    return dataset_of_runs(machine, tables)


def test_a_missing_delay_is_named_and_written_into_the_model(tmp_path: Path) -> None:
    dataset = hidden_delay()
    adapter = open_mujoco(robot("joint"), dataset)
    result = find_gap(dataset, adapter)
    assert [(e.name, e.target, dict(e.parameters)) for e in result.effects] == [
        ("input_delay", "hinge", {"delay": pytest.approx(0.03, rel=0.02)})
    ]
    effects = repaired_effects(adapter, result.written)
    repaired = write_repaired(adapter, effects, tmp_path / "joint.xml", dataset, result.gap)
    assert [change.where.partition("=")[0] for change in repaired.native] == ["hinge: delay"]
    assert repaired.beside == ()
    assert repaired.gap.after["hinge.joint"] == pytest.approx(result.gap.after["hinge.joint"], rel=0.02)
    assert repaired.gap.after["hinge.joint"] < 0.05 * result.gap.before["hinge.joint"]
    assert find_gap(dataset, open_mujoco(repaired.path, dataset), localise_only=True).verdict == "no_gap"


@pytest.mark.parametrize(("delay", "native_too"), [(0.0, False), (1e-10, False), (0.03, True)])
def test_a_delay_below_a_step_has_no_native_place(tmp_path: Path, delay: float, native_too: bool) -> None:
    """MuJoCo would apply a whole step; the values of such effects stay exact beside the model, and absent ones are left out."""
    dataset = hidden_delay()
    item = KnownEffect("input_delay", "hinge", {"delay": delay})
    adapter = open_mujoco(robot("joint"), dataset).with_effects([item])
    effects = repaired_effects(adapter, ())
    assert effects == ((item,) if delay else ())
    error = run_rmse([(recording, adapter.simulate(recording)) for recording in dataset.with_role("held_out")])
    promised = Gap(error, error, dict.fromkeys(error, 1e-5))
    repaired = write_repaired(open_mujoco(robot("joint"), dataset), effects, tmp_path / "joint.xml", dataset, promised)
    assert len(repaired.native) == int(native_too)
    assert (len(repaired.native), len(repaired.beside)) == (int(native_too), int(0.0 < delay < 0.01))


@pytest.mark.parametrize(
    ("delay", "interval", "wanted"),
    [(0.0097, (0.0092, 0.0102), 0.01), (0.0097, (0.0095, 0.0099), 0.0097), (0.012, (0.008, 0.016), 0.012)],
)
def test_a_delay_that_may_be_a_whole_step_is_one(delay: float, interval: tuple[float, float], wanted: float) -> None:
    """The model has steps of 10 ms."""
    adapter = open_mujoco(robot("joint"), hidden_delay())
    row = WrittenEffect("input_delay", "hinge", "named", {"delay": delay}, {}, {"delay": interval})
    (found,) = repaired_effects(adapter, [row])
    assert found.parameters == {"delay": wanted}


def written(name: str, effects: list[KnownEffect], out: Path) -> RepairedModel:
    """A robot with these effects, which the recordings contain as the adapter applies them."""
    machine = machine_of(name)
    nominal = dataset_of_runs(machine, [with_start(machine, commands_for(machine, s, 4.0)).table for s in range(4)])
    truth, tables = open_mujoco(robot(name), nominal).with_effects(effects), []
    for k, recording in enumerate(nominal.recordings):
        noise = np.random.default_rng([8, k]).normal(0.0, NOISE, len(recording))
        joints = {s: values + noise for s, values in truth.simulate(recording).items() if str(s).endswith(".joint")}
        tables.append(recording.table.assign(**joints))
    dataset = dataset_of_runs(machine, tables)
    under_test = open_mujoco(robot(name), dataset)
    held_out = dataset.with_role("held_out")
    before, after = (run_rmse([(r, a.simulate(r)) for r in held_out]) for a in (under_test, under_test.with_effects(effects)))
    return write_repaired(under_test, effects, out, dataset, Gap(before, after, dict.fromkeys(before, NOISE)))


@dataclass(frozen=True)
class Native:
    """An error inside the machine: effect, axis, parameter and true value, and what it changes in its actuator."""

    effect: str
    axis: str
    parameter: str
    value: float
    attributes: Mapping[str, Any]


FILTER = {"dyntype": mujoco.mjtDyn.mjDYN_FILTEREXACT, "actearly": True}
NATIVE = {
    "servo": (
        "servo_arm",
        Native("input_delay", "lift", "delay", 0.027, {"delay": 0.027, "nsample": 20, "interp": 1}),
        Native("first_order_lag", "lift", "time_constant", 0.05, {**FILTER, "dynprm": [0.05] + 9 * [0.0]}),
    ),
    "delayed already": (
        "servo_arm",
        Native("input_delay", "elbow", "delay", 0.02, {"delay": 0.03, "nsample": 20, "interp": 1}),
    ),
    "speed": (
        "velocity_crane",
        Native("gain_error", "slew", "ratio", 0.8, {"gainprm": [720.0] + 9 * [0.0]}),
        Native("first_order_lag", "reach", "time_constant", 0.1, {**FILTER, "dynprm": [0.1] + 9 * [0.0]}),
    ),
}


@pytest.mark.parametrize("case", [pytest.param(name, marks=() if name == "speed" else pytest.mark.slow) for name in NATIVE])
def test_native_effects_are_fitted_inside_the_model(case: str, tmp_path: Path) -> None:
    """Errors inside the machine. A search on commands held over samples of 20 ms is a little off; the file is not."""
    name, *errors = NATIVE[case]
    machine, spec, tables = machine_of(name), mujoco.MjSpec.from_file(str(robot(name))), []
    for error in errors:
        for key, value in error.attributes.items():
            setattr(spec.actuator(error.axis), key, value)
    full = {axis.name: axis.gain if axis.actuation == "velocity" else 1.0 for axis in machine.axes}
    model, simulator = spec.compile(), MujocoSimulator(robot(name), machine)

    def controls(commands: pd.DataFrame) -> dict[str, Array]:
        return {axis: gain * commands[f"{axis}.command"].to_numpy() for axis, gain in full.items()}

    for seed in range(4):
        commands, noise = commands_for(machine, seed, 5.0), np.random.default_rng([6, seed])
        joints = run_model(model, machine, commands, controls, simulator.start_positions(with_start(machine, commands)))
        tables.append(commands.assign(**{s: x + noise.normal(0.0, NOISE, len(x)) for s, x in joints.items()}))
    dataset = dataset_of_runs(machine, tables)
    effects = [KnownEffect(e.effect, e.axis, {e.parameter: 0.95 * e.value}) for e in errors]
    adapter = open_mujoco(robot(name), dataset)
    held_out = dataset.with_role("held_out")
    before, after = (run_rmse([(r, a.simulate(r)) for r in held_out]) for a in (adapter, adapter.with_effects(effects)))
    floor = dict.fromkeys(before, NOISE)
    repaired = write_repaired(adapter, effects, tmp_path / "out.xml", dataset, Gap(before, after, floor))
    found = {change.effect.name: change.effect for change in repaired.native}
    for error in errors:
        assert found[error.effect].parameters[error.parameter] == pytest.approx(error.value, rel=0.02)
        signal = f"{error.axis}.joint"
        assert repaired.gap.after[signal] < max(0.3 * after[signal], 5.0 * NOISE)
    assert not side_file(repaired.path).exists()


def test_what_mjcf_lacks_stays_beside_the_model(tmp_path: Path) -> None:
    band = KnownEffect("valve_deadband", "slew", {"positive": 0.05, "negative": 0.08})
    lag = KnownEffect("first_order_lag", "slew", {"time_constant": 0.1})
    stiction = KnownEffect("stiction", "reach", {"breakaway": 0.1, "release": 0.05})
    later = KnownEffect("first_order_lag", "reach", {"time_constant": 0.08})
    play = KnownEffect("backlash", "luff", {"width": 0.01}, "drive")
    repaired = written("velocity_crane", [band, lag, stiction, later, play], tmp_path / "out.xml")
    assert [(change.effect.name, change.effect.target) for change in repaired.native] == [("first_order_lag", "slew")], (
        "the lag of reach acts before its stiction, which stays"
    )
    assert {effect.name for effect in repaired.beside} == {"valve_deadband", "stiction", "first_order_lag", "backlash"}
    assert sorted(read_side_file(repaired.path), key=str) == sorted([band, stiction, later, play], key=str)


def test_a_difference_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "INPUT_WRITERS", {"input_delay": lambda *_: "nothing"})
    with pytest.raises(InputError, match=r"\.joint: the error of the written model is .* expected at most .* as promised"):
        written("servo_arm", [KnownEffect("input_delay", "lift", {"delay": 0.06})], tmp_path / "out.xml")


def test_a_machine_that_the_model_does_not_fit() -> None:
    machine = machine_of("servo_arm")
    crane = machine_of("velocity_crane")
    axes = tuple(replace(axis, actuation="position") for axis in crane.axes)
    with pytest.raises(SettingsError, match=r"actuator slew takes a speed, machine\.toml says position"):
        MujocoSimulator(robot("velocity_crane"), replace(crane, axes=axes))
    with pytest.raises(SettingsError, match="axis 'pan': no joint 'pan' in the model"):
        MujocoSimulator(robot("velocity_crane"), machine)
    with pytest.raises(SettingsError, match=r"link 'gasp' of machine\.toml: no site or body; expected 'grasp'"):
        MujocoSimulator(robot("servo_arm"), replace(machine, tip="gasp"))
    with pytest.raises(InputError, match="no such file"):
        MujocoSimulator(Path("absent.xml"), machine)


def test_the_model_under_test_is_not_overwritten(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="the model under test; expected another file"):
        written("servo_arm", [], robot("servo_arm"))
