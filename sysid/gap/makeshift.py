"""What makes up for the formula of an effect beside it: its value moves in the fit, and that is no finding.

- No power is quite a valve's curve. Where commands are small the curve's value at a full command is a guess, and a gain takes
  what the power is off by.
- A spool that is only as fast as its pilot lets it lags less behind a steep command than a limit and a lag in series would. So
  the lag that was known gets shorter beside a limit that was not.
"""

from __future__ import annotations

from sysid.gap.candidates import Candidate
from sysid.gap.fit import Fit


def makeshift(fit: Fit, strange: bool) -> list[Candidate]:
    """Effects of a fit whose departure makes up for another's formula.

    Args:
        strange: whether the stage stays far from explained, so that formulas are off.
    """
    there = {(c.effect.name, c.target) for c in fit.candidates if not c.nuisance}
    return [
        c
        for c in fit.candidates
        if (c.effect.name == "gain_error" and strange and ("gain_curve", c.target) in there)
        or (c.effect.name == "first_order_lag" and _shorter(c, fit) and ("command_rate_limit", c.target) in there)
    ]


def _shorter(lag: Candidate, fit: Fit) -> bool:
    return float(fit.values_of(lag)[0]) < lag.unknowns[0].nominal
