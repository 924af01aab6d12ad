"""What makes up for the formula of an effect beside it: its value moves in the fit, and that is no finding.

- No power is quite a valve's curve. Where commands are small the curve's value at a full command is a guess, and a gain takes
  what the power is off by.
- A spool that is only as fast as its pilot lets it lags less behind a steep command than a limit and a lag in series would. So
  the lag that was known gets shorter beside a limit that was not.
- A pump that gives out slows all axes by one factor in the formula, and in a circuit most the one that has to push hardest. So
  gains, sides and what the load takes move beside its limit.
"""

from __future__ import annotations

from collections.abc import Set

from sysid.gap.candidates import Candidate
from sysid.gap.fit import Fit

#: What makes an axis faster or slower by a factor.
SPEEDS = ("gain_error", "asymmetric_gain", "load_dependent_flow")


def makeshift(fit: Fit, strange: bool) -> list[Candidate]:
    """Effects of a fit whose departure makes up for another's formula.

    Args:
        strange: whether the stage stays far from explained, so that formulas are off.
    """
    there = {(c.effect.name, c.target) for c in fit.candidates if not c.nuisance}
    return [c for c in fit.candidates if _beside(c, there, strange) or _shortened(c, fit, there)]


def _beside(candidate: Candidate, there: Set[tuple[str, str]], strange: bool) -> bool:
    name, target = candidate.effect.name, candidate.target
    curved = name == "gain_error" and ("gain_curve", target) in there
    starved = name in SPEEDS and ("pump_flow_limit", "machine") in there
    return strange and (curved or starved)


def _shortened(candidate: Candidate, fit: Fit, there: Set[tuple[str, str]]) -> bool:
    if candidate.effect.name != "first_order_lag" or ("command_rate_limit", candidate.target) not in there:
        return False
    return float(fit.values_of(candidate)[0]) < candidate.unknowns[0].nominal
