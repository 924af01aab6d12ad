"""Modes: smooth moves, eased paths, collection inside the fence, replay and experiments, live targets."""

from __future__ import annotations

import itertools
import socket
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from runner_case import DT, MIDDLE, PLANT, Quick, case

from sysid.errors import InputError
from sysid.gap.experiment import Experiment
from sysid_rl.control import tune
from sysid_rl.control.input_shaper import ShapedSetpoints, ShaperKind, input_shaper
from sysid_rl.control.pendulum import Pendulum
from sysid_rl.control.swing_estimator import SwingEstimator
from sysid_rl.run.assemble import Assembly
from sysid_rl.run.command_filter import CommandFilter, outside
from sysid_rl.run.limits import AxisLimits, Limits, LimitSettings, limits_of
from sysid_rl.run.modes.collect import Collect, SafeMoves, draw_poses
from sysid_rl.run.modes.mode import Approach, Move
from sysid_rl.run.modes.replay import ReplayCommands, ReplayJoints, of_experiment, of_file
from sysid_rl.run.modes.track import TrackLive, TrackPath
from sysid_rl.run.valves import axis_valves
from sysid_rl.train.paths import Path as Course
from sysid_rl.train.paths import circle, eased

Array = npt.NDArray[np.float64]
VALVES = axis_valves(tune(PLANT), DT)
TIP = Quick(PLANT).predict
EE = TIP(MIDDLE)[0]
FENCED = LimitSettings(
    fence={letter: (float(EE[k]) - 0.3, float(EE[k]) + 0.3) for k, letter in enumerate("xyz")},
    axes={"slew": AxisLimits(low=-0.5, high=0.5)},
)
LIMITS = limits_of(PLANT, VALVES, FENCED, "test")


def ways(limits: Limits) -> SafeMoves:
    linkages = [PLANT.linkages[axis.name] if axis.drives == "cylinder" else None for axis in PLANT.machine.axes]
    return SafeMoves(CommandFilter(limits, VALVES, linkages, TIP, DT))


def test_a_move_keeps_its_share_of_the_limits() -> None:
    move = Move(MIDDLE, MIDDLE + np.array([0.4, -0.2, 0.5, 0.1]), LIMITS, DT)
    path = np.array([move.at(k) for k in range(move.steps + 2)])
    for order, limit in ((1, LIMITS.speed), (2, LIMITS.acceleration), (3, LIMITS.jerk)):
        assert (np.abs(np.diff(path, order, axis=0)).max(axis=0) / DT**order <= 0.72 * limit).all()
    np.testing.assert_array_equal(path[-1], move.end)


def test_an_eased_path_has_the_same_points_and_starts_from_rest() -> None:
    path = circle(np.array([0.8, 0.0, 0.3]))
    points = eased(path, 1.0)
    np.testing.assert_allclose(np.linalg.norm(points - [0.8, 0.0, 0.3], axis=1), 0.2, atol=1e-5)
    np.testing.assert_allclose(points[[0, -1]], path.points[[0, -1]], atol=1e-9)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps[0] < 0.01 * steps.max()
    assert steps.max() * 100.0 == pytest.approx(path.speed, rel=1e-3)
    assert eased(Course("dot", 100.0, points[:3]), 1.0).shape == (3, 3)


def test_an_approach_moves_each_axis_forth_and_back_that_has_no_way() -> None:
    aside, to = np.array([0.05, 0.04, -0.06, 0.02]), MIDDLE + np.array([0.3, 0.0, 0.01, 0.0])
    approach = Approach(to, LIMITS, DT, settle_s=1.0, aside=aside)
    approach.begin(MIDDLE)
    way = np.array([approach.goal(k).joints for k in range(approach.steps)])
    np.testing.assert_allclose(way[-100:], np.tile(to, (100, 1)), atol=1e-12)
    reached = np.abs(way - to).max(axis=0)
    np.testing.assert_allclose(reached[[1, 3]], np.abs(aside[[1, 3]]), atol=1e-6)
    assert reached[2] == pytest.approx(0.06, abs=1e-6), "its way is shorter"
    assert (np.diff(way[:, 0]) >= -1e-12).all(), "an axis with a way of its own does not turn"
    straight = Approach(to, LIMITS, DT)
    straight.begin(MIDDLE)
    assert straight.steps < approach.steps - 50


