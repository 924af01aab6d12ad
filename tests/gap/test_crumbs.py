"""One thing gets one name, though its formula is not quite what the machine does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import ROLES, arm_inputs, measured, nominal
from slew_search import gathered, named_at_slew

from sysid.datasets.recording import Dataset
from sysid.gap.case import open_case, stage_candidates
from sysid.gap.data import Data
from sysid.gap.fit import least_left, spread_of
from sysid.gap.scores import Scores
from sysid.gap.strictness import Strictness
from sysid.machine import KnownEffect

Array = npt.NDArray[np.float64]

#: Natural frequency [rad/s] and damping ratio of a spool, and the fastest that it can be moved [1/s].
FREQUENCY, DAMPING, RATE = 30.0, 0.9, 0.6
GAIN = 0.436


def turned(command: Array) -> Array:
    """The slew's joint (n,), at 100 Hz, moved by a spool of second order whose speed is limited."""
    place, speed, joint = 0.0, 0.0, 0.0
    joints, step = np.empty(len(command)), 0.001
    for k, wanted in enumerate(command):
        joints[k] = joint
        for _ in range(10):
            speed += step * (FREQUENCY**2 * (wanted - place) - 2.0 * DAMPING * FREQUENCY * speed)
            speed = float(np.clip(speed, -RATE, RATE))
            place += step * speed
            joint += step * GAIN * place
    return joints


def spooled() -> Dataset:
    """The slew alone, moved by such a spool."""
    runs = []
    for k in range(len(ROLES)):
        made = arm_inputs(f"run-{k + 1}", 30.0, k)
        inputs = replace(made, table=made.table.assign(**{"boom.command": 0.0, "wrist.command": 0.0}))
        run = measured(nominal(), inputs, k)
        noise = np.random.default_rng([k, 2]).normal(0.0, 2e-4, len(run))
        runs.append(replace(run, table=run.table.assign(**{"slew.joint": turned(run.values("slew.command")) + noise})))
    return gathered(nominal().machine, runs)


def test_what_a_formula_is_off_by_is_no_second_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """The owner knows the spool as a lag; where it cannot keep up it is a lag behind a limit, but not quite."""
    # By their names, makeshift says the same of these two.
    monkeypatch.setattr("sysid.gap.search.makeshift", lambda fit, strange: [])
    plant = nominal(KnownEffect("first_order_lag", "slew", {"time_constant": 2.0 * DAMPING / FREQUENCY}))
    dataset = spooled()
    assert named_at_slew(dataset, plant, Strictness()) == {"command_rate_limit"}
    assert named_at_slew(dataset, plant, Strictness(crumb=0.0)) > {"command_rate_limit"}


def test_what_a_name_leaves_is_what_its_best_values_leave() -> None:
    """Prediction errors weigh the wandering; errors of values that they do not mind add up over a run."""
    case, stages = open_case(spooled(), nominal(), 0)
    stage = next(stage for stage in stages if stage.label == "command stage of slew")
    offered = {c.effect.name: c for c in reversed(stage_candidates(case, stage)) if c.form is c.effect.forms[0]}
    fitted, unseen = (Data(stage.problem, part, stage.sigma) for part in (stage.split.fit, stage.split.select))
    scores = Scores(case.theta, ((fitted, unseen),))
    fit = scores.fit((offered["gain_error"], offered["command_rate_limit"]), ())
    assert any(drift.present for drift in fit.drifts)
    moved = least_left(fit, fitted)
    left = spread_of(fitted.residuals(moved.theta[None]))
    assert left < 0.98 * scores.fitted_rmse(fit)
    assert scores.least(fit) == (left, spread_of(unseen.residuals(moved.theta[None])))
    assert fitted.drifts(moved.theta)[1] < fit.log_likelihood
