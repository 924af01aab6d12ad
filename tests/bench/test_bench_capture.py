"""Motion capture: poses that give the joints back, the clock, what goes missing, what is confused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from simulated_bench import BenchRecipe, RecordingSettings, Run, simulate
from simulated_bench.capture import BodyTrack, frame_rotation, quaternions
from simulated_bench.capture_recipe import CaptureSettings, SwapSettings
from simulated_bench.sensors import slew_error

Array = npt.NDArray[np.float64]


def clean(recipe: BenchRecipe) -> CaptureSettings:
    return replace(recipe.capture, noise=0.0, dropouts_per_minute=0.0, swaps=())


def body(run: Run, name: str) -> BodyTrack:
    return next(each for each in run.capture.bodies if each.name == name)


def in_base(run: Run, name: str) -> tuple[Rotation, Array]:
    """Orientation since the parked pose and position of a body, both in the base frame."""
    settings = run.recipe.capture
    frame = Rotation.from_matrix(frame_rotation(settings.rpy))
    track = body(run, name)
    turned = frame * Rotation.from_quat(track.quaternion) * frame.inv()
    return turned, frame.apply(track.position) + np.array(settings.translation)


def true_times(run: Run) -> Array:
    return run.capture.clock.to_machine(run.capture.time) - run.recipe.capture.latency


def test_surveyed_frame_is_fixed_axis_roll_pitch_yaw() -> None:
    rpy = (0.3, -0.7, 1.9)
    assert frame_rotation(rpy) == pytest.approx(Rotation.from_euler("xyz", rpy).as_matrix(), abs=1e-12)


def test_capture_frame_has_y_up(recipe: BenchRecipe) -> None:
    up = frame_rotation(recipe.capture.rpy).T @ [0.0, 0.0, 1.0]
    assert up == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)


def test_quaternions_of_any_rotation() -> None:
    rotations = Rotation.random(500, rng=np.random.default_rng(2))
    ours = quaternions(rotations.as_matrix())
    assert ours[:, 3].min() >= 0.0
    assert (Rotation.from_quat(ours) * rotations.inv()).magnitude() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("recording", ["manual-04", RecordingSettings("poses", seed=3, poses=10)])
def test_bodies_give_joints_and_points_back(recipe: BenchRecipe, recording: str | RecordingSettings) -> None:
    """Relative rotations since the parked pose are the joint angles; the moved pivots are boom tip and tool."""
    run = simulate(replace(recipe, capture=clean(recipe)), recording)
    times = true_times(run)
    joints = run.truth.at(times, run.truth.joint)
    column, boom, stick = (in_base(run, name)[0] for name in ("column_body", "boom_body", "stick_body"))
    assert column.as_rotvec()[:, 2] == pytest.approx(joints[:, 0], abs=1e-9)
    park = [recipe.axis(name).park for name in ("boom", "stick")]
    for parent, child, start, angle in ((column, boom, park[0], joints[:, 1]), (boom, stick, park[1], joints[:, 2])):
        turned = (parent.inv() * child).as_rotvec()
        assert -turned[:, 1] + start == pytest.approx(angle, abs=1e-9)
        assert turned[:, [0, 2]] == pytest.approx(np.zeros((len(turned), 2)), abs=1e-9)
    for name, points in (("tip_body", run.truth.ee), ("gripper_body", run.truth.tool)):
        # Between the kept states the truth is interpolated: a chord instead of the arc.
        assert in_base(run, name)[1] == pytest.approx(run.truth.at(times, points), abs=1e-6)


def test_bodies_are_created_in_the_parked_pose(manual: Run) -> None:
    still = manual.capture.time < 1.2
    for track in manual.capture.bodies:
        assert Rotation.from_quat(track.quaternion[still]).mean().magnitude() < 6e-4
        assert np.nanmean(track.marker_error) == pytest.approx(1.5e-4, rel=0.3)


def test_noise_of_the_exported_poses_is_what_the_description_says(manual: Run) -> None:
    """Measured minus true, of quantities that ``[noise]`` of the shipped machine.toml lists."""
    from pathlib import Path

    from sysid.machine import load_machine

    stated = load_machine(Path(__file__).parents[2] / "datasets" / "autolog" / "machine.toml").noise
    times = true_times(manual)
    joints = manual.truth.at(times, manual.truth.joint)
    seen = ~np.any([np.isnan(track.marker_error) for track in manual.capture.bodies], axis=0)
    bodies = {}
    for track in manual.capture.bodies:
        filled = np.where(seen[:, None], track.quaternion, [0.0, 0.0, 0.0, 1.0])
        frame = Rotation.from_matrix(frame_rotation(manual.recipe.capture.rpy))
        bodies[track.name] = frame * Rotation.from_quat(filled) * frame.inv()
    slew = bodies["column_body"].as_rotvec()[seen, 2] - joints[seen, 0]
    boom = -(bodies["column_body"].inv() * bodies["boom_body"]).as_rotvec()[seen, 1] - joints[seen, 1]
    stick = -(bodies["boom_body"].inv() * bodies["stick_body"]).as_rotvec()[seen, 1] - joints[seen, 2]
    for signal, error in (("slew.joint", slew), ("boom.joint", boom), ("stick.joint", stick)):
        assert np.std(error) == pytest.approx(stated[signal], rel=0.15), signal
    for point, name, points in (("ee", "tip_body", manual.truth.ee), ("tool", "gripper_body", manual.truth.tool)):
        error = (in_base_seen(manual, name, seen) - manual.truth.at(times, points)[seen]).ravel()
        assert np.std(error) == pytest.approx(stated[f"{point}.x"], rel=0.2), point
    wires = manual.log.wires[:, 0] - manual.truth.drive[::10, 1]
    assert np.std(wires) == pytest.approx(stated["boom.cylinder"], rel=0.05)


def in_base_seen(run: Run, name: str, seen: npt.NDArray[np.bool_]) -> Array:
    settings = run.recipe.capture
    return np.asarray(body(run, name).position[seen] @ frame_rotation(settings.rpy).T + np.array(settings.translation))


def test_clock_offset_skew_and_latency_move_the_stamps(recipe: BenchRecipe) -> None:
    """The same instant of a fast slew is found on the capture clock where the relation says."""
    run = simulate(replace(recipe, capture=replace(clean(recipe), offset=(0.8, 0.8), skew=150.0)), "manual-04")
    yaw = in_base(run, "column_body")[0].as_rotvec()[:, 2]
    angle = run.truth.joint[:, 0]
    level = 0.5 * (angle.max() + angle.min())
    truth_time = run.truth.time[np.flatnonzero(np.diff(np.sign(angle - level)))[0]]
    index = np.flatnonzero(np.diff(np.sign(yaw - level)))[0]
    share = (level - yaw[index]) / (yaw[index + 1] - yaw[index])
    stamp = run.capture.time[index] + share * (run.capture.time[index + 1] - run.capture.time[index])
    expected = (truth_time + recipe.capture.latency - 0.8) / (1.0 + 150e-6)
    assert stamp == pytest.approx(expected, abs=2e-3)


def test_hidden_bodies_leave_gaps_of_the_stated_length(recipe: BenchRecipe) -> None:
    run = simulate(replace(recipe, capture=replace(recipe.capture, dropouts_per_minute=20.0)), "manual-02")
    assert len(run.capture.dropouts) >= 10
    for dropout in run.capture.dropouts:
        assert 0.1 <= dropout.end - dropout.start <= 1.0
        assert dropout.start >= recipe.operator.parked, "the reference pose is seen whole"
        gone = (run.capture.time >= dropout.start) & (run.capture.time < dropout.end)
        track = body(run, dropout.body)
        for values in (track.quaternion, track.position, track.marker_error, track.markers):
            assert np.isnan(values[gone]).all()
    missing = sum(np.isnan(track.marker_error).any() for track in run.capture.bodies)
    assert missing >= 2


def test_swapped_markers_throw_the_body_and_raise_its_error(recipe: BenchRecipe) -> None:
    swap = SwapSettings("manual-03", "tip_body", (0, 2), 20.0, 0.5)
    confused = simulate(replace(recipe, capture=replace(clean(recipe), swaps=(swap,))), "manual-03")
    right = simulate(replace(recipe, capture=clean(recipe)), "manual-03")
    during = (right.capture.time >= 20.0) & (right.capture.time < 20.5)
    jump = np.linalg.norm(body(confused, "tip_body").position - body(right, "tip_body").position, axis=1)
    assert jump[during].min() > 0.05
    assert jump[~during].max() == 0.0
    assert body(confused, "tip_body").marker_error[during].min() > 0.01
    assert np.array_equal(body(confused, "boom_body").position, body(right, "boom_body").position)


def test_routine_exports_only_still_frames(routine: Run) -> None:
    times = routine.capture.clock.to_machine(routine.capture.time)
    phase = np.searchsorted(routine.truth.still.ravel(), times)
    assert (phase % 2 == 1).all()
    assert len(np.unique(phase)) == len(routine.truth.still)
    assert routine.capture.time == pytest.approx(routine.capture.frames / routine.capture.rate)


def test_slewing_sensor_is_smooth_periodic_and_within_its_error() -> None:
    angle = np.linspace(-np.pi, np.pi, 2000)
    error = slew_error(angle, np.deg2rad(0.8))
    assert np.abs(error).max() <= np.deg2rad(0.8)
    assert np.abs(error).max() > np.deg2rad(0.6)
    assert error[0] == pytest.approx(error[-1], abs=1e-12)
    assert np.abs(np.gradient(error, angle)).max() < 0.03
