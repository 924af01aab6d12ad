"""Servo arm and slide: each feature does what it says, and the files are read by the toolkit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulated_bench.__main__ import main
from simulated_bench.joint_machines import load_joint_machine, write_joint_machine
from simulated_bench.joint_recipe import ServoArm, ServoAxis, Slide, Take
from simulated_bench.servo_arm import gravity_moments, run_servo_arm
from simulated_bench.slide import run_slide
from sysid.errors import SettingsError
from sysid.logs.csv import CsvReader
from sysid.logs.reader import ReadOptions
from sysid.machine import load_machine

TAKE = Take("one", 1, 20.0)
SHOULDER = ServoAxis("shoulder", (-0.5, 1.5), 0.3, 1.0)
ARM = ServoArm("servo_arm", "arm", 4, (SHOULDER, ServoAxis("elbow", (-2.0, 0.5), 0.25, 0.6)), (TAKE,))
SLIDE = Slide("slide", "slide", 5, mass=95.0, recordings=(TAKE,), coulomb=20.0, viscous=200.0, static=28.0, offset=-3.2)


def shoulder(**features: float) -> ServoArm:
    return replace(ARM, axes=(replace(SHOULDER, **features), ARM.axes[1]))


def test_neutral_servo_is_where_it_was_told_to_be() -> None:
    _, setpoint, joints = run_servo_arm(ARM, TAKE)
    assert joints[1:] == pytest.approx(setpoint[:-1], abs=1e-12)
    low, high = SHOULDER.limits
    assert low < setpoint[:, 0].min() < setpoint[:, 0].max() < high


def test_servo_features_one_by_one() -> None:
    time, _, exact = run_servo_arm(ARM, TAKE)
    late = run_servo_arm(shoulder(delay=0.05), TAKE)[2]
    assert late[6:, 0] == pytest.approx(exact[1:-5, 0], abs=1e-9)
    slow = run_servo_arm(shoulder(rate_limit=0.8), TAKE)[2]
    assert np.abs(np.diff(slow[:, 0])).max() == pytest.approx(0.8 * 0.01, rel=1e-6)
    lagging = run_servo_arm(shoulder(time_constant=0.1), TAKE)[2]
    area = np.sum((exact - lagging)[:, 0]) * (time[1] - time[0])
    assert area == pytest.approx(0.1 * (lagging[-1, 0] - lagging[0, 0]), abs=2e-3)
    standing_error = run_servo_arm(shoulder(standing_error=0.004), TAKE)[2]
    assert np.abs(standing_error - exact)[:, 0].max() == pytest.approx(0.004, rel=1e-6)
    loose = run_servo_arm(shoulder(backlash=0.01), TAKE)[2]
    assert np.ptp((loose - exact)[:, 0]) == pytest.approx(0.01, rel=1e-6)
    soft = run_servo_arm(shoulder(compliance=2e-3), TAKE)[2]
    assert (exact - soft)[:, 0] == pytest.approx(2e-3 * gravity_moments(ARM, exact)[:, 0], abs=1e-12)
    assert (soft[:, 1] == exact[:, 1]).all()


def test_moments_of_a_horizontal_arm() -> None:
    moments = gravity_moments(ARM, np.zeros((1, 2)))[0]
    assert moments == pytest.approx([9.81 * (1.0 * 0.15 + 0.6 * 0.425), 9.81 * 0.6 * 0.125])


def test_slide_obeys_newton_and_sticks() -> None:
    """Impulse of all forces over the run is the change of momentum; at rest the force stays below break-away."""
    _, force, position = run_slide(SLIDE, TAKE)
    speed = np.gradient(position, 1e-3)
    moving = np.abs(speed) > 0.05
    acceleration = np.gradient(speed, 1e-3)
    friction = 20.0 * np.sign(speed) + 200.0 * speed
    left = force - 95.0 * acceleration - friction + 3.2
    inside = moving & np.roll(moving, 3) & np.roll(moving, -3)
    assert np.median(np.abs(left[inside])) < 1.0
    still = (np.abs(speed) < 1e-9) & (np.arange(len(force)) > 10)
    assert still.mean() > 0.05
    assert np.abs(force[still] + 3.2).max() <= 28.0 + 1.0
    assert np.abs(position).max() < 0.25


def test_slide_on_bristles_gives_way_before_it_slides() -> None:
    """Held by bristles it creeps by their deflection under a force below break-away; rigid friction does not move at all."""
    soft = replace(SLIDE, bristle=2e-4)
    rigid, elastic = run_slide(SLIDE, TAKE), run_slide(soft, TAKE)
    assert not np.array_equal(rigid[2], elastic[2])
    assert np.abs(rigid[2] - elastic[2]).max() < 2e-3
    resting = np.abs(np.gradient(rigid[2], 1e-3)) < 1e-9
    assert np.abs(np.gradient(elastic[2], 1e-3)[resting]).max() > 1e-6
    assert np.abs(elastic[1]).max() == pytest.approx(np.abs(rigid[1]).max(), rel=0.05)


def test_frictionless_slide_follows_its_path_closer() -> None:
    free = replace(SLIDE, coulomb=0.0, static=0.0, viscous=0.0, offset=0.0)
    _, force, _ = run_slide(free, TAKE)
    assert np.abs(force[:900]).max() == 0.0
    assert np.abs(run_slide(SLIDE, TAKE)[1]).mean() > np.abs(force).mean()


@pytest.mark.parametrize(
    "machine", [replace(ARM, noise=1e-4), replace(SLIDE, noise=1e-6, force_noise=0.1)], ids=["arm", "slide"]
)
def test_files_are_read_without_a_recipe(machine: ServoArm | Slide, tmp_path: Path) -> None:
    write_joint_machine(machine, tmp_path)
    described = load_machine(tmp_path / "machine.toml")
    (stream,) = CsvReader().read(tmp_path / "one" / "log.csv", ReadOptions())
    assert set(stream.columns) <= set(described.signals)
    assert len(stream.columns) == 2 * len(described.axes)
    kinds = {axis.actuation for axis in described.axes}
    assert kinds == ({"position"} if isinstance(machine, ServoArm) else {"force"})
    if isinstance(machine, ServoArm):
        kinematics = described.kinematics()
        assert kinematics is not None
        assert kinematics.tip_position(np.array([[0.0, np.pi / 2]]))[0] == pytest.approx([0.3, 0.0, 0.25], abs=1e-9)
    again = tmp_path / "again"
    write_joint_machine(machine, again)
    assert (again / "one" / "log.csv").read_bytes() == (tmp_path / "one" / "log.csv").read_bytes()


SLIDE_TOML = """kind = "slide"
name = "slide"
seed = 1
mass = 95.0
recordings = [{name = "a", seed = 1, seconds = 2.0}]
"""


def test_command_line_takes_either_family(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slide.toml"
    path.write_text(SLIDE_TOML, "utf-8")
    assert main([str(path), str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "a" / "log.csv").is_file()
    assert "log.csv" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("found", "written", "message"),
    [
        ('kind = "slide"', 'kind = "sled"', r"kind: 'sled'; expected 'servo_arm', 'torque_arm' or 'slide'"),
        ("mass = 95.0", "mass = 0.0", "more than zero"),
        ("mass = 95.0", "mass = 95.0\nrate = 300.0", r"300\.0 Hz; expected a rate that divides 1000 Hz"),
        ("mass = 95.0", "mass = 95.0\nviscus = 1.0", "unknown key 'viscus'; expected 'viscous'"),
    ],
)
def test_machine_that_cannot_be_is_refused(tmp_path: Path, found: str, written: str, message: str) -> None:
    path = tmp_path / "slide.toml"
    path.write_text(SLIDE_TOML.replace(found, written), "utf-8")
    with pytest.raises(SettingsError, match=message):
        load_joint_machine(path)
