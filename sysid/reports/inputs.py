"""What a report is made of. Everything but the dataset may be missing: the sections that need it are left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sysid.datasets.clocks.residual import ClockResidual
from sysid.datasets.recording import Dataset
from sysid.gap.experiment.excitation_verdict import ExcitationReport
from sysid.gap.result import GapResult
from sysid.validate import ValidationReport


@dataclass(frozen=True)
class VersionNote:
    """One line of the lineage: a dataset, network or plant version, and what it was made from.

    Args:
        reference: ``name@version``.
        kind: dataset, actuator, forward, plant, …
        digest: content address.
        parents: the references it was made from.
        note: anything worth a few words (who is the champion, which recipe).
    """

    reference: str
    kind: str
    digest: str
    parents: tuple[str, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class ReportInputs:
    """The inputs of :func:`sysid.reports.build_report`.

    Args:
        dataset: the dataset version that the report is about.
        gap: the answer of the gap workflow on it.
        validations: error reports of the networks fitted on it.
        versions: lineage, oldest first.
        created: when the report was made, in the words to print; empty to leave it out (a report is then reproducible).
        excitation: which effects the recordings excite.
        software: name → version of what computed the figures.
        clocks: what the aligned motions still differ by.
    """

    dataset: Dataset
    gap: GapResult | None = None
    validations: tuple[ValidationReport, ...] = ()
    versions: tuple[VersionNote, ...] = ()
    created: str = ""
    software: Mapping[str, str] = field(default_factory=dict)
    excitation: ExcitationReport | None = None
    clocks: tuple[ClockResidual, ...] = ()