def test_what_an_axis_moves_aside_moves_the_tip_and_stays_in_the_fence() -> None:
    chain: Any = SimpleNamespace(tip=TIP)
    here = TIP(MIDDLE[None])[0]

    def aside(low: npt.ArrayLike, high: npt.ArrayLike) -> Array:
        limits = replace(LIMITS, fence_low=np.asarray(low), fence_high=np.asarray(high))
        return Assembly.aside(cast("Assembly", SimpleNamespace(limits=limits)), chain, MIDDLE)

    free = aside(np.full(3, -np.inf), np.full(3, np.inf))
    ways = np.linalg.norm(TIP(MIDDLE + np.diag(free)) - here, axis=1)
    assert (np.abs(free) <= 0.1 * (LIMITS.high - LIMITS.low) + 1e-12).all()
    np.testing.assert_allclose(ways[np.abs(free) < 0.0999 * (LIMITS.high - LIMITS.low)], 0.06, rtol=0.1)
    assert (aside(here - 0.01, here + 0.01) == 0.0).all()
    ends = TIP(MIDDLE + np.diag(free))
    first = aside(np.minimum(ends[0], here) - 1e-6, np.maximum(ends[0], here) + 1e-6)
    assert (first == 0.0).all(), "the first stays inside, but not together with the others"


@pytest.mark.parametrize("kind", ["zv", "zvd"])
def test_a_shaped_path_ends_without_swing_and_is_not_late(kind: ShaperKind) -> None:
    path = circle(np.array([0.8, 0.0, 0.3]))
    pendulum = Pendulum(0.22, 0.04)
    shaper = input_shaper(kind, pendulum.frequency, pendulum.damping_ratio)
    modes = [TrackPath(path, MIDDLE, LIMITS, DT, ahead=3, ease_s=0.0, shaper=each) for each in (None, shaper)]
    swing = []
    for mode in modes:
        mode.begin(MIDDLE, path.points[0])
        first = mode._approach.steps
        estimator = SwingEstimator(pendulum, 100.0)
        estimator.reset(path.points[:1])
        goals = list(
            itertools.takewhile(lambda goal: not goal.done, (mode.goal(k, MIDDLE, EE) for k in itertools.count(first)))
        )
        aims = np.array([goal.aim for goal in goals])
        if mode is modes[1]:
            shaped = ShapedSetpoints(shaper, 100.0, 3)
            shaped.reset(path.points[0])
            aims = np.array([shaped.step(aim[None])[0] for aim in aims])
        below = np.array([estimator.step(aim[None])[0][0] for aim in aims])
        np.testing.assert_allclose(aims[-1], path.points[-1], atol=1e-9)
        late = np.linalg.norm(aims[:-3] - np.array([goal.target for goal in goals])[3:], axis=1)
        assert late.mean() < 0.01, "the look-ahead of three cycles, and no more"
        swing.append(np.hypot(*below[-1, :2]) + np.hypot(*below[-25, :2]))
    assert swing[0] > 0.015
    assert swing[1] < 0.1 * swing[0]


def test_collect_draws_inside_and_stays_at_each_pose() -> None:
    poses = draw_poses(20, ways(LIMITS), 3)
    assert ((poses >= LIMITS.low) & (poses <= LIMITS.high)).all()
    assert not outside(TIP(poses), LIMITS.fence_low, LIMITS.fence_high).any()
    made = case(
        lambda limits, chain: Collect(3, ways(limits), DT, settle_s=0.4, record_s=0.2, seed=3), limits=FENCED, true=PLANT
    )
    made.loop.run()
    assert made.loop.outcome.ended == "done", made.loop.outcome.notes
    assert "fence" not in made.verdicts()
    for number in (1, 2, 3):
        rows = np.array([cycle.joints for cycle in made.cycles if cycle.source == f"record {number}"])
        assert len(rows) == 20
        assert np.ptp(rows[:, 3]) < 1e-3
        np.testing.assert_allclose(rows.mean(axis=0), made.loop.mode.poses[number - 1], atol=5e-3)  # type: ignore[attr-defined]


def test_a_stop_on_any_way_of_a_collection_ends_inside() -> None:
    """Not only at the poses: the barrier would end the collection at the first way that it cannot stop on."""
    known = ways(LIMITS)
    poses = draw_poses(30, known, 1)
    for begin, end in zip(poses, np.roll(poses, -1, axis=0), strict=True):
        move = Move(begin, end, LIMITS, DT)
        joints = np.array([move.at(k) for k in range(move.steps + 1)])
        speeds = np.gradient(joints, DT, axis=0)
        stopped = known.command_filter.stop_ends(joints, speeds)
        assert not outside(TIP(joints), LIMITS.fence_low, LIMITS.fence_high).any()
        assert not outside(TIP(stopped), LIMITS.fence_low, LIMITS.fence_high).any()


