"""Inputs of a report. All but the dataset are optional; sections without their input are left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sysid.datasets.clocks.residual import ClockResidual
from sysid.datasets.recording import Dataset
from sysid.gap.experiment.excitation_verdict import ExcitationReport
from sysid.gap.result import GapResult
from sysid.registry import ModelVersion
from sysid.validate import ValidationReport


@dataclass(frozen=True)
class ReportInputs:
    """The inputs of :func:`sysid.reports.build_report`.

    Args:
        dataset: the dataset version.
        gap: its gap result.
        validations: error reports of the networks fitted on it.
        versions: networks fitted on it, and plants of its gap result, oldest first.
        created: time of the report as text; empty to leave it out, so that the report is reproducible.
        excitation: which effects the recordings excite.
        software: name → version of the packages that computed the figures.
        clocks: residuals of the clock alignment.
    """

    dataset: Dataset
    gap: GapResult | None = None
    validations: tuple[ValidationReport, ...] = ()
    versions: tuple[ModelVersion, ...] = ()
    created: str = ""
    software: Mapping[str, str] = field(default_factory=dict)
    excitation: ExcitationReport | None = None
    clocks: tuple[ClockResidual, ...] = ()
