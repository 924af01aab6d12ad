"""A hanging tool that follows and comes to rest: its figures, and the classical policies that do it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from crane_model import Perfect, crane_plant

from sysid.errors import InputError
from sysid.machine import KnownEffect
from sysid_rl.control import CylinderController
from sysid_rl.control.coordinated_motion import motion_limits
from sysid_rl.control.input_shaper import input_shaper
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.train.environment import Policy
from sysid_rl.train.paths import Path
from sysid_rl.train.planned import CoordinatedPolicy, ShapedPolicy
from sysid_rl.train.tool_figures import TOLERANCE, tool_figures
from sysid_rl.train.tracking import InversePolicy, TrackingResult, track, track_environment
from sysid_rl.train.tracking_task import TrackingTask, plan_tracking

Array = npt.NDArray[np.float64]
PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))
PENDULUM = pendulum_of(PLANT)
BEGIN, END = np.array([-0.2, 0.5, -1.3, 0.1]), np.array([0.4, 0.4, -1.1, 0.15])


def result(target: Array, ee: Array, tool: Array) -> TrackingResult:
    n = len(target)
    none = np.zeros((n, 4))
    return TrackingResult("p", "path", 0.0, (1.0 + np.arange(n)) / 100.0, target, ee, none, none, tool, none)


def made_up() -> TrackingResult:
    """A target that moves for 100 samples and rests for 400; the tip is 20 mm off until 30 samples after the stop, the tool
    30 mm off the tip until 250 samples after it."""
    k = np.arange(500)
    target = np.column_stack([0.001 * np.minimum(k, 100), np.zeros(500), np.ones(500)])
    ee = target + np.where(k < 130, 0.02, 0.0)[:, None] * [0.0, 1.0, 0.0]
    sway = np.where(k < 350, 0.03, 0.5 * TOLERANCE)
    tool = ee - [0.0, 0.0, 0.22] + sway[:, None] * [1.0, 0.0, 0.0]
    return result(target, ee, tool)


def test_figures_of_a_run() -> None:
    found = tool_figures(made_up(), PENDULUM)
    np.testing.assert_allclose(found.rmse, [0.03, 0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.worst, [0.03, 0.02, 0.0], atol=1e-12)
    assert found.arrival == pytest.approx(0.30)
    assert found.settling == pytest.approx(2.50)
    assert found.swing == pytest.approx(0.03)


def test_what_never_comes_to_rest() -> None:
    run = made_up()
    still = tool_figures(replace(run, tool=run.tool + 0.1), PENDULUM)
    assert math.isinf(still.settling)
    cut = replace(run, **{name: getattr(run, name)[:400] for name in ("time", "target", "ee", "joints", "actions", "tool")})
    assert math.isinf(tool_figures(cut, PENDULUM).settling), "half a second of calm is less than a period"
    away = tool_figures(replace(run, ee=run.ee + 0.1), PENDULUM)
    assert math.isinf(away.arrival)
    assert math.isnan(away.swing)
    with pytest.raises(InputError, match="moves until the end"):
        tool_figures(replace(run, target=np.cumsum(np.ones((500, 3)), axis=0)), PENDULUM)
    with pytest.raises(InputError, match="without a tool"):
        tool_figures(replace(run, tool=np.full((500, 3), np.nan)), PENDULUM)


@pytest.fixture(scope="module")
def task() -> TrackingTask:
    return plan_tracking(PLANT, Perfect(PLANT), "circle", full=True, centre=(0.85, 0.0, 0.3))


def moved(task: TrackingTask, policy: Policy) -> TrackingResult:
    """A move from BEGIN to END and eight seconds in all."""
    path = Path("move", 100.0, np.repeat(task.forward.predict(END[None]), 801, axis=0))
    settings = {"tuning": task.tuning, "preview": task.dead_time}
    environment = track_environment(PLANT, task.forward, path, full=True, reach=task.reach, settings=settings)
    return track(environment, policy, path, BEGIN)


def test_a_coordinated_motion_is_followed_and_a_shaper_removes_the_swing(task: TrackingTask) -> None:
    limits = motion_limits(PLANT, task.tuning)
    shaper = input_shaper("zv", PENDULUM.frequency, PENDULUM.damping_ratio)
    plain = moved(task, CoordinatedPolicy(PLANT, task.inverse, limits))
    shaped = moved(task, ShapedPolicy(CoordinatedPolicy(PLANT, task.inverse, limits), shaper, 100.0, 4))
    drive = CylinderController(PLANT).drive(plain.actions)
    speed = np.abs(np.diff(drive, axis=0)) * 100.0
    assert (speed <= limits.speed * (1.0 + 1e-6)).all()
    assert (speed.max(axis=0) / limits.speed).max() > 0.9, "some axis is at its limit"
    figures, calm = tool_figures(plain, PENDULUM), tool_figures(shaped, PENDULUM)
    assert figures.arrival < 3.0
    assert figures.swing > 0.015
    assert calm.swing < 0.35 * figures.swing
    assert calm.settling < figures.settling
    assert calm.arrival - figures.arrival < PENDULUM.period, "half a period later, and the time to settle"


def test_a_new_target_begins_a_new_motion_where_the_last_setpoint_is(task: TrackingTask) -> None:
    policy = CoordinatedPolicy(PLANT, task.inverse, motion_limits(PLANT, task.tuning))
    first, second = task.forward.predict(np.array([END, BEGIN]))
    seen = np.concatenate([BEGIN, task.forward.predict(BEGIN[None])[0], first])[None]
    steps = [policy.act(seen)[0] for _ in range(30)]
    seen[0, 7:10] = second
    after = policy.act(seen)[0]
    assert np.abs(after - steps[-1]).max() < 2.0 * np.abs(np.diff(steps, axis=0)).max()
    ends = np.array([policy.act(seen)[0] for _ in range(600)])
    np.testing.assert_allclose(task.forward.predict(ends[-1:])[0], second, atol=1e-5)


def test_a_shaped_policy_keeps_to_a_target_that_rests(task: TrackingTask) -> None:
    policy = ShapedPolicy(InversePolicy(task.inverse), input_shaper("zv", 6.7, 0.04), 100.0, 4)
    joints = task.joints[:1]
    seen = np.concatenate([joints[0], task.path.points[0], task.path.points[0]])[None]
    policy.reset(seen)
    for _ in range(60):
        np.testing.assert_allclose(policy.act(seen), joints, atol=1e-6)
