"""Description of a residual that no effect of the catalogue explains: where it is and on what it depends, never a name.

Of a formula and a periodic disturbance the one that explains the larger share counts, each on data left out of its fit. Where
neither explains enough, cross-correlations show whether the residual depends on a measured variable; where it does not, it is
reported as a random disturbance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import earlier
from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.gap.result import Probe, Unnamed
from sysid.gap.unnamed.formula import find_formula
from sysid.gap.unnamed.periodic import PeriodicDisturbance, find_periodic_disturbance
from sysid.gap.unnamed.residual_series import (
    ResidualSeries,
    lag1_autocorrelation,
    quasi_difference,
    residual_series,
    shared_variables,
)
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least share of the variance that is explained on data left out of the fit, and largest p-value of that gain.
MIN_SHARE, MAX_P_VALUE = 0.06, 0.01
#: Share of the variance beyond which a residual is periodic rather than random.
MOST = 0.5
#: Least correlation that counts as a dependence where no formula was found, and number of correlations that are reported.
MIN_CORRELATION, MAX_PROBES = 0.2, 5
#: Longest time by which a variable may lead the residual [s], and least number of entries that are correlated.
LONGEST_LAG, MIN_ENTRIES = 1.0, 50
#: Probability that an independent residual exceeds any of its bounds.
FALSE_ALARM = 0.01
#: Lag-1 autocorrelation beyond which a random residual is a drift.
DRIFT = 0.9
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
    disturbance = _certain_disturbance(series, lag1_autocorrelation([part.target for part in series]))
    if disturbance is None or disturbance.share < MOST:
        return []
    return [_periodic_in_time(problem, rmse, f"{_kind(series)} of {signal}", disturbance)]


def worst_residual(
    problem: Problem, theta: Array, recordings: Sequence[Recording], machine: Machine
) -> tuple[float, str, list[ResidualSeries]] | None:
    """RMSE, signal and residuals of the output with the largest residual; None where none is measured."""
    moving = [recording for recording in recordings if recording.kind == "motion"]
    if not moving:
        return None
    joined = np.concatenate([problem.residual(theta, r) for r in moving])
    sizes = [(float(np.sqrt(np.nanmean(left**2))), k) for k, left in enumerate(joined.T) if np.isfinite(left).any()]
    if not sizes:
        return None
    rmse, k = max(sizes)
    found = [residual_series(problem, theta, recording, machine, k) for recording in moving]
    return rmse, problem.signals[k], [part for part in found if part is not None]


def moving_parts(problem: Problem, series: Sequence[ResidualSeries]) -> Sequence[ResidualSeries]:
    """Recordings in which the axis moves, which have its speed; all of them where none does."""
    return [part for part in series if f"speed of {problem.target}" in part.variables] or series


def describe(problem: Problem, rmse: float, signal: str, series: Sequence[ResidualSeries], machine: Machine) -> Unnamed:
    """One output of a stage, from its residual on each recording."""
    series = moving_parts(problem, series)
    kind, found = _kind(series), find_formula(series, _periodic_over(problem, machine))
    probes, disturbance = cross_correlations(series, found.ar1), _certain_disturbance(series, found.ar1)

    def unnamed(depends: str, text: str) -> Unnamed:
        return Unnamed(problem.stage, problem.target, rmse, depends, text, probes=probes[:MAX_PROBES])

    certain = found.formula.terms and found.share >= MIN_SHARE and found.p_value <= MAX_P_VALUE
    if certain and (disturbance is None or found.share >= disturbance.share):
        text = (
            f"{kind} of {signal} ≈ {found.formula} (SI units); explains {int(100.0 * found.share)} % of its "
            "variance on recordings left out of the fit"
        )
        wave = found.formula.periodic
        period, unit = (wave.number, _unit(wave.variable, machine)) if wave is not None else (0.0, "")
        described = unnamed(", ".join(found.formula.variables), text)
        return replace(described, explains=found.share, period=period, period_unit=unit)
    if disturbance is not None:
        described = _periodic_in_time(problem, rmse, f"{kind} of {signal}", disturbance)
        return replace(described, probes=probes[:MAX_PROBES])
    best = next((probe for probe in probes if abs(probe.correlation) > max(probe.bound, MIN_CORRELATION)), None)
    if best is not None:
        late = f" {best.lag:.1f} s earlier" if best.lag > 0.0 else ""
        text = (
            f"{kind} of {signal} correlates with {best.name}{late} (ρ = {best.correlation:.2f}, 1 % bound {best.bound:.2f}), "
            "but no simple formula predicts recordings left out of the fit"
        )
        return unnamed(best.name, text)
    text = f"{kind}: no relevant correlation with a measured variable"
    for strongest in probes[:1]:
        text += f" (the largest is {strongest.name}: ρ = {strongest.correlation:.2f}, 1 % bound {strongest.bound:.2f})"
    if series[0].rate:
        share = _share_of_speed(series, f"speed of {problem.target}")
        text += f"; it looks like a random disturbance of about {100.0 * share:.1f} % of the speed"
    else:
        text += f"; it looks like {'a random drift' if found.ar1 > DRIFT else 'a random disturbance'}"
    return unnamed(NOTHING, text)


def _kind(series: Sequence[ResidualSeries]) -> str:
    return "rate of the residual" if series[0].rate else "residual"


def _certain_disturbance(series: Sequence[ResidualSeries], ar1: float) -> PeriodicDisturbance | None:
    """A periodic disturbance that explains enough, with certainty; else None."""
    found = find_periodic_disturbance(series, ar1)
    return found if found is not None and found.share >= MIN_SHARE and found.p_value <= MAX_P_VALUE else None


def _periodic_in_time(problem: Problem, rmse: float, what: str, disturbance: PeriodicDisturbance) -> Unnamed:
    depends = ", ".join(dict.fromkeys(("time", *(factor.variable for factor in disturbance.modulation))))
    text = (
        f"{what} ≈ {disturbance} (SI units), with one phase φ per recording; explains "
        f"{int(100.0 * disturbance.share)} % of the variance of second halves of recordings, with the phase of first halves"
    )
    return Unnamed(problem.stage, problem.target, rmse, depends, text, disturbance.share, disturbance.period, "s")


def _share_of_speed(series: Sequence[ResidualSeries], name: str) -> float:
    """RMS of the rate of the residual over RMS of the speed, during motion."""
    rate = np.concatenate([part.target for part in series])
    speed = np.concatenate([part.filtered(part.variables[name]) for part in series if name in part.variables] or [0.0 * rate])
    moving = np.isfinite(rate) & (np.abs(speed) > 0.1 * np.abs(speed).max(initial=0.0))
    return float(np.sqrt(np.mean(rate[moving] ** 2) / np.mean(speed[moving] ** 2))) if moving.any() else 0.0


def _periodic_over(problem: Problem, machine: Machine) -> tuple[str, ...]:
    """Variables over which a residual may be periodic."""
    if problem.target in machine.axis_names:
        return (machine.axis(problem.target).driven,)
    return tuple(axis_signal(name, "joint") for name in machine.axis_names)


def _unit(variable: str, machine: Machine) -> str:
    return "s" if variable == "time" else (machine.expected_unit(variable) or ("m" if variable.endswith(".cylinder") else ""))


def cross_correlations(series: Sequence[ResidualSeries], ar1: float) -> tuple[Probe, ...]:
    """Each variable at the lag of its largest correlation relative to the bound, in descending order.

    Residual and variable are prewhitened by a first-order autoregression (coefficient ``ar1``). The variance of the mean of
    their product is that of Newey and West (Econometrica 55, 1987), which allows for remaining autocorrelation and for a
    disturbance whose variance depends on the variable; the bounds hold for all variables and lags together (Bonferroni).
    """
    from scipy.stats import norm

    names, step = shared_variables(series), series[0].step
    lags = range(max(1, round(LONGEST_LAG / step)) + 1)
    level = float(norm.isf(0.5 * FALSE_ALARM / (max(len(names), 1) * len(lags))))
    found = []
    for name in names:
        values = [part.filtered(part.variables[name]) for part in series]
        probes = []
        for lag in lags:
            pairs = [_pair(part.target, value, lag, ar1) for part, value in zip(series, values, strict=True)]
            e, x = (np.concatenate(side) for side in zip(*pairs, strict=True))
            if len(e) < MIN_ENTRIES or not (e.std() > 0.0 and x.std() > 0.0):
                continue
            product = (e - e.mean()) * (x - x.mean()) / (e.std() * x.std())
            bound = level * float(np.sqrt(_long_run_variance(product - product.mean()) / len(product)))
            probes.append(Probe(name, float(product.mean()), bound, lag * step))
        if probes:
            found.append(max(probes, key=_over_bound))
    return tuple(sorted(found, key=_over_bound, reverse=True))


def _over_bound(probe: Probe) -> float:
    return abs(probe.correlation) / probe.bound


def _pair(target: Array, values: Array, lag: int, ar1: float) -> tuple[Array, Array]:
    """Prewhitened residual and variable ``lag`` entries earlier, where both are known."""
    e, x = quasi_difference(target[lag:], ar1), quasi_difference(earlier(values, lag), ar1)
    there = np.isfinite(e) & np.isfinite(x)
    return e[there], x[there]


def _long_run_variance(values: Array) -> float:
    """Long-run variance of a series with Bartlett weights; at least that of a white series."""
    count = len(values)
    widest = int(4.0 * (count / 100.0) ** (2.0 / 9.0))
    white = float(values @ values) / count
    total = white
    for lag in range(1, widest + 1):
        total += 2.0 * (1.0 - lag / (widest + 1.0)) * float(values[lag:] @ values[:-lag]) / count
    return max(total, white)
