"""Names of a drive that a periodic disturbance explains better: no effect of the catalogue is periodic in time.

A pulsating pump that is recorded during a few similar motions changes the mean speed of each of them, as a gain error does. The
disturbance competes with the names: on the second halves of recordings, with the phases of the first halves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.gap.decision import PERIODIC
from sysid.gap.prepare.case import Stage
from sysid.gap.thresholds import PRICE
from sysid.gap.unnamed.description import MAX_P_VALUE, moving_parts, worst_residual
from sysid.gap.unnamed.periodic import find_periodic_disturbance
from sysid.gap.unnamed.residual_series import ResidualSeries
from sysid.machine import Machine

Array = npt.NDArray[np.float64]


def without_periodic_names(stage: Stage, machine: Machine) -> Stage:
    """The stage without its effects where a periodic disturbance explains its error better than their names do.

    It has to leave a fifth of the squared speed error that the names leave (the price of an effect), and the names must not be
    worth that price beside it. Only where formulas are wrong and errors accumulate.
    """
    result = stage.found
    if not result.accumulates or not result.named or result.stage_fit is None:
        return stage
    before, after = (_series(stage, theta, machine) for theta in (stage.theta, result.fit.theta))
    both = [name for name in before if name in after]
    if not _better([before[name] for name in both], [after[name] for name in both]):
        return stage
    lost = dict.fromkeys((kept.candidate.label for kept in result.named), PERIODIC)
    fitted = replace(result.stage_fit, decision=result.stage_fit.decision.without_names(lost))
    rmse = result.nominal_rmse
    without = replace(result, named=(), adjusted=(), fit=stage.nominal, final_rmse=rmse, stage_fit=fitted, names_alone=None)
    return replace(stage, result=without)


def _series(stage: Stage, theta: Array, machine: Machine) -> dict[str, ResidualSeries]:
    """Rate of the residual of the stage's only output, by recording in which the axis moves."""
    found = worst_residual(stage.problem, theta, stage.split.seen, machine)
    return {part.name: part for part in moving_parts(stage.problem, found[2])} if found is not None else {}


def _better(before: Sequence[ResidualSeries], after: Sequence[ResidualSeries]) -> bool:
    """Whether a periodic disturbance explains the residual ``before`` the names better than they do, and they add little."""
    found = find_periodic_disturbance(before, ar1=0.0)
    if found is None or found.p_value > MAX_P_VALUE:
        return False
    instead, names = 1.0 - found.share, _second_halves(after) / _second_halves(before)
    if PRICE * instead > names:
        return False
    beside = find_periodic_disturbance(after, ar1=0.0)
    both = names * (1.0 - beside.share) if beside is not None else names
    return instead < PRICE * both


def _second_halves(series: Sequence[ResidualSeries]) -> float:
    """Sum of squares in the second halves of recordings, about the mean of each."""
    parts = (part.target[np.isfinite(part.target)] for part in series)
    halves = (part[len(part) // 2 :] for part in parts)
    return sum(float(np.sum((half - half.mean()) ** 2)) for half in halves)
