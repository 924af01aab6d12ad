"""Where formulas are wrong, effects without a name get the values that predict best; a name keeps its likeliest value."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from plant_data import arm, dataset_of, nominal

from sysid.gap import stage_search
from sysid.gap.candidates import Candidate, candidates_at
from sysid.gap.data import Data
from sysid.gap.decision import Decision
from sysid.gap.fit import place, spread_of
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.problem import problems_of
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_search import _adjusted_to_free_run
from sysid.gap.statement import AGREES
from sysid.gap.steps import open_study
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import compile_plant

TRUE_LAG, TRUE_DELAY, LIKELY_LAG, LIKELY_DELAY = 0.15, 0.03, 0.16, 0.06
PLANT = nominal()
OFFERED = {c.label: c for c in candidates_at(PLANT, PLANT.vector(), "command", ("wrist",))}
LAG, DELAY = OFFERED["first_order_lag(wrist)"], OFFERED["input_delay(wrist)"]


def fitted(named: tuple[Candidate, ...], exact: bool) -> tuple[Data, StageFit]:
    """The wrist's stage with a lag and a dead time that the likelihood has taken for an error of timing."""
    truth = nominal(
        KnownEffect("first_order_lag", "wrist", {"time_constant": TRUE_LAG}),
        KnownEffect("input_delay", "wrist", {"delay": TRUE_DELAY}),
    )
    dataset = dataset_of(truth, 8.0)
    (problem,) = (p for p in problems_of(compile_plant(PLANT), dataset) if (p.stage, p.target) == ("command", "wrist"))
    seen = Data(problem, dataset.recordings[:2], np.array([1e-4]))
    unknowns, values = (*LAG.unknowns, *DELAY.unknowns), np.array([LIKELY_LAG, LIKELY_DELAY])
    model = ModelFit(
        (LAG, DELAY), unknowns, values, place(PLANT.vector(), unknowns, values[None])[0], 1e-6 * np.eye(2), np.zeros(2),
        0.0, np.zeros(4), 1.0, np.full(2, 1e3), 100.0,
    )  # fmt: skip
    decision = Decision(model, named, (), (), (model,), (model,), exact, False)
    return seen, StageFit((model,), decision, {}, cast("Any", None), model)


@pytest.mark.parametrize(
    ("named", "exact", "expected"),
    [
        ((), False, [TRUE_LAG, TRUE_DELAY]),
        ((DELAY,), False, [None, LIKELY_DELAY]),
        ((LAG, DELAY), False, [LIKELY_LAG, LIKELY_DELAY]),
        ((), True, [LIKELY_LAG, LIKELY_DELAY]),
    ],
    ids=["no name", "one name", "names alone", "formulas right"],
)
def test_what_is_only_adjusted_serves_the_prediction(
    named: tuple[Candidate, ...], exact: bool, expected: list[float | None]
) -> None:
    seen, before = fitted(named, exact)
    after = _adjusted_to_free_run(seen, before).decision
    for found, value, likely in zip(after.model.values, expected, (LIKELY_LAG, LIKELY_DELAY), strict=True):
        if value is None:  # the lag makes up for the delay as far as it can
            assert found < likely - 0.01
        else:
            assert found == pytest.approx(value, abs=2e-3)
    assert (after.named, after.model.covariance is before.decision.model.covariance) == (named, True)
    assert after.model.theta[list(LAG.unknowns[0].places)] == pytest.approx(after.model.values[0])


@pytest.mark.parametrize("stated", [True, False])
def test_a_stated_order_leaves_no_error_of_timing_between_command_and_motion(
    stated: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = arm().files()
    order = 'convention = "read_before_written"\n' if stated else ""
    files["machine.toml"] = files["machine.toml"].replace("rate_hz", order + "rate_hz", 1)
    machine = machine_from_files(files, "arm")
    truth = nominal(KnownEffect("first_order_lag", "wrist", {"time_constant": TRUE_LAG}), machine=machine)
    study = open_study(dataset_of(truth, 8.0), nominal(machine=machine))
    (stage,) = (s for s in study.stages if s.label == "command stage of wrist")
    seen: list[float] = []

    def searched(*given: Any) -> Any:
        seen.append(given[-1])
        raise StopIteration

    monkeypatch.setattr(stage_search, "search_stage", searched)
    with pytest.raises(StopIteration):
        stage_search.find_stage(study.case, stage, "all", lambda share, text: None)
    assert seen == [0.0 if stated else pytest.approx(0.5 / machine.rate_hz)]


@pytest.mark.parametrize("floors", [1.2, 1.45, 1.6, 4.0])
def test_only_a_stage_that_does_not_agree_is_searched(floors: float, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = machine_from_files(arm().files(), "arm")
    truth = nominal(KnownEffect("first_order_lag", "wrist", {"time_constant": TRUE_LAG}), machine=machine)
    study = open_study(dataset_of(truth, 8.0), nominal(machine=machine))
    (stage,) = (s for s in study.stages if s.label == "command stage of wrist")
    error = spread_of(Data(stage.problem, stage.split.seen, stage.sigma).residuals(stage.theta[None]))
    stage = replace(stage, sigma=stage.sigma * error / floors)
    searched: list[float] = []

    def search(*_: Any) -> Any:
        searched.append(floors)
        raise StopIteration

    monkeypatch.setattr(stage_search, "search_stage", search)
    with contextlib.suppress(StopIteration):
        found = stage_search.find_stage(study.case, stage, "all", lambda share, text: None)
        assert (found.named, found.nominal_rmse) == ((), pytest.approx(floors))
    assert bool(searched) == (floors > AGREES)
