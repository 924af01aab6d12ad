"""What a threshold is known by: an interval of the recordings it was fitted to, and one value in it by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from plant_data import arm_inputs, measured, nominal
from slew_search import gathered, named_at_slew

from sysid.datasets.recording import Dataset, Recording
from sysid.gap.case import open_case, stage_candidates
from sysid.gap.data import Data
from sysid.gap.fit import at_common_thresholds, fit_candidates, spread_of
from sysid.gap.scores import Scores
from sysid.gap.starts import starting_values
from sysid.gap.strictness import Strictness
from sysid.machine import KnownEffect

TRUE = {"breakaway": 0.12, "release": 0.02}


def strokes(name: str, sizes: Sequence[float], seed: int) -> Recording:
    """The slew's lever held at each of these for a second, to and fro, with a rest after each; nothing else moves."""
    made = arm_inputs(name, 2.0 * len(sizes), seed)
    signs = np.where(np.arange(len(sizes)) % 2, -1.0, 1.0)
    slew = np.concatenate([np.repeat([sign * size, 0.0], 100) for sign, size in zip(signs, sizes, strict=True)])
    command = {"slew.command": slew, "boom.command": 0.0, "wrist.command": 0.0}
    inputs = replace(made, table=made.table.assign(**command))
    return measured(nominal().with_effect(KnownEffect("stiction", "slew", TRUE)), inputs, seed)


def lopsided() -> Dataset:
    """Strokes to fit tell that the threshold is between 0.09 and 0.2; those to select know strokes of 0.11 that do nothing."""
    coarse, fine = (0.3, 0.09, 0.2, 0.5, 0.2, 0.09, 0.8, 0.4), (0.3, 0.11, 0.11, 0.6, 0.2, 0.11, 0.5, 0.2)
    runs = [strokes(f"run-{k + 1}", sizes, k) for k, sizes in enumerate((coarse, coarse[::-1], fine, fine[::-1]))]
    return gathered(nominal().machine, runs)


def test_unseen_strokes_are_predicted_with_the_part_of_the_interval_that_they_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = nominal()
    case, stages = open_case(lopsided(), plant, 0)
    stage = next(s for s in stages if s.label == "command stage of slew")
    stiction = next(c for c in stage_candidates(case, stage) if c.effect.name == "stiction")
    fitted, unseen = (Data(stage.problem, part, stage.sigma) for part in (stage.split.fit, stage.split.select))
    fit = fit_candidates(fitted, case.theta, [stiction], starting_values([stiction], (), 0))
    low = fit.theta.copy()
    low[list(stiction.unknowns[0].places)] = 0.1  # as good as any other between 0.09 and 0.2
    low_fit = replace(fit, values=np.array([0.1, fit.values[1]]), theta=low)
    assert spread_of(fitted.residuals(low[None])) < 1.2
    assert spread_of(unseen.residuals(low[None])) > 50.0
    theta = at_common_thresholds(low_fit, (fitted, unseen))
    assert spread_of(fitted.residuals(theta[None])) < 1.2
    assert spread_of(unseen.residuals(theta[None])) < 1.2
    assert 0.11 <= theta[stiction.unknowns[0].places[0]] < 0.2

    monkeypatch.setattr("sysid.gap.scores.fit_candidates", lambda *_: low_fit)
    scores = Scores(case.theta, ((fitted, unseen),))
    assert scores.rmse(scores.fit((stiction,), ())) < 1.2


def test_a_threshold_that_is_not_there_is_not_found_for_unseen_strokes() -> None:
    """Without stiction no threshold suits strokes that all move."""
    plant = nominal()
    case, stages = open_case(lopsided(), plant.with_effect(KnownEffect("stiction", "slew", TRUE)), 0)
    stage = next(s for s in stages if s.label == "command stage of slew")
    known = next(c for c in stage_candidates(case, stage) if c.effect.name == "stiction")
    parts = [Data(stage.problem, part, stage.sigma) for part in (stage.split.fit, stage.split.select)]
    fit = fit_candidates(parts[0], case.theta, [known], [np.array([0.5, 0.02])])
    wrong = replace(fit, values=np.array([0.5, 0.02]), theta=fit.theta.copy())
    wrong.theta[list(known.unknowns[0].places)] = 0.5
    theta = at_common_thresholds(wrong, parts)
    assert theta[known.unknowns[0].places[0]] > 0.4  # no further than they are moved, however wrong it is
    assert spread_of(parts[1].residuals(theta[None])) > 50.0


def test_recordings_that_never_show_the_gap_do_not_judge_what_closes_it() -> None:
    """Two recordings have small strokes, which stiction swallows; the one that is kept to select has none."""
    small, large = (0.3, 0.09, 0.2, 0.5, 0.11, 0.09, 0.8, 0.4), (0.3, 0.5, 0.6, 0.4, 0.8, 0.5, 0.3, 0.6)
    runs = [strokes(f"run-{k + 1}", sizes, k) for k, sizes in enumerate((small, small[::-1], large, large[::-1]))]
    dataset = gathered(nominal().machine, runs)
    assert named_at_slew(dataset, nominal(), Strictness(crossed=0.0)) == {"stiction"}
    assert named_at_slew(dataset, nominal(), Strictness(crossed=0.0, unshown=np.inf)) == set()
