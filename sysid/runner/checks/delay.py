"""Whether the machine answers commands as soon as its plant says, whatever the stamps say."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.runner.checks.settings import CheckSettings
from sysid.runner.cycle import Violation
from sysid.runner.state_estimator import StateEstimate


def check_delay(seen: StateEstimate, settings: CheckSettings, axes: Sequence[str]) -> list[Violation]:
    """One verdict for each axis that answers late while it moves."""
    rule, found = settings.delay, []
    for late in seen.late:
        text = f"{axes[late.axis]} answers commands {1e3 * late.seconds:.0f} ms later than its plant: the line is late"
        found.append(Violation("delay", axes[late.axis], rule.reaction, late.seconds, rule.after_s, text))
    return found