def test_joints_and_speeds_along_a_move() -> None:
    move = Move(MIDDLE, MIDDLE + np.array([0.4, -0.3, 0.2, 0.05]), LIMITS, DT)
    joints, speeds = move.sample(move.steps + 1)
    np.testing.assert_allclose(joints, [move.at(k) for k in range(move.steps + 1)], atol=1e-12)
    np.testing.assert_allclose(speeds[1:-1], (joints[2:] - joints[:-2]) / (2.0 * DT), atol=2e-4)


def test_a_collection_begins_where_the_way_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    known = ways(LIMITS)
    collect = Collect(5, known, DT, seed=2)
    drawn = collect.poses.copy()
    for left, first in (((0.1, 0.2, 0.0, 0.0, 0.3), 2), ((0.4, 0.2, 0.1, 0.3, 0.5), 2), ((0.0, 0.1, 0.1, 0.1, 0.0), 0)):
        collect.poses = drawn.copy()
        monkeypatch.setattr(known, "outside", lambda begin, end, left=left: left[int((drawn == end).all(axis=1).argmax())])
        collect.begin(MIDDLE, EE)
        np.testing.assert_array_equal(collect.poses, np.roll(drawn, -first, axis=0))


def test_an_experiment_goes_to_its_start_and_ends_where_its_limits_are_left() -> None:
    n = 150
    columns = {f"{axis}.command": np.zeros(n) for axis in PLANT.machine.axis_names}
    columns["boom.command"] = np.full(n, 0.5)
    table = pd.DataFrame({"time": np.arange(n) * DT, **columns})
    start = {"slew.joint": 0.1, "boom.cylinder": 0.05, "stick.joint": -1.2, "telescope.joint": 0.1}
    for high, ended in ((0.1, "done"), (0.06, "stopped")):
        experiment = Experiment(
            "taps", "crane", "taps", "", ("boom",), 100.0, 1, start, {"boom.cylinder": (0.0, high)}, {}, (), {}, table
        )
        made = case(lambda limits, chain, it=experiment: of_experiment(it, PLANT, limits, DT))
        made.loop.run()
        assert made.loop.outcome.ended == ended, made.loop.outcome.notes
        sent = [cycle.commands[1] for cycle in made.cycles if cycle.source == "experiment"]
        assert max(sent) == 0.5
        first = next(k for k, cycle in enumerate(made.cycles) if cycle.source == "experiment")
        np.testing.assert_allclose(made.cycles[first].joints[[0, 3]], [0.1, 0.1], atol=3e-3)
        assert np.array(made.machine.drives)[:, 1].max() < high + 0.005


def test_replay_reads_joints_or_commands(tmp_path: Path) -> None:
    names = PLANT.machine.axis_names
    rows = {f"{axis}.joint": np.linspace(MIDDLE[i], MIDDLE[i] + 0.01, 5) for i, axis in enumerate(names)}
    pd.DataFrame({"time": np.arange(5) * 0.1, **rows}).to_csv(tmp_path / "joints.csv", index=False)
    played = of_file(tmp_path / "joints.csv", PLANT.machine, LIMITS)
    assert isinstance(played, ReplayJoints)
    assert played.joints.shape == (41, 4)
    pd.DataFrame({"time": [0.0, 1.0], **{f"{axis}.command": [0.0, 2.0] for axis in names}}).to_csv(
        tmp_path / "c.csv", index=False
    )
    with pytest.raises(InputError, match="a command of 2; expected commands in -1 … 1"):
        of_file(tmp_path / "c.csv", PLANT.machine, LIMITS)
    with pytest.raises(InputError, match="no such file"):
        of_file(tmp_path / "none.csv", PLANT.machine, LIMITS)
    assert isinstance(ReplayCommands(np.zeros((3, 4)), LIMITS, DT).goal(3, MIDDLE, EE).done, bool)


def test_a_live_target_comes_over_the_loopback_and_never_jumps() -> None:
    mode = TrackLive(0, 0.1, DT)
    try:
        mode.begin(MIDDLE, EE)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for text in ("nonsense", f"{EE[0] + 0.01} {EE[1]} {EE[2]}", "nan 0 0"):
                sender.sendto(text.encode(), ("127.0.0.1", mode.port))
        path = np.array([mode.goal(k, MIDDLE, EE).target for k in range(60)])
    finally:
        mode.close()
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.1 * DT + 1e-12
    np.testing.assert_allclose(path[-1], EE + np.array([0.01, 0.0, 0.0]), atol=1e-9)
