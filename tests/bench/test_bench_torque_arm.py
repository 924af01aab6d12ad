"""The arm of geared motors: its torques are those of its URDF, and its hidden parts act as they say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulated_bench.__main__ import main
from simulated_bench.joint_machines import load_joint_machine, write_joint_machine
from simulated_bench.joint_recipe import Take
from simulated_bench.torque_arm import GRAVITY, Motor, TorqueArm, run_torque_arm, torques
from sysid.errors import SettingsError
from sysid.logs.csv import CsvReader
from sysid.logs.reader import ReadOptions
from sysid.machine import load_machine

MOTORS = (
    Motor("column", (-2.5, 2.5), 0.4, 6.0, rotor=0.9, constant=12.0),
    Motor("shoulder", (-0.4, 1.8), 0.5, 5.0, rotor=0.9, constant=12.0),
    Motor("elbow", (-2.2, 0.4), 0.4, 3.0, rotor=0.4, constant=8.0),
)
TAKE = Take("one", 1, 20.0)
ARM = TorqueArm("torque_arm", "arm", 7, MOTORS, (TAKE,))


def motion(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, v, a = np.random.default_rng(seed).normal(size=(3, 40, 3))
    return q, v, a


def test_torques_are_those_of_the_inverse_dynamics_of_its_urdf(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio", reason="the extra dynamics is not installed")
    from sysid.machine.rigid_body import rigid_body

    write_joint_machine(ARM, tmp_path)
    body = rigid_body(load_machine(tmp_path / "machine.toml"))
    assert body is not None
    q, v, a = motion(0)
    rotors = a * np.array([motor.rotor for motor in MOTORS])
    expected = body.torque(q, v, a, body.nominal)[:, :3] + rotors
    np.testing.assert_allclose(torques(ARM, q, v, a), expected, atol=2e-4)  # the rods of the URDF are not infinitely thin


def test_a_payload_is_carried_by_both_links_and_friction_opposes_the_motion() -> None:
    still = np.zeros((1, 3))
    carried = torques(replace(ARM, payload=2.0), still, still, still) - torques(ARM, still, still, still)
    np.testing.assert_allclose(carried, [[0.0, 2.0 * GRAVITY * 0.9, 2.0 * GRAVITY * 0.4]])
    rough = replace(ARM, axes=tuple(replace(motor, coulomb=3.0, viscous=2.0) for motor in MOTORS))
    q, v, a = motion(1)
    np.testing.assert_allclose(torques(rough, q, v, a) - torques(ARM, q, v, a), 3.0 * np.sign(v) + 2.0 * v)


def test_the_power_of_the_motors_is_the_change_of_energy() -> None:
    """Along a path, the work of the torques without friction is what kinetic and potential energy gain."""
    arm = replace(ARM, payload=1.0, rate=1000.0)
    _, current, q = run_torque_arm(arm, Take("fine", 3, 10.0))
    v = np.gradient(q, 1e-3, axis=0)
    torque = current * np.array([motor.constant for motor in MOTORS])
    work = np.cumsum((torque * v).sum(axis=1))[4:-4] * 1e-3
    ends = []
    for k in (4, -5):
        rest = torques(arm, q[k : k + 1] if k > 0 else q[k:][:1], 0 * v[:1], 0 * v[:1])
        unit = [torques(arm, q[k:][:1], 0 * v[:1], np.eye(3)[j][None])[0] - rest[0] for j in range(3)]
        own = v[k:][0]
        low, high = q[k:][0, 1], q[k:][0, 1] + q[k:][0, 2]
        height = (5.0 * 0.25 + 4.0 * 0.5) * np.sin(low) + (3.0 * 0.2 + 1.0 * 0.4) * np.sin(high)
        ends.append(0.5 * own @ np.array(unit) @ own + GRAVITY * height)
    assert work[-1] - work[0] == pytest.approx(ends[1] - ends[0], abs=0.15)


def test_its_files_are_read_by_the_toolkit(tmp_path: Path) -> None:
    recipe = tmp_path / "arm.toml"
    axes = "".join(
        f'[[axes]]\nname = "{m.name}"\nlimits = [{m.limits[0]}, {m.limits[1]}]\nlength = {m.length}\nmass = {m.mass}\n'
        f"rotor = {m.rotor}\nconstant = {m.constant}\n"
        for m in MOTORS
    )
    recipe.write_text(
        f'kind = "torque_arm"\nname = "arm"\nseed = 1\n{axes}[[recordings]]\nname = "one"\nseed = 1\nseconds = 2.0\n', "utf-8"
    )
    assert main([str(recipe), str(tmp_path / "out")]) == 0
    (stream,) = CsvReader().read(tmp_path / "out/one/log.csv", ReadOptions())
    assert set(stream.columns) == {f"{m.name}.{part}" for m in MOTORS for part in ("current", "joint")}
    assert load_machine(tmp_path / "out/machine.toml").axis_names == ("column", "shoulder", "elbow")
    recipe.write_text(recipe.read_text("utf-8").replace("rotor = 0.4", "rotor = 0.0"), "utf-8")
    with pytest.raises(SettingsError, match="no range, length, mass, rotor or constant"):
        load_joint_machine(recipe)
