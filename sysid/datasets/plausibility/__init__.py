"""Plausibility of a dataset: units, signs, columns and the description of the machine, before anything is fitted."""

from sysid.datasets.plausibility.check import check_plausibility, findings_of
from sysid.datasets.plausibility.finding import Cause, Evidence, Finding, Severity, not_accepted, refuse_severe

__all__ = ["Cause", "Evidence", "Finding", "Severity", "check_plausibility", "findings_of", "not_accepted", "refuse_severe"]
