"""Structure that no known effect explains: where it is, on what it depends, in which form. Never a name.

A form is written down only if it predicts recordings that its search did not see. Where no form does, cross-correlations say
whether the remainder follows anything that was measured; where it does not, it is a disturbance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.fit import Fit
from sysid.gap.problem import Problem
from sysid.gap.result import Probe, Unnamed
from sysid.gap.unnamed.formula_search import Judged, find_form
from sysid.gap.unnamed.periodic_disturbance import find_rhythm
from sysid.gap.unnamed.probes import Series, cross_correlations, series_of
from sysid.gap.unnamed.terms import Form
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least share of the variance that a form has to explain on recordings it was not fitted to, and chance that it does by luck.
LEAST, LUCK = 0.06, 0.01
#: Least correlation that counts as a dependence where no form was found.
LEAST_CORRELATION = 0.2
#: Probes that are kept for the reader.
SHOWN = 5
NOTHING = "nothing that was measured"


def describe_remainder(problem: Problem, fit: Fit, recordings: Sequence[Recording], machine: Machine) -> list[Unnamed]:
    """The worst output of the stage: what its remainder follows, and the formula that predicts it.

    Args:
        fit: the best that is known of the stage; what it leaves is described.
        recordings: that may be seen.
    """
    moving = [recording for recording in recordings if recording.kind == "motion"]
    worst: tuple[float, int] | None = None
    for k in range(len(problem.signals)):
        left = [(problem.measured(r) - problem.predict(fit.theta[None], r)[0])[:, k] for r in moving]
        joined = np.concatenate(left) if left else np.empty(0)
        if np.isfinite(joined).any():
            rmse = float(np.sqrt(np.nanmean(joined**2)))
            worst = max(worst, (rmse, k)) if worst is not None else (rmse, k)
    if worst is None:
        return []
    rmse, k = worst
    found = [series_of(problem, fit.theta, recording, machine, k) for recording in moving]
    series = [part for part in found if part is not None]
    if not series:
        return [Unnamed(problem.stage, problem.target, rmse, NOTHING, "measured for too short to say more")]
    return [describe(problem, rmse, problem.signals[k], series, machine)]


def describe(problem: Problem, rmse: float, signal: str, series: Sequence[Series], machine: Machine) -> Unnamed:
    """One output of a stage, from its remainder on each recording."""
    what = "rate of the residual" if series[0].rate else "residual"
    # Where the axis stands still all the time there is no speed to ask about.
    series = [part for part in series if f"speed of {problem.target}" in part.variables] or series
    judged = find_form(series, _waves(problem, machine))
    probes = cross_correlations(series, judged.colour)
    shown = probes[:SHOWN]
    if judged.form.terms and judged.share >= LEAST and judged.p_value <= LUCK:
        form, wave = judged.form, _wave(judged.form)
        text = (
            f"{what} of {signal} ≈ {form} (SI units); explains {int(100.0 * judged.share)} % of it "
            "on recordings that it was not fitted to"
        )
        period, unit = (wave[1], _unit(wave[0], machine)) if wave else (0.0, "")
        return Unnamed(
            problem.stage, problem.target, rmse, ", ".join(_variables(form)), text, judged.share, period, unit, shown
        )  # fmt: skip
    rhythm = find_rhythm(series, judged.colour)
    if rhythm is not None and rhythm.share >= LEAST and rhythm.p_value <= LUCK:
        depends = ", ".join(dict.fromkeys(("time", *(factor.variable for factor in rhythm.modulation))))
        text = (
            f"{what} of {signal} ≈ {rhythm} (SI units), with a phase φ of its own in each recording; explains "
            f"{int(100.0 * rhythm.share)} % of second halves of recordings whose first halves gave no more than the phase"
        )
        return Unnamed(problem.stage, problem.target, rmse, depends, text, rhythm.share, rhythm.period, "s", shown)
    clear = [p for p in probes if abs(p.correlation) > max(p.bound, LEAST_CORRELATION)]
    if clear:
        best = clear[0]
        late = f" {best.lag:.1f} s before" if best.lag > 0.0 else ""
        text = (
            f"{what} of {signal} goes with {best.name}{late} (ρ = {best.correlation:.2f}, chance reaches {best.bound:.2f}), "
            "but no simple form predicts recordings that it was not fitted to"
        )
        return Unnamed(problem.stage, problem.target, rmse, best.name, text, probes=shown)
    return Unnamed(problem.stage, problem.target, rmse, NOTHING, _nothing(problem, what, series, probes, judged), probes=shown)


def _nothing(problem: Problem, what: str, series: Sequence[Series], probes: Sequence[Probe], judged: Judged) -> str:
    strongest = f" (the clearest is {probes[0].name}: ρ = {probes[0].correlation:.2f}, chance reaches {probes[0].bound:.2f})"
    text = f"{what}: follows no probe to speak of{strongest if probes else ''}"
    if series[0].rate:
        share = _share_of_speed(series, f"speed of {problem.target}")
        return f"{text}; it looks like a random disturbance of about {100.0 * share:.1f} % of the speed"
    wanders = judged.colour > 0.9
    return f"{text}; it looks like {'something that wanders at random' if wanders else 'a random disturbance'}"


def _share_of_speed(series: Sequence[Series], name: str) -> float:
    """RMS of the residual's rate over RMS of the speed, while moving."""
    rate = np.concatenate([part.target for part in series])
    speed = np.concatenate([part.filtered(part.variables[name]) for part in series if name in part.variables] or [0.0 * rate])
    there = np.isfinite(rate)
    moving = there & (np.abs(speed) > 0.1 * np.abs(speed).max(initial=0.0))
    return float(np.sqrt(np.mean(rate[moving] ** 2) / np.mean(speed[moving] ** 2))) if moving.any() else 0.0


def _waves(problem: Problem, machine: Machine) -> tuple[str, ...]:
    """What a remainder may repeat itself over."""
    if problem.target in machine.axis_names:
        return (machine.axis(problem.target).driven,)
    return tuple(axis_signal(name, "joint") for name in machine.axis_names)


def _wave(form: Form) -> tuple[str, float] | None:
    waves = [term.wave for term in form.terms if term.wave is not None]
    return (waves[0].variable, waves[0].number) if waves else None


def _variables(form: Form) -> tuple[str, ...]:
    return tuple(dict.fromkeys(variable for term in form.terms for variable in term.variables))


def _unit(variable: str, machine: Machine) -> str:
    return "s" if variable == "time" else (machine.expected_unit(variable) or ("m" if variable.endswith(".cylinder") else ""))
