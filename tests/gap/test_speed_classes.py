"""An effect that changes all speeds by one share, on drives that do and that do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import dataset_of, nominal

from sysid.datasets.recording import Dataset
from sysid.gap.candidates import Candidate
from sysid.gap.free_run import CLASSES, LeastSquares, SpeedClasses, free_run_of, speed_classes
from sysid.gap.likelihood.discrepancy import discrepancy_of
from sysid.gap.likelihood.rows import StageRows
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.prepare.case import open_case, stage_candidates
from sysid.machine import KnownEffect
from sysid.plant import compile_plant

Array = npt.NDArray[np.float64]
SECONDS = 60.0


def slower(dataset: Dataset, share: float, above: float = 0.0, uneven: float = 0.0) -> Dataset:
    """The slew moves slower by ``share`` while its speed is ``above`` a share of the largest.

    ``uneven``: its speed varies by this share with its position, as no formula of the plant does.
    """
    found = []
    for recording in dataset.recordings:
        place = recording.values("slew.joint")
        speed = np.diff(place, prepend=place[:1])
        fast = np.abs(speed) > above * np.percentile(np.abs(speed), 99.5)
        moved = place[0] + np.cumsum(speed * (1.0 - share * fast) * (1.0 + uneven * np.sin(9.0 * place)))
        noise = np.random.default_rng(len(found)).normal(0.0, 2e-4, len(place))
        found.append(replace(recording, table=recording.table.assign(**{"slew.joint": moved + noise})))
    return replace(dataset, recordings=tuple(found))


def gain_error_of(dataset: Dataset) -> tuple[LeastSquares, ModelFit, Candidate]:
    """A gain error of the slew, fitted to its free run."""
    case, stages = open_case(dataset, nominal(), 0)
    stage = next(s for s in stages if (s.problem.stage, s.problem.target) == ("command", "slew"))
    gain = next(c for c in stage_candidates(case, stage) if c.effect.name == "gain_error")
    rows = StageRows(stage.problem, stage.split.seen, stage.theta, stage.sigma)
    free = free_run_of(rows, discrepancy_of(compile_plant(case.plant), rows, stage.theta), [gain])
    return free, free.proposals.grown(free.proposals.fit(()))[0], gain


@pytest.fixture(scope="module")
def noiseless() -> Dataset:
    return dataset_of(nominal(KnownEffect("first_order_lag", "boom", {"time_constant": 0.06})), SECONDS, seed=3, noise=0.0)


@pytest.mark.parametrize(
    ("above", "uneven", "absent"), [(0.0, 0.0, False), (0.0, 0.02, False), (0.5, 0.0, True), (0.35, 0.0, True)]
)
def test_a_gain_error_is_absent_from_slow_motion_where_only_fast_motion_is_slower(
    noiseless: Dataset, above: float, uneven: float, absent: bool
) -> None:
    free, model, gain = gain_error_of(slower(noiseless, 0.06, above, uneven))
    assert model.left < 0.8 * free.proposals.fit(()).left, "one ratio explains much of either error"
    classes = speed_classes(free.proposals.likelihood, model, gain)
    assert classes.absent is absent
    assert free.absent_at_some_speed(model, gain) is absent
    if above == uneven == 0.0:
        assert classes.shares == pytest.approx(np.ones(CLASSES), abs=0.1)


def test_few_dependent_errors_do_not_tell() -> None:
    """Student's quantile for two clusters, and for ten."""
    shares, deviations = np.ones(CLASSES), np.full(CLASSES, 0.05)
    shares[0] = 0.1
    assert SpeedClasses(shares, deviations, 10).absent
    assert not SpeedClasses(shares, deviations, 2).absent
    assert not SpeedClasses(shares, 0.0 * deviations, 1).absent
    assert not SpeedClasses(np.full(CLASSES, 0.6), 0.0 * deviations, 10).absent, "nearer to present"
