"""Findings of plausibility on the console, and the stop before a search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sysid.cli.output import Printer

if TYPE_CHECKING:
    from sysid.datasets import Dataset
    from sysid.datasets.checks.finding import Finding

#: The page that explains the findings.
PAGE = "docs/guide/wrong-data.md"


def show_findings(out: Printer, findings: Sequence[Finding]) -> None:
    """Each finding with its severity and keys; nothing where all is plausible.

    Axes that do not move in a role are left out: :func:`sysid.cli.roles.show_roles` lists all that a role lacks.
    """
    from sysid.datasets.checks.roles import STILL

    findings = [finding for finding in findings if finding.kinds != {STILL}]
    if not findings:
        return
    severe = sum(finding.severity == "severe" for finding in findings)
    notices = len(findings) - severe
    counts = [f"{severe} severe"] * bool(severe) + [f"{notices} notice{'s' if notices > 1 else ''}"] * bool(notices)
    out.line()
    out.line(f"Implausible: {', '.join(counts)} ({PAGE})")
    for finding in findings:
        out.line(f"{'SEVERE' if finding.severity == 'severe' else 'notice'}  {', '.join(finding.keys)}")
        for line in finding.lines:
            out.line(f"  {line}")
    if severe:
        out.line("Severe findings stop `sysid gap`. Correct the recipe or machine.toml, and ingest again.")
    out.line()


def checked(out: Printer, dataset: Dataset, accept: Sequence[str]) -> None:
    """Print the findings, and stop where a severe one is not accepted.

    Raises:
        InputError: severe findings that ``accept`` does not name, or a pattern without a finding.
    """
    from sysid.datasets.checks.finding import not_accepted, refuse_severe
    from sysid.datasets.checks.run import check_plausibility

    findings = check_plausibility(dataset)
    left = not_accepted(findings, accept)
    show_findings(out, left)
    refuse_severe(left, (), dataset.reference)
    for finding in findings:
        word = "accepted" if finding.severity == "severe" else "notice"
        out.line(f"{word}: {', '.join(finding.keys)}: {finding.lines[0]}")
