"""Tracking: error at t + 1 against the target at t + 1; baselines in the paper's setting and on the full path."""

from __future__ import annotations

from pathlib import Path as File

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from crane_model import Perfect, crane_plant

from sysid.errors import InputError, SettingsError
from sysid.machine import KnownEffect
from sysid_rl.control import proportional_tuning
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.paths import Path, helix
from sysid_rl.train.record import pictures, table, write_results
from sysid_rl.train.task import Task
from sysid_rl.train.tracking import InversePolicy, track, track_environment
from sysid_rl.train.tracking_task import TrackingTask, TruncatedObservationPolicy, plan_tracking

Array = npt.NDArray[np.float64]
PLANT = crane_plant(
    KnownEffect("valve_deadband", "boom", {"positive": 0.12, "negative": 0.10}),
    KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}),
)
CENTRE = (0.85, 0.0, 0.3)


@pytest.fixture(scope="module")
def still() -> TrackingTask:
    return plan_tracking(PLANT, Perfect(PLANT), "helix", centre=CENTRE)


@pytest.fixture(scope="module")
def driven() -> TrackingTask:
    return plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=CENTRE)


def test_with_a_perfect_static_plant_inverse_kinematics_is_exact(still: TrackingTask) -> None:
    run = still.baseline("ik")
    assert len(run.time) == 3000
    np.testing.assert_array_equal(run.target, still.path.points[1:])
    assert run.worst.max() < 1e-6
    assert np.isnan(run.tool).all()


def test_the_error_is_that_of_the_next_sample() -> None:
    """A policy that stays where it is: every step is off by the whole way of the path."""

    class Stay:
        def act(self, observations: Array) -> Array:
            return observations[:, :4]

    points = np.linspace([0.85, 0.0, 0.3], [0.85, 0.05, 0.3], 6)
    path = Path("line", 100.0, points)
    course = plan_tracking(PLANT, Perfect(PLANT), "helix", centre=CENTRE)
    start, _ = course.inverse.reach(points[0], np.random.default_rng(0))
    run = track(track_environment(PLANT, Perfect(PLANT), path), Stay(), path, start)
    np.testing.assert_allclose(run.error[:, 1], -0.01 * np.arange(1, 6), atol=1e-6)
    assert run.to_json()["max_mm"][1] == pytest.approx(50.0, abs=1e-3)
    assert run.to_json()["settled"] is None


def test_on_the_full_path_look_ahead_takes_the_dead_time_away(driven: TrackingTask) -> None:
    assert driven.dead_time == pytest.approx(0.11)
    plain, ahead = driven.baseline("ik").after(1.0), driven.baseline("ik-lookahead").after(1.0)
    assert plain.rmse.max() < 2e-3
    assert (ahead.rmse[:2] < 0.6 * plain.rmse[:2]).all()
    assert np.isfinite(plain.tool).all()
    assert np.abs(plain.commands).max() <= 1.0


def test_what_a_path_asks_of_each_axis_is_said(driven: TrackingTask, tmp_path: File) -> None:
    assert set(driven.demand) == {"slew", "boom", "stick", "telescope"}
    assert 0.3 < max(driven.demand.values()) < 1.0
    fast = tmp_path / "fast.csv"
    fast.write_text("t,x,y,z\n0,0.85,-0.2,0.3\n0.5,0.85,0.2,0.3\n", "utf-8")
    course = plan_tracking(PLANT, Perfect(PLANT), str(fast), full=True)
    assert course.demand["slew"] > 1.5
    assert course.baseline("ik").worst.max() > 0.05


def test_the_low_level_controller_decides(driven: TrackingTask) -> None:
    poor = plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=CENTRE, tuning=proportional_tuning(PLANT))
    assert poor.baseline("ik").after(1.0).rmse.max() > 20.0 * driven.baseline("ik").after(1.0).rmse.max()


def test_a_controller_that_feeds_nothing_forward_is_not_told_to_wait() -> None:
    """What is shown to it ahead makes up for some of its lag, instead of being kept until it is due."""
    poor = plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=CENTRE, tuning=proportional_tuning(PLANT))
    late, ahead = (poor.baseline(name).after(1.0).to_json()["distance_mm"]["rms"] for name in ("ik", "ik-lookahead"))
    assert ahead < 0.9 * late


def test_a_policy_of_the_papers_setting_may_drive_the_full_path(driven: TrackingTask) -> None:
    class Ten:
        inputs = tuple(f"number {k}" for k in range(10))

        def __init__(self) -> None:
            self.inner = InversePolicy(driven.inverse)

        def act(self, observations: Array) -> Array:
            assert observations.shape == (1, 10)
            return self.inner.act(observations)

    run = driven.run("ten", TruncatedObservationPolicy(Ten()))
    assert run.policy == "ten"
    assert run.rmse.max() < 5e-3


def test_what_is_kept_can_be_looked_at(driven: TrackingTask, tmp_path: File) -> None:
    runs = [driven.baseline("ik")]
    files = write_results(tmp_path / "run", PLANT.machine, runs)
    assert {"steps of ik", "from above", "error ik", "rerun"} <= set(files)
    rows = pd.read_csv(files["steps of ik"])
    assert list(rows.columns) == list(table(PLANT.machine, runs[0]).columns)
    assert {"time", "target.x", "ee.z", "tool.y", "boom.joint", "boom.setpoint", "boom.command"} <= set(rows.columns)
    np.testing.assert_allclose(rows["ee.x"], runs[0].ee[:, 0], atol=1e-6)
    assert files["rerun"].stat().st_size > 10_000
    assert all(text.startswith("<svg") for text in pictures(runs).values())


def test_mistakes_are_named(still: TrackingTask, driven: TrackingTask) -> None:
    path = helix(CENTRE)
    policy = InversePolicy(still.inverse)
    with pytest.raises(SettingsError, match=r"a look-ahead of 0\.11 s where joints follow at once"):
        still.baseline("ik-lookahead")
    with pytest.raises(SettingsError, match="expected 'ik-lookahead'"):
        driven.baseline("ik-look")
    with pytest.raises(SettingsError, match="an episode of 1000 steps; expected more than the 3000 of helix"):
        track(KinematicEnvironment(PLANT, Perfect(PLANT)), policy, path, still.start)
    with pytest.raises(SettingsError, match="2 copies; expected one"):
        track(KinematicEnvironment(PLANT, Perfect(PLANT), size=2, task=Task(steps=4000)), policy, path, still.start)
    with pytest.raises(SettingsError, match="expected 'helix'"):
        plan_tracking(PLANT, Perfect(PLANT), "hellix")
    with pytest.raises(SettingsError, match=r"a path at 50\.0 Hz; expected 100\.0 Hz"):
        track(track_environment(PLANT, Perfect(PLANT), path), policy, helix(CENTRE, 50.0), still.start)

    class Wrong:
        def act(self, observations: Array) -> Array:
            return observations[:, :3]

    with pytest.raises(InputError, match=r"the policy answers with shape \(1, 3\); expected \(1, 4\)"):
        still.run("wrong", Wrong())
