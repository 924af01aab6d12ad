"""Servo axes in the MJCF of an export: the same elements, and the motion of the plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from servo_arms import arm_text, commands, drafted

from sysid.errors import SettingsError
from sysid.export.mjcf import MjcfTarget
from sysid.export.target import Start
from sysid.machine import KnownEffect
from sysid.plant import Plant, nominal_plant
from sysid.plant.stepper import Stepper

Array = npt.NDArray[np.float64]

EFFECTS = (
    KnownEffect("stiffness_error", "j0", {"ratio": 0.9}),
    KnownEffect("damping_error", "j1", {"ratio": 1.4}),
    KnownEffect("armature_error", "j2", {"ratio": 2.0}),
    KnownEffect("force_limit", "j1", {"limit": 4.0}),
    KnownEffect("input_delay", "j0", {"delay": 0.024}),
    KnownEffect("first_order_lag", "j2", {"time_constant": 0.03}),
    KnownEffect("coulomb_friction", "j2", {"force": 0.2}),
    KnownEffect("viscous_friction", "j0", {"coefficient": 0.3}),
)


def repaired(folder: Path) -> Plant:
    plant = nominal_plant(drafted(folder, arm_text(3, 4, limited=0.3, rubs=" ")))
    for effect in EFFECTS:
        plant = plant.with_effect(effect)
    return plant


def test_the_written_model_is_drafted_as_the_repaired_machine(tmp_path: Path) -> None:
    plant = repaired(tmp_path)
    MjcfTarget().write(plant, 100.0, tmp_path)
    again = drafted(tmp_path, (tmp_path / "robot.xml").read_text("utf-8"))
    laws = {axis.name: axis for axis in again.axes}
    for axis in plant.machine.axes:
        written = laws[axis.name]
        assert axis.servo is not None
        assert written.servo is not None
        kp = axis.servo.kp * (0.9 if axis.name == "j0" else 1.0)
        kv = axis.servo.kv * (1.4 if axis.name == "j1" else 1.0)
        assert (written.servo.kp, written.servo.kv) == pytest.approx((kp, kv), rel=1e-5)
        limit = 4.0 if axis.name == "j1" else axis.servo.force_limit
        assert written.servo.force_limit == pytest.approx(limit, rel=1e-5)
        assert written.inertia == pytest.approx((axis.inertia or 0.0) * (2.0 if axis.name == "j2" else 1.0), rel=1e-5)
        assert (written.servo.step, written.servo.implicit) == (axis.servo.step, axis.servo.implicit)
    effects = {(e.name, e.target): e.parameters for e in again.effects}
    assert effects["input_delay", "j0"] == {"delay": pytest.approx(0.024)}
    assert effects["coulomb_friction", "j2"] == {"force": pytest.approx(0.2)}
    assert effects["viscous_friction", "j0"] == {"coefficient": pytest.approx(0.3)}
    rubbing = plant.machine.axis("j1").servo, laws["j1"].servo
    assert rubbing[0] is not None
    assert rubbing[1] is not None
    assert rubbing[1].friction_give == pytest.approx(rubbing[0].friction_give, rel=1e-3)
    assert rubbing[1].friction_time == pytest.approx(rubbing[0].friction_time, rel=1e-3)


def run_both(plant: Plant, target: MjcfTarget, folder: Path, count: int) -> tuple[Array, Array]:
    """Joints and end effector of the plant and of its export in ``folder``, (count, 6) each."""
    simulation = target.simulation(plant, folder)
    wanted = commands(3, count, 0.01)
    stepper = Stepper(plant, 100.0)
    stepper.reset(np.zeros(3), commands=wanted[0])
    assert simulation is not None
    simulation.reset(Start(np.zeros(3), np.zeros(3), wanted[0], np.zeros(3)))  # type: ignore[union-attr]
    ours, theirs = np.empty((2, len(wanted), 6))
    for k, row in enumerate(wanted):
        state = stepper.step(row)
        ours[k] = [*state.joints[0], *state.ee[0]]
        theirs[k] = list(simulation.step(row).values())  # type: ignore[union-attr]
    return ours, theirs


def test_it_moves_as_the_plant(tmp_path: Path) -> None:
    plant, target = repaired(tmp_path), MjcfTarget()
    files = target.write(plant, 100.0, tmp_path)
    assert set(files) == {"robot.xml", "robot.json", "mujoco_servos.py"}
    ours, theirs = run_both(plant, target, tmp_path, 1500)
    assert np.sqrt(np.mean((ours - theirs)[:, :3] ** 2, axis=0)).max() < 2e-3 * np.ptp(ours[:, :3])
    assert np.sqrt(np.mean((ours - theirs)[:, 3:] ** 2, axis=0)).max() < 1e-3


def test_backlash_is_a_joint_behind_that_of_the_motor(tmp_path: Path) -> None:
    """It is drafted as it was written, and moves as the plant within a tenth of its width."""
    width, target = 0.02, MjcfTarget()
    plant = nominal_plant(drafted(tmp_path, arm_text(3, 4))).with_effect(
        KnownEffect("backlash", "j1", {"width": width}, "drive")
    )
    target.write(plant, 100.0, tmp_path)
    again = drafted(tmp_path, (tmp_path / "robot.xml").read_text("utf-8"))
    assert again.axis_names == plant.machine.axis_names
    found = [(e.target, e.parameters, e.side) for e in again.effects if e.name == "backlash"]
    assert found == [("j1", {"width": pytest.approx(width)}, "drive")]
    ours, theirs = run_both(plant, target, tmp_path, 1500)
    away = np.sqrt(np.mean((ours - theirs)[:, :3] ** 2, axis=0))
    assert away.max() < 0.1 * width


def test_what_it_cannot_have_is_said(tmp_path: Path) -> None:
    uneven = KnownEffect("coulomb_friction", "j1", {"positive": 0.2, "negative": 0.3})
    plant = nominal_plant(drafted(tmp_path, arm_text(2))).with_effect(uneven)
    with pytest.raises(
        SettingsError, match="coulomb_friction on j1 by direction on servo axes; expected one of armature_error"
    ):
        MjcfTarget().write(plant, 100.0, tmp_path)
