"""A MuJoCo model with motors: the plant with the same forces, and parameters that are written into the model."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from mjcf_logs import dataset_of_runs, machine_of
from robots import robot

from sysid.datasets.recording import Dataset
from sysid.errors import InputError, SettingsError
from sysid.gap import find_gap
from sysid.gap.adapters.mujoco.force_axes import machine_of as described
from sysid.gap.adapters.mujoco.force_axes import open_force_model
from sysid.gap.adapters.mujoco.force_repair import write_force_model
from sysid.gap.adapters.mujoco.inside import write_inside
from sysid.machine import KnownEffect, Machine
from sysid.machine.rigid_body import rigid_body
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec
from sysid.plant import compile_plant, nominal_plant
from sysid.plant.link_torque import inertial_parameters

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


def recorded(seconds: float, **friction: float) -> Dataset:
    """Recordings of the arm with another damping of the shoulder and friction loss of the elbow."""
    spec = mujoco.MjSpec.from_file(str(robot("torque_arm")))
    spec.joint("shoulder").damping[0] = friction.get("damping", 0.8)
    spec.joint("elbow").frictionloss = friction.get("loss", 0.2)
    model = spec.compile()
    model.actuator_ctrllimited[:] = False
    return dataset_of_runs(arm(), [tracked(model, seed, seconds) for seed in range(4)])


def test_the_plant_of_a_model_needs_the_same_forces() -> None:
    dataset = recorded(4.0)
    plant = open_force_model(robot("torque_arm"), dataset).plant
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


@pytest.mark.slow
def test_friction_is_named_and_repaired(tmp_path: Path) -> None:
    dataset = recorded(10.0, damping=1.6, loss=0.6)
    plant = open_force_model(robot("torque_arm"), dataset).plant
    result = find_gap(dataset, plant)
    assert {(e.name, e.target): dict(e.parameters) for e in result.effects} == {
        ("viscous_friction", "shoulder"): {"coefficient": pytest.approx(1.6, rel=0.01)},
        ("coulomb_friction", "elbow"): {"force": pytest.approx(0.6, rel=0.01)},
    }
    out = tmp_path / "out.xml"
    repaired = write_force_model(robot("torque_arm"), plant, result.written, out, dataset, result.stage_gap)
    assert {change.effect.name for change in repaired.native} == {"viscous_friction", "coulomb_friction"}
    for signal, value in repaired.gap.after.items():
        assert value < 0.05 * repaired.gap.before[signal]
