"""The report: one self-contained HTML page."""

from sysid.reports.inputs import ReportInputs
from sysid.reports.report import build_report, write_report

__all__ = ["ReportInputs", "build_report", "write_report"]
