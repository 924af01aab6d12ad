"""Errors of a stage on held-out recordings, in noise floors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.disagreement import stage_rmse
from sysid.gap.equivalence import equivalent_change
from sysid.gap.prepare.case import Stage
from sysid.gap.thresholds import EXPLAINED

Array = npt.NDArray[np.float64]


def distance_moved(stage: Stage, recordings: Sequence[Recording]) -> float:
    """Distance that the predicted output moves in a recording, mean over recordings and outputs, in noise floors."""
    moved = [np.nansum(np.abs(np.diff(stage.problem.predict(stage.theta[None], r)[0], axis=0)), axis=0) for r in recordings]
    return float(np.mean(np.array(moved) / stage.sigma))


def is_better(stage: Stage) -> bool:
    """Whether the whole stage gets better on held-out recordings and no signal worse by a tenth.

    Where they do not excite it, it is enough that no signal gets worse above its noise floor.
    """
    before = stage_rmse(stage.problem, stage.theta, stage.split.held_out)
    after = stage_rmse(stage.problem, stage.found.fit.theta, stage.split.held_out)
    there = ~np.isnan(before) & ~np.isnan(after)
    before, after, sigma = before[there], after[there], stage.sigma[there]
    if not there.any() or (after > EXPLAINED * np.maximum(before, sigma)).any():
        return False
    if float(np.sum((after / sigma) ** 2)) < float(np.sum((before / sigma) ** 2)):
        return True
    kept = (after <= np.maximum(before, EXPLAINED * sigma)).all()
    return bool(kept and not is_excited(stage, stage.theta, stage.found.fit.theta))


def is_excited(stage: Stage, without: Array, theta: Array) -> bool:
    """Whether held-out recordings excite the difference between a model ``theta`` and ``without`` an effect.

    The output has to change by more than the region of practical equivalence of :mod:`sysid.gap.decision`.
    """
    error = held_out_error(stage, theta)
    moved = [np.diff(stage.problem.predict(np.array([without, theta]), r), axis=0)[0] for r in stage.split.held_out]
    size = float(np.sqrt(np.nanmean((np.concatenate(moved) / stage.sigma) ** 2)))
    return held_out_error(stage, stage.theta) > EXPLAINED and size > equivalent_change(error)


def held_out_error(stage: Stage, theta: Array) -> float:
    """Held-out RMSE of the stage in noise floors."""
    return relative_error(stage, theta, stage.split.held_out)


def relative_error(stage: Stage, theta: Array, recordings: Sequence[Recording]) -> float:
    """RMSE of the stage in recordings, in noise floors."""
    return float(np.sqrt(np.nanmean((stage_rmse(stage.problem, theta, recordings) / stage.sigma) ** 2)))
