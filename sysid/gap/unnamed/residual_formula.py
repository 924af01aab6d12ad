"""Description of a residual that no effect of the catalogue explains: where it is and on what it depends, never a name.

A formula is reported only if it predicts recordings left out of its search. Where no formula does, cross-correlations show
whether the residual depends on a measured variable; where it does not, it is reported as a random disturbance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.gap.result import Probe, Unnamed
from sysid.gap.unnamed.formula_search import ValidatedFormula, find_formula
from sysid.gap.unnamed.periodic_disturbance import PeriodicDisturbance, find_periodic_disturbance
from sysid.gap.unnamed.residual_series import (
    ResidualSeries,
    cross_correlations,
    lag1_autocorrelation,
    residual_series,
)
from sysid.gap.unnamed.terms import Formula
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least share of the variance that a formula explains on recordings left out of the fit, and largest p-value of that gain.
MIN_SHARE, MAX_P_VALUE = 0.06, 0.01
#: Share of the variance beyond which a residual is periodic rather than random.
MOST = 0.5
#: Least correlation that counts as a dependence where no formula was found.
MIN_CORRELATION = 0.2
#: Number of cross-correlations that are reported.
MAX_PROBES = 5
NOTHING = "nothing that was measured"


def describe_residual(problem: Problem, theta: Array, recordings: Sequence[Recording], machine: Machine) -> list[Unnamed]:
    """The output of the stage with the largest residual: the variables it depends on, and the formula that predicts it.

    Args:
        theta: best parameter vector of the stage, whose residual is described.
        recordings: fit and selection recordings.
    """
    found = worst_residual(problem, theta, recordings, machine)
    if found is None:
        return []
    rmse, signal, series = found
    if not series:
        return [Unnamed(problem.stage, problem.target, rmse, NOTHING, "measured for too short a time to describe it")]
    return [describe(problem, rmse, signal, series, machine)]


def describe_period(problem: Problem, theta: Array, recordings: Sequence[Recording], machine: Machine) -> list[Unnamed]:
    """The same where a periodic disturbance explains most of the residual; else nothing.

    For residuals that no smooth function explains, which otherwise count as a random disturbance.
    """
    found = worst_residual(problem, theta, recordings, machine)
    if found is None or not found[2]:
        return []
    rmse, signal, series = found[0], found[1], moving_parts(problem, found[2])
    disturbance = _certain(find_periodic_disturbance(series, lag1_autocorrelation([part.target for part in series])))
    if disturbance is None or disturbance.share < MOST:
        return []
    return [_periodic_in_time(problem, rmse, signal, series, disturbance)]


def worst_residual(
    problem: Problem, theta: Array, recordings: Sequence[Recording], machine: Machine
) -> tuple[float, str, list[ResidualSeries]] | None:
    """RMSE, signal and residuals of the output with the largest residual; None where none is measured."""
    moving = [recording for recording in recordings if recording.kind == "motion"]
    worst: tuple[float, int] | None = None
    for k in range(len(problem.signals)):
        left = [(problem.measured(r) - problem.predict(theta[None], r)[0])[:, k] for r in moving]
        joined = np.concatenate(left) if left else np.empty(0)
        if np.isfinite(joined).any():
            rmse = float(np.sqrt(np.nanmean(joined**2)))
            worst = max(worst, (rmse, k)) if worst is not None else (rmse, k)
    if worst is None:
        return None
    rmse, k = worst
    found = [residual_series(problem, theta, recording, machine, k) for recording in moving]
    return rmse, problem.signals[k], [part for part in found if part is not None]


def moving_parts(problem: Problem, series: Sequence[ResidualSeries]) -> Sequence[ResidualSeries]:
    """Recordings in which the axis moves, which have its speed; all of them where none does."""
    return [part for part in series if f"speed of {problem.target}" in part.variables] or series


def _certain(disturbance: PeriodicDisturbance | None) -> PeriodicDisturbance | None:
    """A disturbance that explains enough, with certainty; else None."""
    sure = disturbance is not None and disturbance.share >= MIN_SHARE and disturbance.p_value <= MAX_P_VALUE
    return disturbance if sure else None


def _periodic_in_time(
    problem: Problem,
    rmse: float,
    signal: str,
    series: Sequence[ResidualSeries],
    disturbance: PeriodicDisturbance,
    shown: tuple[Probe, ...] = (),
) -> Unnamed:
    depends = ", ".join(dict.fromkeys(("time", *(factor.variable for factor in disturbance.modulation))))
    text = (
        f"{_what(series)} of {signal} ≈ {disturbance} (SI units), with one phase φ per recording; explains "
        f"{int(100.0 * disturbance.share)} % of the variance of second halves of recordings, with the phase of first halves"
    )
    return Unnamed(problem.stage, problem.target, rmse, depends, text, disturbance.share, disturbance.period, "s", shown)


def _what(series: Sequence[ResidualSeries]) -> str:
    return "rate of the residual" if series[0].rate else "residual"


def describe(problem: Problem, rmse: float, signal: str, series: Sequence[ResidualSeries], machine: Machine) -> Unnamed:
    """One output of a stage, from its residual on each recording.

    Of a formula and a periodic disturbance the one that explains the larger share counts, each on data left out of its fit.
    """
    what, series = _what(series), moving_parts(problem, series)
    found = find_formula(series, _periodic_over(problem, machine))
    probes = cross_correlations(series, found.ar1)
    shown = probes[:MAX_PROBES]
    disturbance = _certain(find_periodic_disturbance(series, found.ar1))
    certain = found.formula.terms and found.share >= MIN_SHARE and found.p_value <= MAX_P_VALUE
    if certain and (disturbance is None or found.share >= disturbance.share):
        formula, periodic = found.formula, _periodic(found.formula)
        text = (
            f"{what} of {signal} ≈ {formula} (SI units); explains {int(100.0 * found.share)} % of its "
            "variance on recordings left out of the fit"
        )
        period, unit = (periodic[1], _unit(periodic[0], machine)) if periodic else (0.0, "")
        return Unnamed(
            problem.stage, problem.target, rmse, ", ".join(_variables(formula)), text, found.share, period, unit, shown
        )  # fmt: skip
    if disturbance is not None:
        return _periodic_in_time(problem, rmse, signal, series, disturbance, shown)
    clear = [p for p in probes if abs(p.correlation) > max(p.bound, MIN_CORRELATION)]
    if clear:
        best = clear[0]
        late = f" {best.lag:.1f} s earlier" if best.lag > 0.0 else ""
        text = (
            f"{what} of {signal} correlates with {best.name}{late} (ρ = {best.correlation:.2f}, 1 % bound {best.bound:.2f}), "
            "but no simple formula predicts recordings left out of the fit"
        )
        return Unnamed(problem.stage, problem.target, rmse, best.name, text, probes=shown)
    return Unnamed(problem.stage, problem.target, rmse, NOTHING, _nothing(problem, what, series, probes, found), probes=shown)


def _nothing(
    problem: Problem, what: str, series: Sequence[ResidualSeries], probes: Sequence[Probe], found: ValidatedFormula
) -> str:
    text = f"{what}: no relevant correlation with a measured variable"
    for strongest in probes[:1]:
        text += f" (the largest is {strongest.name}: ρ = {strongest.correlation:.2f}, 1 % bound {strongest.bound:.2f})"
    if series[0].rate:
        share = _share_of_speed(series, f"speed of {problem.target}")
        return f"{text}; it looks like a random disturbance of about {100.0 * share:.1f} % of the speed"
    drifts = found.ar1 > 0.9
    return f"{text}; it looks like {'a random drift' if drifts else 'a random disturbance'}"


def _share_of_speed(series: Sequence[ResidualSeries], name: str) -> float:
    """RMS of the rate of the residual over RMS of the speed, during motion."""
    rate = np.concatenate([part.target for part in series])
    speed = np.concatenate([part.filtered(part.variables[name]) for part in series if name in part.variables] or [0.0 * rate])
    there = np.isfinite(rate)
    moving = there & (np.abs(speed) > 0.1 * np.abs(speed).max(initial=0.0))
    return float(np.sqrt(np.mean(rate[moving] ** 2) / np.mean(speed[moving] ** 2))) if moving.any() else 0.0


def _periodic_over(problem: Problem, machine: Machine) -> tuple[str, ...]:
    """Variables over which a residual may be periodic."""
    if problem.target in machine.axis_names:
        return (machine.axis(problem.target).driven,)
    return tuple(axis_signal(name, "joint") for name in machine.axis_names)


def _periodic(formula: Formula) -> tuple[str, float] | None:
    """Variable and period of the first periodic term."""
    factors = [term.periodic for term in formula.terms if term.periodic is not None]
    return (factors[0].variable, factors[0].number) if factors else None


def _variables(formula: Formula) -> tuple[str, ...]:
    return tuple(dict.fromkeys(variable for term in formula.terms for variable in term.variables))


def _unit(variable: str, machine: Machine) -> str:
    return "s" if variable == "time" else (machine.expected_unit(variable) or ("m" if variable.endswith(".cylinder") else ""))
