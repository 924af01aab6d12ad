"""A name of a shape does not stand for a speed of another shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from plant_data import ROLES, arm_inputs, measured, nominal
from slew_search import named_at_slew

from sysid.datasets.recording import Dataset
from sysid.gap.strictness import Strictness

Array = npt.NDArray[np.float64]
GAIN = 0.436


def slipping(command: Array) -> Array:
    """A clutch that loses a seventh of the speed where it has to pass on much."""
    return command * np.where(np.abs(command) > 0.4, 0.86, 1.0)


def progressive(command: Array) -> Array:
    return np.asarray(np.sign(command) * np.abs(command) ** 1.2)


def driven(shape: Callable[[Array], Array]) -> Dataset:
    """The slew alone, whose speed is some function of the command, disturbed by a hundredth."""
    runs = []
    for k in range(len(ROLES)):
        made = arm_inputs(f"run-{k + 1}", 60.0, k)
        inputs = replace(made, table=made.table.assign(**{"boom.command": 0.0, "wrist.command": 0.0}))
        run = measured(nominal(), inputs, k)
        random = np.random.default_rng([k, 3])
        speed = GAIN * shape(run.values("slew.command")) * (1.0 + random.normal(0.0, 0.1, len(run)))
        joint = np.concatenate([[0.0], np.cumsum(speed[:-1]) / run.rate_hz])
        said = joint + random.normal(0.0, 2e-4, len(run))
        runs.append(replace(run, table=run.table.assign(**{"slew.joint": said})))
    machine = nominal().machine
    splits = dict(zip((r.name for r in runs), ROLES, strict=True))
    return Dataset(machine.name, 1, "0" * 64, machine, tuple(runs), {}, splits)


def test_a_clutch_that_slips_is_no_gain_and_no_curve() -> None:
    dataset = driven(slipping)
    assert named_at_slew(dataset, nominal(), Strictness()) == set()
    assert named_at_slew(dataset, nominal(), Strictness(shapeless=np.inf)) & {"gain_curve", "gain_error", "flow_saturation"}


def test_a_curve_is_one() -> None:
    assert named_at_slew(driven(progressive), nominal(), Strictness()) == {"gain_curve"}
