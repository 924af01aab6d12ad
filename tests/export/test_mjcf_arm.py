"""Arms in MuJoCo: the torques of every motion, the motion of given torques, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_drive_model import probe_plant

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import SettingsError
from sysid.export.drive_module import load_module
from sysid.export.export import PAGE, TARGETS, export_plant, target_named
from sysid.export.mjcf_arm import LOOP, MujocoArm
from sysid.export.mjcf_bodies import FILE
from sysid.export.replay import force_replay
from sysid.machine import KnownEffect, machine_from_files
from sysid.machine.rigid_body import PARAMETERS
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.plant.arm_forces import arm_forces
from sysid.plant.arm_inertia import arm_inertia, inertial, is_admissible
from sysid.plant.link_torque import inertial_parameters
from sysid.testing.probe import probe_arm

pytest.importorskip("pinocchio")

Array = npt.NDArray[np.float64]
MJCF = target_named("mjcf")
RATE = 200.0
PAYLOAD = KnownEffect("payload", "tool", {"mass": 1.3, "centre": [0.02, 0.01, 0.05]})


def random_arm(seed: int, axes: int) -> Plant:
    """An arm of random links, hinges and slides, each with a rotor, a force constant, friction, a load, errors of its link."""
    draw = np.random.default_rng(seed)
    links, joints, tables = ['<link name="l0"/>'], [], []
    for k in range(axes):
        # Second moments of a mass distribution: any positive definite matrix.
        factor = draw.normal(size=(3, 3)) * 0.05
        second = factor @ factor.T + 1e-4 * np.eye(3)
        mass, moments = draw.uniform(0.2, 8.0), np.trace(second) * np.eye(3) - second
        names = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), moments[np.triu_indices(3)], strict=True))
        inertia = " ".join(f'{key}="{value!r}"' for key, value in ((n, float(v)) for n, v in names.items()))
        links.append(
            f'<link name="l{k + 1}"><inertial>'
            f'<origin xyz="{_text(draw.normal(size=3) * 0.15)}" rpy="{_text(draw.normal(size=3))}"/>'
            f'<mass value="{mass!r}"/><inertia {inertia}/></inertial></link>'
        )
        kind = "prismatic" if draw.random() < 0.2 else "revolute"
        joints.append(
            f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{_text(draw.normal(size=3) * 0.3)}" rpy="{_text(draw.normal(size=3))}"/>'
            f'<axis xyz="{_text(_unit(draw.normal(size=3)))}"/><limit lower="-3" upper="3" velocity="9" effort="9"/></joint>'
        )
        tables.append(
            f'[[axes]]\nname = "a{k}"\njoint = "j{k}"\nactuation = "force"\ndrives = "joint"\n'
            f"inertia = {draw.uniform(0.0, 1.0)}\n"
        )
    links.append('<link name="tip"/>')
    joints.append(
        f'<joint name="end" type="fixed"><parent link="l{axes}"/><child link="tip"/>'
        '<origin xyz="0.1 0 0.2" rpy="0.3 0 1"/></joint>'
    )
    text = 'schema = 1\nname = "random"\nrate_hz = 200.0\nurdf = "random.urdf"\ntip = "tip"\n' + "".join(tables)
    urdf = f'<robot name="random">{"".join(links)}{"".join(joints)}</robot>'
    plant = nominal_plant(machine_from_files({"machine.toml": text, "random.urdf": urdf}, "random"))
    rigid = compile_plant(plant).rigid
    assert rigid is not None
    for k, body in enumerate(rigid.body_of):
        # A mass of its own keeps the sum a mass distribution.
        more = _extra(draw, float(rigid.nominal[body, 0]))
        errors = {"mass": more[0], "first_moment": list(more[1:4]), "inertia": list(more[4:])}
        drive = {"rotor": draw.uniform(0.0, 0.2), "scale": draw.uniform(0.5, 20.0)}
        for effect in (
            KnownEffect("inertial_error", f"a{k}", errors | drive),
            KnownEffect("link_mass_error", f"a{k}", {"ratio": draw.uniform(0.8, 1.2)}),
            KnownEffect("viscous_friction", f"a{k}", {"coefficient": draw.uniform(0.0, 5.0)}),
            KnownEffect("coulomb_friction", f"a{k}", {"force": draw.uniform(0.0, 5.0)}),
            KnownEffect("load_bias", f"a{k}", {"force": draw.uniform(-5.0, 5.0)}),
            KnownEffect("inertia_error", f"a{k}", {"ratio": draw.uniform(0.5, 2.0)}),
        ):
            plant = plant.with_effect(effect)
    return plant.with_effect(PAYLOAD)


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def _extra(draw: np.random.Generator, mass: float) -> Array:
    """Inertial parameters (10,) of a small ball somewhere."""
    m, c = draw.uniform(0.01, 0.1) * mass, draw.normal(size=3) * 0.1
    moments = m * (c @ c * np.eye(3) - np.outer(c, c)) + 1e-4 * np.eye(3)
    return np.array([m, *(m * c), *(moments[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))])


def plant_forces(plant: Plant, q: Array, v: Array, a: Array) -> Array:
    """Commands (n, A) that the plant needs for motions (n, A)."""
    model = compile_plant(plant)
    return arm_forces(model, model.theta, q, v, a, 0.01)


def motions(axes: int, seed: int = 0) -> Array:
    """Random positions, speeds and accelerations, (3, n, A).

    No axis reverses within a step of the model: dry friction acts there against the speed at the end of the step.
    """
    found = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 50, axes)) * np.array([2.5, 3.0, 20.0])[:, None, None]
    found[1] += np.copysign(0.05, found[1])
    return found


def relative(found: Array, expected: Array) -> float:
    """Largest difference of a motion, as a share of the RMS of the axis."""
    return float((np.abs(found - expected) / np.sqrt(np.mean(expected**2, axis=0))).max())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 7))
def test_inverse_dynamics_of_the_file_are_those_of_the_plant(seed: int, axes: int) -> None:
    """The file alone, in MuJoCo alone."""
    plant = random_arm(seed, axes)
    with TemporaryDirectory() as folder:
        MJCF.write(plant, RATE, Path(folder))
        model = mujoco.MjModel.from_xml_path(f"{folder}/{FILE}")
    assert model.body("payload").mass == pytest.approx(1.3)
    data, (q, v, a) = mujoco.MjData(model), motions(axes, seed)
    found = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        found[k] = (data.qfrc_inverse - model.actuator_biasprm[:, 0]) / model.actuator_gainprm[:, 0]
    assert relative(found, plant_forces(plant, q, v, a)) < 1e-6


ELBOW = [
    KnownEffect("viscous_friction", "elbow", {"positive": 0.8, "negative": 0.3}),
    KnownEffect("coulomb_friction", "elbow", {"positive": 1.1, "negative": 0.6}),
    KnownEffect("stribeck_friction", "elbow", {"static_force": 2.0, "coulomb_force": 0.8, "stribeck_velocity": 0.05}),
    KnownEffect("smooth_coulomb_friction", "elbow", {"force": 1.5, "width": 0.1}),
    KnownEffect("smooth_coulomb_friction", "elbow", {"force": 1.5, "width": 0.1, "exponent": 2.0}),
    KnownEffect("load_dependent_friction", "elbow", {"coefficient": 0.2}),
]


def two_links(*effects: KnownEffect) -> Plant:
    plant = nominal_plant(probe_arm())
    for effect in (PAYLOAD, KnownEffect("coulomb_friction", "lift", {"force": 2.0}), *effects):
        plant = plant.with_effect(effect)
    return plant


SCALED = KnownEffect(
    "inertial_error", "elbow", {"mass": 0.0, "first_moment": [0.0] * 3, "inertia": [0.0] * 6, "rotor": 0.1, "scale": 3.0}
)


@pytest.mark.parametrize(
    "effects", [[e] for e in ELBOW] + [[ELBOW[3], ELBOW[5]], ELBOW[:3]], ids=lambda e: "+".join(x.name for x in e)
)
def test_friction_by_the_loop(effects: list[KnownEffect], tmp_path: Path) -> None:
    """Friction without an element in MuJoCo: forces of a motion, and motion under forces."""
    plant = two_links(*effects, SCALED)
    MJCF.write(plant, RATE, tmp_path)
    rows = json.loads((tmp_path / "robot.json").read_text("utf-8"))["axes"]
    assert [row["mode"] for row in rows] == ["native", "friction"]
    q, v, a = motions(2)
    simulation = MJCF.simulation(plant, tmp_path)
    assert relative(simulation.forces(q, v, a), plant_forces(plant, q, v, a)) < 1e-6  # type: ignore[union-attr]
    assert forward_error(plant, tmp_path) < 5e-3


def forward_error(plant: Plant, folder: Path) -> float:
    """Forces that the plant needs for the motion of the export under given commands, against these, where friction slides."""
    arm = load_module(folder / LOOP).Arm(folder / FILE)
    draw, states, held = np.random.default_rng(3), list[Array](), list[Array]()
    axes = len(plant.machine.axes)
    for _ in range(40):
        q, v = draw.uniform(-1.0, 1.0, (2, axes))
        command = plant_forces(plant, q[None], v[None], draw.uniform(-10.0, 10.0, (1, axes)))[0]
        arm.reset(q, v)
        for _ in range(5):
            arm.step(command)
            states.append(np.array([arm.data.qpos[arm.places], arm.data.qvel[arm.dofs], arm.data.qacc[arm.dofs]]))
            held.append(command)
    q, v, a = np.array(states).transpose(1, 0, 2)
    commands, slides = np.array(held), np.abs(v) > 0.05
    needed = plant_forces(plant, q, v, a)
    sizes = np.sqrt(np.mean(commands**2, axis=0))
    assert slides.mean() > 0.8
    return float((np.sqrt([np.mean((needed - commands)[slides[:, i], i] ** 2) for i in range(axes)]) / sizes).max())


@pytest.mark.parametrize("seed", range(3))
def test_motion_under_forces_is_that_of_the_plant(seed: int, tmp_path: Path) -> None:
    plant = random_arm(seed, 4)
    MJCF.write(plant, RATE, tmp_path)
    assert forward_error(plant, tmp_path) < 1e-4


def shifted(plant: Plant, size: float) -> Plant:
    """A plant with the same torques and inertial parameters that no mass distribution has."""
    model = compile_plant(plant)
    rigid = model.rigid
    assert rigid is not None
    rows = rigid.regressor(*motions(model.axes)).reshape(-1, PARAMETERS * rigid.bodies)
    unseen = np.linalg.svd(rows)[2][np.linalg.matrix_rank(rows, 1e-9) :]
    nowhere = unseen.T @ unseen[:, 0]  # as much as possible of the first mass, without a torque
    change = (-size * nowhere / nowhere[0]).reshape(-1, PARAMETERS)
    for k, body in enumerate(rigid.body_of):
        row = change[body]
        values = {"mass": row[0], "first_moment": list(row[1:4]), "inertia": list(row[4:]), "rotor": 0.0, "scale": 1.0}
        plant = plant.with_effect(KnownEffect("inertial_error", plant.machine.axis_names[k], values))
    return plant


@pytest.mark.parametrize("size", [5.0, 50.0])
def test_inertial_parameters_of_no_body_become_those_of_one(size: int, tmp_path: Path) -> None:
    """Torques do not determine all parameters: the least-squares values of the others may be those of no body."""
    plant = shifted(two_links(), size)
    model = compile_plant(plant)
    assert not all(map(is_admissible, inertial_parameters(model, model.theta)))
    assert arm_inertia(plant).change < 1e-4
    MJCF.write(plant, RATE, tmp_path)
    q, v, a = motions(2)
    found = MJCF.simulation(plant, tmp_path).forces(q, v, a)  # type: ignore[union-attr]
    assert relative(found, plant_forces(plant, q, v, a)) < 1e-3


def test_what_a_body_can_have() -> None:
    rod = np.array([2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.6])
    point = np.array([2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.5])
    assert is_admissible(rod)
    assert is_admissible(point)
    assert is_admissible(np.zeros(PARAMETERS))
    assert not is_admissible(point - [0, 0, 0, 0, 0, 0, 1e-3, 0, 0, 0])
    assert not is_admissible(-point)
    np.testing.assert_allclose(inertial(rod).moments, np.diag([0.0, 0.1, 0.1]), atol=1e-8)
    np.testing.assert_allclose(inertial(rod).centre, [0.5, 0.0, 0.0])


def recorded(plant: Plant, seed: int) -> Recording:
    """The forces that a motion needs, with noise."""
    draw, t = np.random.default_rng(seed), np.arange(round(8.0 * RATE)) / RATE
    q, v, a = np.zeros((3, len(t), 2))
    for k in range(2):
        for rate in draw.uniform(0.8, 5.0, 4):
            size, phase = draw.uniform(0.1, 0.3), draw.uniform(0.0, 6.28)
            q[:, k] += size * np.sin(rate * t + phase)
            v[:, k] += size * rate * np.cos(rate * t + phase)
            a[:, k] -= size * rate**2 * np.sin(rate * t + phase)
    force = plant_forces(plant, q, v, a) + draw.normal(0.0, 0.05, q.shape)
    columns = {"time": t}
    for k, axis in enumerate(plant.machine.axis_names):
        columns |= {f"{axis}.command": force[:, k], f"{axis}.joint": q[:, k] + draw.normal(0.0, 1e-5, len(t))}
    return Recording(f"r{seed}", pd.DataFrame(columns), RATE)


def dataset(plant: Plant) -> Dataset:
    machine = replace(plant.machine, rate_hz=RATE)
    return Dataset.of(machine, [recorded(plant, 0), recorded(plant, 1)], {"r0": "fit", "r1": "held_out"})


def test_an_arm_is_exported_with_the_replay_of_its_forces(tmp_path: Path) -> None:
    plant = two_links(SCALED, KnownEffect("load_dependent_friction", "lift", {"coefficient": 0.1}))
    made = export_plant(plant, dataset(plant), MJCF, tmp_path / "out")
    assert made.files[:3] == (FILE, "robot.json", LOOP)
    assert made.replay is not None
    assert made.replay.kind == "forces"
    assert {row.signal: row.agrees for row in made.replay.rows} == dict.fromkeys(
        ("lift.command", "elbow.command", "ee.x", "ee.y", "ee.z"), True
    )
    for row in made.replay.rows[:2]:
        assert row.difference < 1e-3 * row.motion
        assert row.export_error == pytest.approx(0.05, rel=0.7), "the noise, under the filter"
    page = (made.folder / PAGE).read_text("utf-8")
    assert "Forces that the measured motion of r1 (8 s) needs" in page
    assert "| Payload (`payload`) | tool | mass 1.3 kg; centre 0.02, 0.01, 0.05 m | native | body `payload`" in page
    assert made.lacking == ()


def test_an_arm_whose_forces_differ_is_refused(tmp_path: Path) -> None:
    """A torque of the plant at the angle of the sensor is one at that of the link in MuJoCo."""
    plant = two_links(KnownEffect("joint_offset", "lift", {"offset": 0.5}))
    with pytest.raises(SettingsError, match=r"lift\.command differs from the plant by .* expected an export that agrees"):
        export_plant(plant, dataset(plant), MJCF, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


class Weaker:
    """An export whose actuators are 5 % weaker than its inverse dynamics say."""

    def __init__(self, arm: MujocoArm) -> None:
        self.forces, self.tips, self.arm = arm.forces, arm.tips, arm

    def run(self, joints: Array, speeds: Array, commands: Array) -> tuple[Array, Array, Array]:
        return self.arm.run(joints, speeds, 0.95 * commands)


def test_the_motion_under_commands_is_part_of_the_replay(tmp_path: Path) -> None:
    plant = two_links()
    MJCF.write(plant, RATE, tmp_path)
    arm, recordings = MujocoArm(tmp_path), dataset(plant).with_role("held_out")
    whole, weak = force_replay(plant, arm, recordings, {}), force_replay(plant, Weaker(arm), recordings, {})
    assert whole.agrees
    assert [row.signal for row in weak.rows if not row.agrees] == ["lift.command", "elbow.command"]
    for row, other in zip(whole.rows, weak.rows, strict=True):
        assert (row.export_error, row.plant_error) == pytest.approx((other.export_error, other.plant_error), nan_ok=True)


@pytest.mark.parametrize("name", [target.name for target in TARGETS if not target.arms])
def test_other_targets_have_no_arms(name: str, tmp_path: Path) -> None:
    plant = two_links()
    with pytest.raises(SettingsError, match=rf"to {name}: force axes that move links with masses.*--to mjcf writes"):
        export_plant(plant, dataset(plant), target_named(name), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_what_an_arm_cannot_have(tmp_path: Path) -> None:
    plant = two_links(KnownEffect("gripper_sway", "tool", {"length": 0.3, "damping_ratio": 0.1}))
    with pytest.raises(SettingsError, match=r"gripper_sway on tool in an arm with masses; expected friction, forces, masses"):
        MJCF.write(plant, RATE, tmp_path)
    text = probe_arm().text.replace('actuation = "force"', 'actuation = "position"', 1)
    mixed = machine_from_files({**probe_arm().files(), "machine.toml": text}, "mixed")
    with pytest.raises(SettingsError, match="lift beside force axes that move links with masses"):
        MJCF.write(nominal_plant(mixed), RATE, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_numbers_are_written_in_full(tmp_path: Path) -> None:
    """Of machines without masses, too: MuJoCo's own six digits change a time step."""
    plant = probe_plant(KnownEffect("first_order_lag", "boom", {"time_constant": 1.0 / 30.0}))
    MJCF.write(plant, 60.0, tmp_path)
    model: Any = mujoco.MjModel.from_xml_path(str(tmp_path / FILE))
    assert model.opt.timestep * 17 == pytest.approx(1.0 / 60.0, rel=1e-14)
    assert model.actuator("boom").dynprm[0] == pytest.approx(1.0 / 30.0, rel=1e-14)
