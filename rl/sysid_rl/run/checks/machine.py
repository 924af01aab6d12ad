"""Checks of switches, machine faults, the line, the log, and timing."""

from __future__ import annotations

import math

from sysid_rl.run.checks.settings import CheckSettings
from sysid_rl.run.cycle import Violation
from sysid_rl.run.state_estimator import StateEstimate


def check_machine(estimate: StateEstimate, settings: CheckSettings) -> list[Violation]:
    """Violations apart from signals. The loop checks the dead-man switch, only while the machine moves."""
    found = []
    inputs = estimate.inputs
    if inputs.emergency_stop:
        found.append(_plain("emergency", settings, "emergency stop"))
    if inputs.fault:
        found.append(_plain("machine", settings, f"the machine reports: {inputs.fault}"))
    if estimate.line:
        found.append(_plain("line", settings, f"the line is dead: {estimate.line}"))
    if estimate.recording:
        found.append(_plain("recording", settings, f"the log: {estimate.recording}"))
    rule = settings.overrun
    if estimate.lateness_s > rule.late_s:
        text = f"a cycle began {1e3 * estimate.lateness_s:.0f} ms late"
        found.append(Violation("overrun", "machine", rule.reaction, estimate.lateness_s, rule.late_s, text))
    elif estimate.missed >= rule.turns:
        text = f"{estimate.missed} cycles in a row missed their deadline"
        found.append(Violation("overrun", "machine", rule.reaction, float(estimate.missed), float(rule.turns), text))
    return found


def dead_man(settings: CheckSettings) -> Violation:
    """The switch is released."""
    return _plain("dead_man", settings, "the dead-man switch was released")


def _plain(check: str, settings: CheckSettings, text: str) -> Violation:
    return Violation(check, "machine", settings.reaction(check), math.nan, math.nan, text)
