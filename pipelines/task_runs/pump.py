"""Moves of all axes under a shared pump: the time until the boom tip stays at its target, by one controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.machine import KnownEffect
from sysid_rl.control.coordinated_motion import motion_limits
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.train.environment import Policy
from sysid_rl.train.paths import Path
from sysid_rl.train.planned import CoordinatedPolicy
from sysid_rl.train.tool_figures import tool_figures
from sysid_rl.train.tracking import InversePolicy
from sysid_rl.train.tracking_task import TrackingTask
from task_runs.sway import MOVE_S, Controller, run

Array = npt.NDArray[np.float64]

#: Flow of the pump as a share of the summed demand of all axes at top speed (docs/machine-facts.md: 50 to 70 %).
FLOW = 0.6


def with_pump(task: TrackingTask) -> TrackingTask:
    """The same machine with a shared pump, which its controllers know."""
    axes = zip(task.tuning, task.plant.machine.axes, strict=True)
    limit = FLOW * sum(item.fastest / axis.gain for item, axis in axes)
    return replace(task, plant=task.plant.with_effect(KnownEffect("pump_flow_limit", "machine", {"limit": limit})))


def controllers(task: TrackingTask) -> list[Controller]:
    """Inverse kinematics with setpoints that jump, and coordinated motions that know more and more of the machine."""
    late, plant, tuning = task.dead_time, task.plant, task.tuning
    alone, shared = motion_limits(plant, tuning, with_pump=False), motion_limits(plant, tuning)
    whole = motion_limits(plant, tuning, share=1.0)

    def moving(limits: Any, least_time: bool = False) -> Policy:
        return CoordinatedPolicy(plant, task.inverse, limits, least_time)

    return [
        Controller("ik", (lambda: InversePolicy(task.inverse),)),
        Controller("ik, coordinated motion without the pump", (lambda: moving(alone),), 0.0, late),
        Controller("ik, coordinated motion within the flow", (lambda: moving(shared),), 0.0, late),
        Controller("least time, coordinated motion within the flow", (lambda: moving(shared, True),), 0.0, late),
        Controller("the same at 100 % of speeds and flow", (lambda: moving(whole, True),), 0.0, late),
    ]


def rows(task: TrackingTask, each: Sequence[tuple[Array, Array]]) -> list[dict[str, Any]]:
    """Arrival times [s] of all moves, and the least distance of a joint from its limits as a share of its range."""
    found = []
    for controller in controllers(task):
        times: list[float | None] = []
        margins = []
        for start, target in each:
            path = Path("move", task.path.rate_hz, np.repeat(target[None], round(MOVE_S * task.path.rate_hz) + 1, axis=0))
            (result,) = run(task, task.plant, controller, path, start)
            arrival = tool_figures(result, pendulum_of(task.plant)).arrival
            times.append(round(arrival, 4) if np.isfinite(arrival) else None)
            margins.append(float(task.inverse.margin(result.joints).min()))
        found.append({"controller": controller.name, "arrival_s": times, "margin": round(min(margins), 4)})
    return found
