"""placeholder until the validation values exist"""

from __future__ import annotations

from typing import Any

from sysid.reports.inputs import ReportInputs


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    return None
