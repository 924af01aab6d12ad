"""Hypotheses that compete with the names of a drive: a periodic disturbance, a smooth function of the position.

No effect of the catalogue is periodic in time. A pulsating pump that is recorded during a few similar motions changes the mean
speed of each of them, as a gain error does. The disturbance competes on the second halves of recordings, with the phases of the
first halves.

No effect of the catalogue is a curve over the position. An uneven gear, whose ratio varies over its range, is in the mean a
gain error of the drive or a wrong scale of its sensor. Each recording is predicted by the function fitted to all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import legvander

from sysid.gap.comparison import divides
from sysid.gap.fit import spread_of
from sysid.gap.held_out import comparisons_without
from sysid.gap.likelihood.discrepancy.shapes import filled, span_of
from sysid.gap.prepare.case import Stage
from sysid.gap.reasons import Reason
from sysid.gap.thresholds import PRICE
from sysid.gap.unnamed.description import MAX_P_VALUE, moving_parts, worst_residual
from sysid.gap.unnamed.periodic import find_periodic_disturbance
from sysid.gap.unnamed.residual_series import ResidualSeries
from sysid.machine import Axis, Machine

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
    lost = dict.fromkeys((kept.candidate.label for kept in result.named), Reason.PERIODIC)
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


# -- a function of the position ------------------------------------------------------------------------------------------------

#: Degree of the function: up to three turning points over the range.
DEGREE = 4


def without_names_of_position(stage: Stage, machine: Machine) -> Stage:
    """The stage of a drive without the names that a smooth function of its position replaces; their values stay in the plant.

    The function in place of an effect has to be worth the price of an effect compared with the names, and the effect must not
    be worth that price beside the function. Only where formulas are wrong.
    """
    result, problem = stage.found, stage.problem
    if not problem.kind.commanded or result.stage_fit is None or result.stage_fit.decision.exact:
        return stage
    axis, lost = machine.axis(problem.target), dict[str, Reason]()
    for kept in result.named:
        pair = comparisons_without(stage, kept.candidate.label)[0]
        if replaces(*(position_residuals(stage, each.theta, axis) for each in pair)):
            lost[kept.candidate.label] = Reason.POSITION
    return replace(stage, result=result.without_names(lost)) if lost else stage


@dataclass(frozen=True)
class PositionResidual:
    """One recording: the residual in noise floors (n,), and the columns of the function (n, k)."""

    residual: Array
    columns: Array


def position_residuals(stage: Stage, theta: Array, axis: Axis) -> list[PositionResidual]:
    """The fit and selection recordings; about their means where errors accumulate, since the start is free."""
    problem, seen = stage.problem, [r for r in stage.split.seen if r.kind == "motion"]
    middle, half = span_of(tuple(seen), axis.driven)
    found = []
    for recording in seen:
        residual = problem.residual(theta, recording)[:, 0] / stage.sigma[0]
        columns = legvander((filled(recording.values(axis.driven)[problem.rows(recording)]) - middle) / half, DEGREE)
        there = np.isfinite(residual)
        residual, columns = residual[there], columns[there]
        if problem.kind.integrates and len(residual):
            residual, columns = residual - residual.mean(), (columns - columns.mean(axis=0))[:, 1:]
        found.append(PositionResidual(residual, columns))
    return found


def replaces(without: Sequence[PositionResidual], names: Sequence[PositionResidual]) -> bool:
    """Whether the function replaces an effect, from the residuals without and with it."""
    if len(without) < 2:
        return False
    instead, both = left_out(without), left_out(names)
    return divides(spread_of([each.residual for each in names]), instead) and not divides(instead, both)


def left_out(recordings: Sequence[PositionResidual]) -> float:
    """RMS error of the recordings, each beside the function that is fitted to all others by least squares."""
    products = [(r.columns.T @ r.columns, r.columns.T @ r.residual) for r in recordings]
    gram, right = (np.sum([each[k] for each in products], axis=0) for k in range(2))
    left = []
    for r, (own, own_right) in zip(recordings, products, strict=True):
        coefficients = np.linalg.lstsq(gram - own, right - own_right, rcond=None)[0]
        left.append(r.residual - r.columns @ coefficients)
    return spread_of(left)
