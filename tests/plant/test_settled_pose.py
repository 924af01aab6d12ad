"""Sag in static equilibrium: the gravity loads are those of the deflected posture, of poses, servos and machines at rest.

The reference is MuJoCo: torsion springs between set-points and joints, simulated until the arm rests.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from sagging_servo import AXES, LENGTH, MASS, RATE_HZ, machine_files

from sysid.datasets.recording import Recording
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, compile_plant, free_run, nominal_plant
from sysid.plant.stepper import Stepper
from sysid_rl.train.reach import tips
from tests.helpers.pose_sets import Arm, Hidden, pose_set
from tests.helpers.pose_sets import tips as tips_of

Array = npt.NDArray[np.float64]
#: Sag of up to 24°: the loads of the straight and the deflected posture differ by half.
SOFT = {"shoulder": 0.5, "elbow": 0.9}
SETPOINTS = np.array([[0.3, 0.4, -0.5], [0.0, -0.6, 1.2], [-1.0, 1.3, 0.4], [0.7, 0.0, 0.0]])


def at_rest(setpoint: Array) -> tuple[Array, Array]:
    """Joints (3,) and tip (3,) of the arm whose joints hang on springs from their set-points, simulated until it rests."""
    body = ""
    for k, (name, at, axis) in enumerate(
        zip(AXES, ("0 0 .1", "0 0 .02", f"{LENGTH[0]} 0 0"), ("0 0 1", "0 -1 0", "0 -1 0"), strict=True)
    ):
        spring = f'stiffness="{1.0 / SOFT[name]}" springref="{setpoint[k]}" damping=".1"' if name in SOFT else 'damping="1"'
        body += f'<body pos="{at}"><joint name="{name}" axis="{axis}" ref="0" {spring}/>'
        if k:
            body += f'<inertial pos="{LENGTH[k - 1] / 2} 0 0" mass="{MASS[k - 1]}" diaginertia="1e-3 1e-3 1e-3"/>'
        else:
            body += '<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>'
    body += f'<site name="tip" pos="{LENGTH[1]} 0 0"/>' + "</body>" * len(AXES)
    option = '<option gravity="0 0 -9.80665" timestep=".002" integrator="implicit"/>'
    text = f'<mujoco><compiler angle="radian"/>{option}<worldbody>{body}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = setpoint
    mujoco.mj_step(model, data, 10_000)
    assert np.abs(data.qvel).max() < 1e-12
    mujoco.mj_forward(model, data)
    return data.qpos.copy(), data.site("tip").xpos.copy()


@pytest.fixture(scope="module")
def equilibria() -> tuple[Array, Array]:
    found = [at_rest(setpoint) for setpoint in SETPOINTS]
    return np.array([joints for joints, _ in found]), np.array([tip for _, tip in found])


def plant_of(side: str) -> Plant:
    plant = nominal_plant(machine_from_files(machine_files(True), "servos"))
    for axis, compliance in SOFT.items():
        plant = plant.with_effect(KnownEffect("joint_compliance", axis, {"compliance": compliance}, side))
    return plant


def held(joints: Array, commands: Array, count: int) -> Recording:
    table = {"time": np.arange(count) / RATE_HZ}
    for k, axis in enumerate(AXES):
        table |= {f"{axis}.command": np.full(count, commands[k]), f"{axis}.joint": np.full(count, joints[k])}
    return Recording("held", pd.DataFrame(table), RATE_HZ)


def test_the_reference_sags_far(equilibria: tuple[Array, Array]) -> None:
    assert np.abs(equilibria[0] - SETPOINTS).max() > 0.3


def test_poses_settle_in_the_equilibrium(equilibria: tuple[Array, Array]) -> None:
    """Encoders at the motors, behind which the structure deflects."""
    plant = plant_of("structure")
    table = {"time": np.arange(len(SETPOINTS)) / RATE_HZ, **{f"{axis}.joint": SETPOINTS[:, k] for k, axis in enumerate(AXES)}}
    model = compile_plant(plant)
    found = model.tip(model.theta[None], Recording("poses", pd.DataFrame(table), RATE_HZ, "poses"))[0]
    np.testing.assert_allclose(found, equilibria[1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(tips(model, SETPOINTS), equilibria[1], rtol=0.0, atol=1e-9)
    for setpoint, place in zip(SETPOINTS, equilibria[1], strict=True):
        np.testing.assert_allclose(Stepper(plant, RATE_HZ).reset(setpoint).ee[0], place, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("row", range(len(SETPOINTS)))
def test_servos_hold_the_equilibrium_from_the_first_sample_on(equilibria: tuple[Array, Array], row: int) -> None:
    """Encoders behind the springs: alone from the measured posture, and all axes without it."""
    joints, place = equilibria[0][row], equilibria[1][row]
    recording, plant = held(joints, SETPOINTS[row], 30), plant_of("drive")
    model, run = compile_plant(plant), free_run(plant, recording)
    for k, axis in enumerate(AXES):
        alone = model.drive(model.theta[None], recording, axis)[0]
        np.testing.assert_allclose(alone, joints[k], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(run[f"{axis}.joint"], joints[k], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(run[[f"ee.{c}" for c in "xyz"]], np.tile(place, (30, 1)), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("side", ["drive", "structure"])
def test_a_stepper_rests_at_the_joints_that_it_was_put_at(equilibria: tuple[Array, Array], side: str) -> None:
    stepper = Stepper(plant_of(side), RATE_HZ)
    first = stepper.reset(SETPOINTS[1])
    np.testing.assert_allclose(first.joints[0], SETPOINTS[1], rtol=0.0, atol=1e-9)
    after = stepper.step(first.drive[0])
    np.testing.assert_allclose(after.ee, first.ee, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(after.joints, first.joints, rtol=0.0, atol=1e-9)


def test_slopes_of_the_tip_are_those_of_the_equilibrium() -> None:
    """The fit takes differences of the tip by a compliance; they agree with those of the reference in scipy's rotations."""
    arm, value, step = Arm(), 4e-4, 1e-7
    plant, poses = nominal_plant(arm.machine(1e-4)), pose_set(arm, Hidden(), 15, 0.0, 3)
    joints = np.column_stack([poses.values(f"{name}.joint") for name in arm.names])
    ends, references = [], []
    for compliance in (value - step, value + step):
        soft = [KnownEffect("joint_compliance", f"j{k + 1}", {"compliance": compliance}, "structure") for k in (1, 2)]
        model = compile_plant(plant.with_effect(soft[0]).with_effect(soft[1]))
        ends.append(model.tip(model.theta[None], poses)[0])
        references.append(tips_of(arm, Hidden(compliance={1: compliance, 2: compliance}), joints))
    found, expected = ((after - before) / (2.0 * step) for before, after in (ends, references))
    assert np.abs(expected).max() > 50.0
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())
