"""The report: one self-contained HTML page."""

from sysid.reports.inputs import ReportInputs, VersionNote
from sysid.reports.report import build_report, write_report

__all__ = ["ReportInputs", "VersionNote", "build_report", "write_report"]
