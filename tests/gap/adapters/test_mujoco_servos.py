"""A MuJoCo model of servos: the plant that moves as it does, and effects of its loops that are written into the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from servo_arms import STIFF, arm_text, commands, logged, recording_of

from sysid.cli.gap import open_simulator
from sysid.datasets.recording import Dataset
from sysid.effects import input_delay
from sysid.errors import SettingsError
from sysid.gap import SimulatorAdapter, find_gap
from sysid.gap.adapters.mujoco.force_repair import machine_of
from sysid.gap.adapters.mujoco.repair import write_spec
from sysid.gap.adapters.mujoco.servo_repair import open_servo_model, write_servo_model, write_servos
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.machine.sources.draft import machine_text
from sysid.machine.sources.mjcf import mjcf_draft
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec
from sysid.plant import Plant, chain, compile_plant, nominal_plant

DT, NOISE = 0.01, 2e-4
ROLES = {"a": "fit", "b": "fit", "c": "select", "d": "held_out"}


def saved(folder: Path, text: str) -> Path:
    path = folder / "arm.xml"
    path.write_text(text, "utf-8")
    return path


def described(path: Path) -> Machine:
    draft = mjcf_draft(path)
    machine = machine_from_files({"machine.toml": machine_text(draft, "arm"), "arm.urdf": draft.urdf}, "arm")
    return replace(machine, rate_hz=1.0 / DT, noise={f"{name}.joint": NOISE for name in machine.axis_names})


def recorded(machine: Machine, text: str, seconds: float = 12.0) -> Dataset:
    """What an arm of ``text`` does, under commands that differ from recording to recording."""
    recordings, joints = [], len(machine.axis_names)
    for seed, name in enumerate(ROLES):
        wanted = commands(joints, round(seconds / DT), DT, seed)
        noise = np.random.default_rng([4, seed]).normal(0.0, NOISE, wanted.shape)
        recording = recording_of(wanted, logged(text, wanted, DT) + noise, DT, machine)
        recordings.append(replace(recording, name=name))
    return Dataset.of(machine, recordings, ROLES)


def changed(text: str, joint: str, **attributes: float) -> str:
    """The text with other attributes of a joint, or of the actuator of that name."""
    spec = mujoco.MjSpec.from_string(text)
    for key, value in attributes.items():
        if key == "kp":
            actuator = spec.actuator(joint)
            actuator.gainprm[0], actuator.biasprm[1] = value, -value
        elif key == "damping":
            spec.joint(joint).damping[0] = value
        else:
            setattr(spec.joint(joint), key, value)
    spec.compile()
    return str(spec.to_xml())


LAWS: Sequence[tuple[str, Mapping[str, float]]] = [
    ("stiffness_error", {"ratio": 0.7}),
    ("damping_error", {"ratio": 1.6}),
    ("force_limit", {"limit": 3.5}),
    ("armature_error", {"ratio": 2.5}),
]


@pytest.mark.parametrize("gear", [1.0, -3.0])
@pytest.mark.parametrize(("name", "parameters"), LAWS, ids=[name for name, _ in LAWS])
def test_the_written_model_is_described_by_the_repaired_plant(
    tmp_path: Path, name: str, parameters: dict[str, float], gear: float
) -> None:
    text = arm_text(2, limited=0.3).replace('joint="j1" kp', f'joint="j1" gear="{gear}" kp')
    path = saved(tmp_path, text)
    item = KnownEffect(name, "j1", parameters)
    plant = nominal_plant(described(path)).with_effect(item)
    spec = load_spec(path)
    written, left = write_servos(spec, load_mjcf(path), plant, [item], "arm")
    assert [change.effect for change in written] == [item]
    assert not left
    write_spec(spec, out := tmp_path / "out.xml")
    again, model = compile_plant(nominal_plant(described(out))), compile_plant(plant)
    for i in range(2):
        own = chain.servo_law.py_func(model.theta, model.arrays.axes, i)
        np.testing.assert_allclose(chain.servo_law.py_func(again.theta, again.arrays.axes, i), own, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("viscous_friction", {"coefficient": 0.31}),
        ("viscous_friction", {"positive": 0.0, "negative": 0.0}),
        ("coulomb_friction", {"force": 0.12}),
        ("input_delay", {"delay": 0.02}),
        ("first_order_lag", {"time_constant": 0.03}),
    ],
)
def test_friction_and_delays_are_those_of_the_written_model(tmp_path: Path, name: str, parameters: dict[str, float]) -> None:
    path, item = saved(tmp_path, arm_text(2)), KnownEffect(name, "j1", parameters)
    plant, spec = nominal_plant(described(path)).with_effect(item), load_spec(path)
    _, left = write_servos(spec, load_mjcf(path), plant, [item], "arm")
    assert not left
    write_spec(spec, out := tmp_path / "out.xml")
    found = nominal_plant(described(out)).effect(name, "j1", None)
    if not any(parameters.values()):
        assert found is None
        return
    assert found is not None
    for key, value in parameters.items():
        assert found.parameters[key] == pytest.approx(value, abs=1e-6)


def test_friction_by_direction_has_no_place(tmp_path: Path) -> None:
    path = saved(tmp_path, arm_text(2))
    item = KnownEffect("coulomb_friction", "j1", {"positive": 0.1, "negative": 0.2})
    plant = nominal_plant(described(path)).with_effect(item)
    assert write_servos(load_spec(path), load_mjcf(path), plant, [item], "arm") == ([], [item])


def test_effects_in_the_loops_are_found_and_written_and_the_model_then_moves_as_the_machine(tmp_path: Path) -> None:
    text = arm_text(2, rubs=STIFF)
    path = saved(tmp_path, text)
    true = changed(text.replace('frictionloss="0.2400"', 'frictionloss="0.55"'), "a0", kp=25.0)
    dataset = recorded(described(path), true, 6.0)
    tested = open_simulator(f"mujoco:{path}", dataset)
    assert isinstance(tested, Plant)
    result = find_gap(dataset, tested)
    assert {(e.name, e.target) for e in result.effects} == {("stiffness_error", "j0"), ("coulomb_friction", "j1")}
    repaired = write_servo_model(path, tested, result, tmp_path / "out.xml", dataset)
    assert not repaired.reasons
    for signal, after in repaired.gap.after.items():
        assert after < 1.5 * result.gap.noise_floor[signal]
    model = mujoco.MjModel.from_xml_path(str(repaired.path))
    assert model.actuator_gainprm[0, 0] == pytest.approx(25.0, rel=0.02)
    assert model.dof_frictionloss[1] == pytest.approx(0.55, rel=0.03)


def test_a_model_that_moves_otherwise_is_run_itself_and_the_reason_is_told(tmp_path: Path) -> None:
    sprung = arm_text(2).replace('<joint name="j1"', '<joint name="j1" stiffness="6" springref="0.5"')
    path, told = saved(tmp_path, sprung), list[str]()
    dataset = recorded(described(path), sprung, 4.0)
    found = open_servo_model(path, dataset)
    assert isinstance(found, str)
    assert "motion of j1 differs" in found
    assert isinstance(open_simulator(f"mujoco:{path}", dataset, (), told.append), SimulatorAdapter)
    assert found in told[0]


def test_the_convention_of_the_recordings_is_not_that_of_the_comparison(tmp_path: Path) -> None:
    path = saved(tmp_path, text := arm_text(2))
    machine = replace(described(path), convention="written_before_read")
    tested = open_servo_model(path, recorded(machine, text, 4.0))
    assert isinstance(tested, Plant)
    assert tested.machine.convention == "written_before_read"


def test_other_joints_are_an_error(tmp_path: Path) -> None:
    path, elsewhere = saved(tmp_path, arm_text(2)), tmp_path / "elsewhere"
    elsewhere.mkdir()
    other = saved(elsewhere, arm_text(3))
    with pytest.raises(SettingsError, match="driven joints"):
        machine_of(other, described(path))


def test_a_dead_time_between_two_steps_is_that_of_the_plant(tmp_path: Path) -> None:
    """MuJoCo interpolates between the controls of its history: the motion is that of a plant with this dead time."""
    path, item = saved(tmp_path, text := arm_text(1)), KnownEffect(input_delay.EFFECT.name, "j0", {"delay": 0.0216})
    plant, spec = nominal_plant(described(path)).with_effect(item), load_spec(path)
    write_servos(spec, load_mjcf(path), plant, [item], "arm")
    write_spec(spec, out := tmp_path / "out.xml")
    model, wanted = compile_plant(plant), commands(1, 1000, DT)
    recording = recording_of(wanted, logged(out.read_text("utf-8"), wanted, DT), DT, plant.machine)
    late = model.drive(model.theta[None], recording, "j0")[0] - recording.values("j0.joint")
    speed = np.abs(np.gradient(recording.values("j0.joint"), DT)).max()
    assert math.sqrt(float(np.mean(late**2))) < 0.5e-3 * speed, "half a millisecond"
    assert text != out.read_text("utf-8")
