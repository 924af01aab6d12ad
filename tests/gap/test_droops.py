"""A servo that is too weak for what it carries falls short of its setpoint; its sensor is not to blame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from plant_data import ROLES, arm_inputs, measured, nominal
from slew_search import gathered, named_at

from sysid.datasets.recording import Dataset
from sysid.gap.strictness import Strictness

Array = npt.NDArray[np.float64]
NOISE = 2e-4  # rad


def drooping(command: Array) -> Array:
    """Where a spring to the setpoint holds a pendulum of 2.5 times its stiffness: k·(command − q) = 2.5·k·sin q."""
    at = np.linspace(-np.pi / 2.0, np.pi / 2.0, 2001)
    return np.interp(command, at + 2.5 * np.sin(at), at)


def servo(stands: Callable[[Array], Array]) -> Dataset:
    """A minute of the wrist for every role, the other axes at rest.

    Args:
        stands: setpoint (n,) → where the joint is then (n,) [rad].
    """
    plant, runs = nominal(), []
    for k in range(len(ROLES)):
        made = arm_inputs(f"run-{k + 1}", 60.0, k)
        wide = {"wrist.command": 2.0 * made.values("wrist.command")}
        still = replace(made, table=made.table.assign(**{"slew.command": 0.0, "boom.command": 0.0}, **wide))
        run = measured(plant, still, k)
        said = stands(run.values("wrist.joint")) + np.random.default_rng([k, 3]).normal(0.0, NOISE, len(run))
        runs.append(replace(run, table=run.table.assign(**{"wrist.joint": said})))
    return gathered(plant.machine, runs)


def named_at_wrist(dataset: Dataset) -> set[str]:
    return named_at("command stage of wrist", dataset, nominal(), Strictness())


def test_a_weak_servo_is_no_sensor_that_reads_too_little() -> None:
    assert "sensor_scale" not in named_at_wrist(servo(drooping))


def test_a_sensor_that_reads_too_little_is_one_where_that_is_all() -> None:
    assert named_at_wrist(servo(lambda joint: 0.9 * joint)) == {"sensor_scale"}
