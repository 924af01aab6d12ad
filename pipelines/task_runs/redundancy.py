"""Circles anywhere in the reach of a redundant machine, from random postures: distance of the joints from their limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sysid_rl.control import CylinderController
from sysid_rl.control.coordinated_motion import SHARE
from sysid_rl.train.inverse_kinematics import chain_of_plant
from sysid_rl.train.limit_avoidance import LimitAvoidingPolicy
from sysid_rl.train.paths import REACHED, Path, circle
from sysid_rl.train.tracking import SETTLED_S, InversePolicy
from sysid_rl.train.tracking_task import TrackingTask
from task_runs.sway import Controller, run

Array = npt.NDArray[np.float64]

#: Number of circles and seed of their centres and postures; most of them that are drawn.
CIRCLES, SEED, DRAWN = 20, 2, 5000


def circles(task: TrackingTask, count: int = CIRCLES) -> list[tuple[Path, Array]]:
    """Random circles that inverse kinematics follows within the top speeds, and the joints (A,) in which each begins."""
    rng, inverse, found = np.random.default_rng(SEED), task.inverse, []
    controller, top = CylinderController(task.plant, task.tuning), np.array([item.fastest for item in task.tuning])
    for _ in range(DRAWN):
        path = circle(rng.uniform(task.reach.ee_low, task.reach.ee_high), task.path.rate_hz)
        begin, away = inverse.solve(path.points[:1], rng.uniform(inverse.low, inverse.high)[None])
        if away[0] > REACHED:
            continue
        joints, left = inverse.follow(path.points, begin[0])
        speed = np.abs(np.diff(controller.drive(joints), axis=0)).max(axis=0) * path.rate_hz
        if left.max() < REACHED and (speed < SHARE * top).all():
            found.append((path, begin[0]))
        if len(found) == count:
            break
    return found


def rows(task: TrackingTask, each: list[tuple[Path, Array]]) -> list[dict[str, Any]]:
    """Of each circle: distance of the nearest joint from its limit as a share of its range, mean along it and at its end; RMSE
    of the tip after the first second."""
    late, chain = task.dead_time, chain_of_plant(task.plant)
    controllers = [
        Controller("ik-lookahead", (lambda: InversePolicy(task.inverse),), late, late),
        Controller(
            "ik-lookahead, gradient projection",
            (lambda: LimitAvoidingPolicy(task.inverse, chain, task.path.rate_hz),),
            late,
            late,
        ),
    ]
    found = []
    for controller in controllers:
        results = [run(task, task.plant, controller, path, start)[0] for path, start in each]
        margins = [task.inverse.margin(result.joints) for result in results]
        errors = [float(np.sqrt(np.mean(np.sum(result.after(SETTLED_S).error ** 2, axis=1)))) for result in results]
        found.append(
            {
                "controller": controller.name,
                "mean": [round(float(margin.mean()), 4) for margin in margins],
                "end": [round(float(margin[-1]), 4) for margin in margins],
                "rmse_mm": [round(1e3 * error, 3) for error in errors],
            }
        )
    return found
