"""A MuJoCo model with motors: the plant with the same forces, and parameters that are written into the model."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from mjcf_logs import dataset_of_runs, machine_of
from robots import robot

from sysid.cli.gap import write_model
from sysid.cli.output import Printer
from sysid.datasets.recording import Dataset
from sysid.errors import InputError, SettingsError
from sysid.gap import find_gap
from sysid.gap.adapters.mujoco.force_repair import NO_PLACE, open_force_model, write_force_model
from sysid.gap.adapters.mujoco.force_repair import machine_of as described
from sysid.gap.adapters.mujoco.free_run import Differences, stretches_to_run
from sysid.gap.adapters.mujoco.native import TOGETHER, in_command_units, write_inertials, write_inside
from sysid.gap.adapters.mujoco.repair import RepairedModel, write_spec
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import KnownEffect, Machine
from sysid.machine.rigid_body import rigid_body
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.plant.arm_forces import arm_forces
from sysid.plant.link_torque import inertial_parameters

Array = npt.NDArray[np.float64]

RATE_HZ, NOISE, FORCE_NOISE = 500.0, 1e-5, 0.05


def arm() -> Machine:
    machine = machine_of("torque_arm")
    return replace(machine, noise=dict.fromkeys(machine.noise, NOISE))


def tracked(model: mujoco.MjModel, seed: int, seconds: float) -> pd.DataFrame:
    """The arm follows sums of sines under a PD controller; torques and joints are recorded with noise."""
    rng, count = np.random.default_rng([9, seed]), round(seconds * RATE_HZ)
    time, phase = np.arange(count) / RATE_HZ, rng.uniform(0.0, 2.0 * math.pi, (2, 3))
    rate = np.array([0.31, 0.57, 0.93]) * rng.uniform(0.8, 1.2, (2, 3))
    waves = np.sin(2.0 * math.pi * rate[..., None] * time + phase[..., None])
    path = np.einsum("k,jkn->nj", [0.5, 0.25, 0.15], waves)
    speed = np.gradient(path, 1.0 / RATE_HZ, axis=0)
    data, rows = mujoco.MjData(model), np.empty((count, 4))
    data.qpos[:] = path[0]
    for k in range(count):
        torque = np.array([200.0, 80.0]) * (path[k] - data.qpos) + np.array([12.0, 4.0]) * (speed[k] - data.qvel)
        rows[k] = *torque, *data.qpos
        data.ctrl[:] = torque / model.actuator_gear[:, 0]
        mujoco.mj_step(model, data, round(1.0 / (RATE_HZ * model.opt.timestep)))
    rows += rng.normal(0.0, 1.0, rows.shape) * [FORCE_NOISE, FORCE_NOISE, NOISE, NOISE]
    names = ["shoulder.command", "elbow.command", "shoulder.joint", "elbow.joint"]
    return pd.DataFrame(rows, columns=names).assign(time=time)


@functools.cache
def recorded(seconds: float, **friction: float) -> Dataset:
    """Recordings of the arm with another damping of the shoulder and friction loss of the elbow.

    ``heavier``: ratio of the masses of its links; ``constant``: recorded over true torque of the elbow.
    """
    spec = mujoco.MjSpec.from_file(str(robot("torque_arm")))
    spec.joint("shoulder").damping[0] = friction.get("damping", 0.8)
    spec.joint("elbow").frictionloss = friction.get("loss", 0.2)
    for body in ("upper", "lower"):
        for geom in spec.body(body).geoms:
            geom.mass *= friction.get("heavier", 1.0)
    model = spec.compile()
    model.actuator_ctrllimited[:] = False
    runs = [tracked(model, seed, seconds) for seed in range(4)]
    for run in runs:
        run["elbow.command"] *= friction.get("constant", 1.0)
    return dataset_of_runs(arm(), runs)


def test_the_plant_of_a_model_needs_the_same_forces() -> None:
    dataset = recorded(4.0)
    plant = open_force_model(robot("torque_arm"), dataset)
    assert {(e.name, e.target): e.parameters for e in plant.effects} == {
        ("viscous_friction", "shoulder"): {"coefficient": 0.8},
        ("coulomb_friction", "shoulder"): {"force": 0.5},
        ("viscous_friction", "elbow"): {"coefficient": 0.3},
        ("coulomb_friction", "elbow"): {"force": 0.2},
    }
    assert (plant.machine.rate_hz, plant.machine.noise) == (dataset.machine.rate_hz, dataset.machine.noise)
    located = find_gap(dataset, plant, localise_only=True)
    rows = {stage.signal: stage for stage in located.localised if stage.signal.endswith(".command")}
    assert set(rows) == {"shoulder.command", "elbow.command"}
    for row in rows.values():
        assert row.stage_rmse < 0.02, "a hundredth of the torques"


def test_a_model_with_other_forces_is_refused(tmp_path: Path) -> None:
    text = (
        robot("torque_arm")
        .read_text("utf-8")
        .replace('name="shoulder" axis="0 1 0"', 'name="shoulder" axis="0 1 0" stiffness="8"')
    )
    (tmp_path / "sprung.xml").write_text(text, "utf-8")
    with pytest.raises(InputError, match=r"shoulder: its torques differ by .* Remove springs"):
        open_force_model(tmp_path / "sprung.xml", recorded(4.0))


def test_a_model_with_other_joints_is_refused() -> None:
    with pytest.raises(SettingsError, match="driven joints pan, lift and elbow; expected shoulder and elbow"):
        described(robot("servo_arm"), replace(arm(), tip="grasp"))


INSIDE = [
    KnownEffect("viscous_friction", "shoulder", {"coefficient": 1.7}),
    KnownEffect("coulomb_friction", "elbow", {"force": 0.65}),
    KnownEffect("load_bias", "elbow", {"force": 0.4}),
    KnownEffect("inertia_error", "shoulder", {"ratio": 1.5}),
    KnownEffect("link_mass_error", "elbow", {"ratio": 1.2}),
    KnownEffect("payload", "tool", {"mass": 0.3, "centre": [0.02, 0.01, -0.05]}),
]


def test_parameters_are_written_into_the_model(tmp_path: Path) -> None:
    machine, path, out = arm(), robot("torque_arm"), tmp_path / "out.xml"
    spec, model = load_spec(path), load_mjcf(path)
    beyond = KnownEffect("stribeck_friction", "elbow", {"static_force": 2.0, "coulomb_force": 1.0, "stribeck_velocity": 0.1})
    written, left = write_inside(spec, model, machine, [*INSIDE, beyond], "torque_arm.xml")
    assert [change.effect for change in written] == INSIDE
    assert left == [beyond]
    spec.compile()
    out.write_text(spec.to_xml(), "utf-8")
    again = described(out, machine)
    found = {(item.name, item.target): item.parameters for item in again.effects}
    assert found["viscous_friction", "shoulder"] == {"coefficient": pytest.approx(1.7)}
    assert found["coulomb_friction", "elbow"] == {"force": pytest.approx(0.65)}
    assert found["load_bias", "elbow"] == {"force": pytest.approx(0.4)}
    assert again.axis("shoulder").inertia == pytest.approx(1.5 * 0.05)
    plant = nominal_plant(machine)
    for item in INSIDE[3:]:
        plant = plant.with_effect(item)
    compiled, body = compile_plant(plant), rigid_body(again)
    assert body is not None
    assert compiled.rigid is not None
    q, v, a = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 20, 2))
    expected = compiled.rigid.torque(q, v, a, inertial_parameters(compiled, plant.vector()))
    np.testing.assert_allclose(body.torque(q, v, a, body.nominal), expected, atol=1e-6)


ADJUSTED = [
    KnownEffect(
        "inertial_error",
        "shoulder",
        {"mass": 0.1, "first_moment": [0.01, 0.0, -0.03], "inertia": [0.02, 0.0, 0.02, 0.001, 0.0, 0.001], "rotor": 0.02,
         "scale": 1.05},
    ),
    KnownEffect(
        "inertial_error",
        "elbow",
        {"mass": -0.05, "first_moment": [0.002, 0.001, 0.01], "inertia": [0.0] * 6, "rotor": 0.03, "scale": 0.97},
    ),
]  # fmt: skip


def forces_of(plant: Plant, q: Array, v: Array, a: Array) -> Array:
    """Commands (n, A) that a plant needs for motions (n, A)."""
    model = compile_plant(plant)
    return arm_forces(model, model.theta, q, v, a, 0.01)


@pytest.mark.parametrize("more", [[], INSIDE], ids=["adjusted", "with-names"])
def test_adjusted_inertial_parameters_are_written_together(more: list[KnownEffect], tmp_path: Path) -> None:
    """The written file needs the forces of the plant; its actuators make so much less of their controls."""
    path, out = robot("torque_arm"), tmp_path / "out.xml"
    spec, model, plant = load_spec(path), load_mjcf(path), nominal_plant(arm())
    for item in [*more, *ADJUSTED]:
        plant = plant.with_effect(item)
    write_inside(spec, model, plant.machine, [item for item in more if item.name not in TOGETHER], path.name)
    changes = write_inertials(spec, model, plant, path.name)
    assert changes is not None
    assert {(c.effect.name, c.effect.target) for c in changes} >= {("inertial_error", "shoulder"), ("inertial_error", "elbow")}
    write_spec(spec, out)
    q, v, a = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 40, 2))
    v += np.copysign(0.05, v)
    expected = forces_of(plant, q, v, a)
    again = in_command_units(nominal_plant(described(out, plant.machine)), ADJUSTED)
    np.testing.assert_allclose(forces_of(again, q, v, a), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    written = mujoco.MjModel.from_xml_path(str(out))
    data, before, found = mujoco.MjData(written), load_mjcf(path), np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(written, data)
        gear = written.actuator_gear[:, 0]
        control = (data.qfrc_inverse / gear - written.actuator_biasprm[:, 0]) / written.actuator_gainprm[:, 0]
        found[k] = control * before.actuator_gear[:, 0] * before.actuator_gainprm[:, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_inertial_parameters_without_a_place_are_not_written() -> None:
    """A rotor of less than none, and an actuator with an inertia of its own, which a force constant would change."""
    path = robot("torque_arm")
    spec, model = load_spec(path), load_mjcf(path)
    spec.actuators[0].armature = 1e-5
    plant = nominal_plant(arm())
    for item in ADJUSTED:
        plant = plant.with_effect(item)
    before = spec.to_xml()
    assert write_inertials(spec, spec.copy().compile(), plant, path.name) is None
    assert spec.to_xml() == before
    lighter = replace(ADJUSTED[0], parameters={**ADJUSTED[0].parameters, "mass": 3.0})
    model.body_mass[1] += 1.0  # a model that is not that of the plant
    assert write_inertials(load_spec(path), model, plant.with_effect(lighter), path.name) is None


RIGHT = [
    WrittenEffect("viscous_friction", "shoulder", "named", {"coefficient": 1.6}),
    WrittenEffect("coulomb_friction", "elbow", "named", {"force": 0.6}),
]
#: The forces of a model that has what the recordings contain, and of one that has not [N·m].
PROMISED = Gap(*(dict.fromkeys(("shoulder.command", "elbow.command"), value) for value in (1.0, 0.1, 0.05)))


def repaired_with(adjusted: list[WrittenEffect], dataset: Dataset, out: Path) -> RepairedModel:
    plant = open_force_model(robot("torque_arm"), dataset)
    return write_force_model(robot("torque_arm"), plant, [*RIGHT, *adjusted], out, dataset, PROMISED)


def test_an_adjusted_load_that_the_free_run_contradicts_is_left_out(tmp_path: Path) -> None:
    """A hundredth of the torques hardly changes the forces; the free run drifts by it."""
    dataset, bias = recorded(4.0, damping=1.6, loss=0.6), WrittenEffect("load_bias", "elbow", "adjusted", {"force": 0.1})
    repaired = repaired_with([bias], dataset, tmp_path / "out.xml")
    assert [change.effect.name for change in repaired.native] == ["viscous_friction", "coulomb_friction"]
    assert [(item.name, item.target) for item in repaired.beside] == [("load_bias", "elbow")]
    assert "the error of the free run rises from" in repaired.reasons["load_bias", "elbow", None]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    np.testing.assert_allclose(model.actuator_biasprm[:, 0], 0.0)
    np.testing.assert_allclose(model.dof_damping, [1.6, 0.3])


def test_the_console_and_the_json_state_why_it_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset, bias = recorded(4.0, damping=1.6, loss=0.6), WrittenEffect("load_bias", "elbow", "adjusted", {"force": 0.1})
    plant = open_force_model(robot("torque_arm"), dataset)
    result: Any = SimpleNamespace(written=(*RIGHT, bias), stage_gap=PROMISED)
    said = write_model(Printer(), plant, result, dataset, robot("torque_arm"), tmp_path / "out.xml")
    (left,) = said["beside"]
    assert (left["name"], left["target"]) == ("load_bias", "elbow")
    assert left["why"].startswith("the error of the free run rises from")
    assert f"load_bias of elbow: not written ({left['why']})" in capsys.readouterr().out


def test_adjusted_masses_that_lower_the_error_of_the_free_run_are_written(tmp_path: Path) -> None:
    dataset = recorded(4.0, damping=1.6, loss=0.6, heavier=1.05)
    heavier = [WrittenEffect("link_mass_error", axis, "adjusted", {"ratio": 1.05}) for axis in ("shoulder", "elbow")]
    repaired = repaired_with(heavier, dataset, tmp_path / "out.xml")
    assert (repaired.beside, repaired.reasons) == ((), {})
    before, after = (mujoco.MjModel.from_xml_path(str(path)) for path in (robot("torque_arm"), tmp_path / "out.xml"))
    np.testing.assert_allclose(after.body_mass, 1.05 * before.body_mass)


def test_adjusted_parameters_without_a_free_run_are_left_out(tmp_path: Path) -> None:
    dataset = recorded(4.0, damping=1.6, loss=0.6, heavier=1.05)
    heavier = WrittenEffect("link_mass_error", "elbow", "adjusted", {"ratio": 1.05})
    recordings = tuple(
        replace(r, table=r.table.drop(columns="elbow.command")) if dataset.splits[r.name] == "select" else r
        for r in dataset.recordings
    )
    repaired = repaired_with([heavier], replace(dataset, recordings=recordings), tmp_path / "out.xml")
    assert list(repaired.reasons.values()) == ["no selection recording has commands and positions of all axes"]
    beyond = WrittenEffect(
        "stribeck_friction", "elbow", "adjusted", {"static_force": 2.0, "coulomb_force": 1.0, "stribeck_velocity": 0.1}
    )
    repaired = repaired_with([heavier, beyond], dataset, tmp_path / "out.xml")
    assert {item.name for item in repaired.beside} == {"link_mass_error", "stribeck_friction"}
    assert set(repaired.reasons.values()) == {NO_PLACE}


def test_a_free_run_has_the_recorded_commands_whatever_the_force_constant(tmp_path: Path) -> None:
    """An actuator that makes more of its control, and torques that were recorded with the old constant."""
    dataset, spec = recorded(4.0, damping=1.6, loss=0.6, constant=0.9), load_spec(robot("torque_arm"))
    spec.joint("shoulder").damping[0], spec.joint("elbow").frictionloss = 1.6, 0.6
    spec.actuators[1].gainprm[0] /= 0.9
    write_spec(spec, tmp_path / "out.xml")
    plant = nominal_plant(dataset.machine)
    simulator = MujocoSimulator(tmp_path / "out.xml", plant.machine)
    stretches = stretches_to_run(plant, dataset.recordings[:1])
    right, other = (Differences(simulator, constants, plant.machine.noise).rms(stretches) for constants in ({"elbow": 0.9}, {}))
    assert right < 0.3 * other


def test_a_free_run_that_diverges_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where it runs
    dataset, spec = recorded(1.0), load_spec(robot("torque_arm"))
    for actuator in spec.actuators:
        actuator.biastype, actuator.biasprm[0] = mujoco.mjtBias.mjBIAS_AFFINE, 1e12
    for joint in spec.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    write_spec(spec, tmp_path / "out.xml")
    simulator = MujocoSimulator(tmp_path / "out.xml", dataset.machine)
    with pytest.raises(InputError, match="it diverges"):
        Differences(simulator, {}, dataset.machine.noise).rms(
            stretches_to_run(nominal_plant(dataset.machine), dataset.recordings[:1])
        )
    with pytest.raises(InputError, match="it diverges"):
        simulator.simulate(dataset.recordings[0])


@functools.cache
def swung(seconds: float) -> Dataset:
    """Recordings of noise-free torques on an arm with ``RIGHT``, which starts in motion."""
    spec = mujoco.MjSpec.from_file(str(robot("torque_arm")))
    spec.joint("shoulder").damping[0], spec.joint("elbow").frictionloss = 1.6, 0.6
    model, runs = spec.compile(), list[pd.DataFrame]()
    for seed in range(4):
        rng, count = np.random.default_rng([4, seed]), round(seconds * RATE_HZ)
        time = np.arange(count) / RATE_HZ
        torque = np.array([5.0, 1.5]) * np.sin(2.0 * math.pi * np.outer(time, rng.uniform(0.4, 0.9, 2)) + rng.uniform(0, 6, 2))
        data, joints = mujoco.MjData(model), np.empty((count, 2))
        data.qpos[:], data.qvel[:] = rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.5, 0.5, 2)
        for k in range(count):
            joints[k] = data.qpos
            data.ctrl[:] = torque[k] / model.actuator_gear[:, 0]
            mujoco.mj_step(model, data, round(1.0 / (RATE_HZ * model.opt.timestep)))
        joints += rng.normal(0.0, NOISE, joints.shape)
        table = np.column_stack([torque, joints])
        names = ["shoulder.command", "elbow.command", "shoulder.joint", "elbow.joint"]
        runs.append(pd.DataFrame(table, columns=names).assign(time=time))
    return dataset_of_runs(arm(), runs)


def with_intervals(shoulder: float, elbow: float, width: float) -> list[WrittenEffect]:
    rows = zip(RIGHT, ("coefficient", "force"), (shoulder, elbow), strict=True)
    return [
        replace(row, parameters={key: value}, interval95={key: ((1.0 - width) * value, (1.0 + width) * value)})
        for row, key, value in rows
    ]


def test_values_are_fitted_once_more_to_the_free_run(tmp_path: Path) -> None:
    dataset = swung(4.0)
    plant = open_force_model(robot("torque_arm"), dataset)
    rows, out = with_intervals(1.63, 0.59, 0.05), tmp_path / "out.xml"
    repaired = write_force_model(robot("torque_arm"), plant, rows, out, dataset, PROMISED)
    model = mujoco.MjModel.from_xml_path(str(out))
    np.testing.assert_allclose([model.dof_damping[0], model.dof_frictionloss[1]], [1.6, 0.6], rtol=1e-4)
    values = {change.effect.target: [*change.effect.parameters.values()] for change in repaired.native}
    assert values == {"shoulder": [pytest.approx(1.6, rel=1e-4)], "elbow": [pytest.approx(0.6, rel=1e-4)]}
    start, end = re.search(r"from (\S+) to (\S+) standard deviations", repaired.fitted).groups()  # type: ignore[union-attr]
    assert float(start) > 10.0
    assert float(end) == pytest.approx(1.0, abs=0.1), "the noise of the sensors alone"


@pytest.mark.slow
def test_values_that_are_fitted_stay_within_their_intervals(tmp_path: Path) -> None:
    dataset = swung(4.0)
    plant = open_force_model(robot("torque_arm"), dataset)
    out = tmp_path / "out.xml"
    write_force_model(robot("torque_arm"), plant, with_intervals(1.8, 0.6, 0.02), out, dataset, PROMISED)
    assert mujoco.MjModel.from_xml_path(str(out)).dof_damping[0] == pytest.approx(0.98 * 1.8, rel=1e-3)


def test_values_without_an_interval_stay(tmp_path: Path) -> None:
    repaired = repaired_with([], swung(4.0), tmp_path / "out.xml")
    assert repaired.fitted == ""
    assert [change.effect.parameters for change in repaired.native] == [row.parameters for row in RIGHT]


@pytest.mark.slow
def test_friction_is_named_and_repaired(tmp_path: Path) -> None:
    dataset = recorded(10.0, damping=1.6, loss=0.6)
    plant = open_force_model(robot("torque_arm"), dataset)
    result = find_gap(dataset, plant)
    assert {(e.name, e.target): dict(e.parameters) for e in result.effects} == {
        ("viscous_friction", "shoulder"): {"coefficient": pytest.approx(1.6, rel=0.01)},
        ("coulomb_friction", "elbow"): {"force": pytest.approx(0.6, rel=0.01)},
    }
    out = tmp_path / "out.xml"
    repaired = write_force_model(robot("torque_arm"), plant, result.written, out, dataset, result.stage_gap)
    assert {change.effect.name for change in repaired.native} == {"viscous_friction", "coulomb_friction"}
    adjusted = {(row.name, row.target) for row in result.written if row.kind == "adjusted"}
    assert {(item.name, item.target) for item in repaired.beside} <= adjusted, "what has a name is in the model"
    for signal, value in repaired.gap.after.items():
        assert value < 0.05 * repaired.gap.before[signal]


@pytest.mark.slow
def test_adjusted_links_are_in_the_repaired_model(tmp_path: Path) -> None:
    """Masses a little off and a wrong force constant get no name; the repaired file has them all the same."""
    dataset = recorded(10.0, damping=1.6, loss=0.6, heavier=1.04, constant=0.97)
    plant = open_force_model(robot("torque_arm"), dataset)
    result = find_gap(dataset, plant)
    assert {row.name for row in result.written if row.kind == "adjusted"} >= {"inertial_error"}
    out = tmp_path / "out.xml"
    repaired = write_force_model(robot("torque_arm"), plant, result.written, out, dataset, result.stage_gap)
    assert repaired.beside == ()
    assert {"viscous_friction", "coulomb_friction", "inertial_error"} <= {change.effect.name for change in repaired.native}
    for signal, value in repaired.gap.after.items():
        assert value <= 1.01 * result.stage_gap.after[signal]
        assert value < 0.05 * repaired.gap.before[signal]
    model = mujoco.MjModel.from_xml_path(str(out))
    assert 2.0 < model.body_mass[1] < 2.0 * 1.08, "torques determine the product of a mass and a force constant"
