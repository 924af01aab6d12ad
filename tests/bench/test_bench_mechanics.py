"""Linkages, end stops, play, kinematics; the last against the machine description that ships beside the recipe."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_bench import AXES, BenchRecipe, load_recipe
from simulated_bench.crane import link_poses, tip_position
from simulated_bench.cylinder import drive_of, joint_of, position_of, within_stops
from simulated_bench.drivetrain import follow_with_backlash
from sysid.machine import load_machine

AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"


@pytest.mark.parametrize("name", ["boom", "stick"])
def test_linkage_closes_over_the_whole_stroke(recipe: BenchRecipe, name: str) -> None:
    axis = recipe.axis(name)
    drive = drive_of(axis)
    strokes = np.linspace(drive.low, drive.high, 400)
    joints = np.array([joint_of(stroke, drive) for stroke in strokes])
    assert np.all(drive.sense * np.diff(joints) > 0.0), "one displacement, one angle"
    assert [position_of(joint, drive) for joint in joints] == pytest.approx(strokes, abs=1e-12)
    assert sorted((joints[0], joints[-1])) == pytest.approx(axis.limits, abs=np.deg2rad(0.3))


def test_parked_pose_lies_inside_every_stroke(recipe: BenchRecipe) -> None:
    for name in AXES:
        axis = recipe.axis(name)
        drive = drive_of(axis)
        assert drive.low < position_of(axis.park, drive) < drive.high


@given(st.floats(-2.0, 2.0), st.floats(-1.0, 0.0), st.floats(0.1, 1.0))
def test_end_stops_hold(position: float, low: float, high: float) -> None:
    held = within_stops(position, low, high)
    assert low <= held <= high
    assert held == position or position < low or position > high


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=40), st.floats(0.0, 0.5))
def test_play_never_exceeds_its_width_and_holds_inside_it(path: list[float], width: float) -> None:
    structure = 0.0
    for drive in path:
        before = structure
        structure = follow_with_backlash(structure, drive, width)
        assert abs(drive - structure) <= 0.5 * width + 1e-12
        if abs(drive - before) <= 0.5 * width:
            assert structure == before, "the structure stands still while the drive crosses the play"


def test_play_lags_a_slow_swing_by_its_width() -> None:
    drive = np.sin(np.linspace(0.0, 6.0 * np.pi, 3000))
    structure = np.zeros_like(drive)
    for k in range(1, len(drive)):
        structure[k] = follow_with_backlash(structure[k - 1], drive[k], 0.2)
    settled = structure[1000:]
    assert np.ptp(settled) == pytest.approx(2.0 - 0.2, abs=1e-4)


def test_kinematics_agree_with_the_shipped_urdf(recipe: BenchRecipe) -> None:
    machine = load_machine(AUTOLOG / "machine.toml")
    kinematics = machine.kinematics()
    assert kinematics is not None
    rng = np.random.default_rng(0)
    limits = np.array([recipe.axis(name).limits for name in AXES])
    joints = rng.uniform(limits[:, 0], limits[:, 1], (200, 4))
    geometry = recipe.geometry
    tips = np.array([tip_position(*joint, geometry.height, geometry.boom, geometry.stick) for joint in joints])
    assert kinematics.tip_position(joints) == pytest.approx(tips, abs=1e-9)
    ours = link_poses(geometry, joints, np.tile([0.0, 0.0, -0.22], (200, 1)))
    theirs = kinematics.link_poses(joints)
    for link in ("column", "boom", "stick", "tip"):
        assert theirs[link][:, :3, :3] == pytest.approx(ours[link][0], abs=1e-9), link
        assert theirs[link][:, :3, 3] == pytest.approx(ours[link][1], abs=1e-9), link


def test_description_and_bench_recipe_state_the_same_machine() -> None:
    """Everything visible matches; what the recipe hides is not in the description."""
    recipe, machine = load_recipe(AUTOLOG / "bench.toml"), load_machine(AUTOLOG / "machine.toml")
    assert machine.axis_names == AXES
    hidden = {(item.name, item.target) for item in recipe.hidden}
    known = {(effect.name, effect.target): effect.parameters for effect in machine.effects}
    for name in AXES:
        axis, settings = machine.axis(name), recipe.axis(name)
        assert axis.gain == settings.valve.gain
        assert axis.limits == pytest.approx(settings.limits, abs=1e-6)
        if settings.cylinder is not None:
            assert axis.stroke == (0.0, settings.cylinder.stroke)
        valve = settings.valve
        assert known["input_delay", name] == {"delay": valve.delay}
        assert known["first_order_lag", name] == {"time_constant": valve.time_constant}
        if ("valve_deadband", name) not in hidden:
            overlap = {"positive": valve.deadband_positive, "negative": valve.deadband_negative}
            assert known["valve_deadband", name] == overlap
    assert not hidden & set(known)


def test_hanging_gripper_points_along_its_rod(recipe: BenchRecipe) -> None:
    rng = np.random.default_rng(1)
    joints = np.column_stack([rng.uniform(-2.0, 2.0, 50), np.full(50, 0.4), np.full(50, -1.0), np.full(50, 0.1)])
    rod = rng.normal([0.0, 0.0, -0.2], 0.05, (50, 3))
    rotation, origin = link_poses(recipe.geometry, joints, rod)["gripper"]
    down = rod / np.linalg.norm(rod, axis=1, keepdims=True)
    assert -rotation[:, :, 2] == pytest.approx(down, abs=1e-12)
    tip = link_poses(recipe.geometry, joints, rod)["tip"][1]
    assert origin - tip == pytest.approx(rod, abs=1e-12)
