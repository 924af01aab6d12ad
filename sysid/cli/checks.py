"""What the checks of a dataset say on the console (flags, findings, what the roles lack), and before a search."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.cli.output import Printer, command

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from sysid.datasets import Dataset
    from sysid.datasets.checks.finding import Finding

#: The page that explains the findings.
PAGE = "docs/guide/wrong-data.md"
#: Largest number of listed flags; JSON has all.
MAX_FLAGS = 12
#: Largest number of lacks that ingest and ``--quality`` list; ``--suggest`` and JSON have all.
MAX_LACKS = 6


def show_flags(out: Printer, flags: Sequence[Mapping[str, Any]]) -> None:
    """Flags of the ingest: counts by kind, and the first ones."""
    from sysid.reports.dataset_texts import flag_lines, kinds_of

    lines = flag_lines(flags)
    if not lines:
        return
    out.entry(f"flagged (values are unchanged unless stated): {kinds_of(lines)}")
    for line in lines[:MAX_FLAGS]:
        out.entry(f"{line.recording} {line.from_s:.2f} s  {line.kind} of {line.signals}: {line.text}", "  ")
    if len(lines) > MAX_FLAGS:
        out.line(f"  … and {len(lines) - MAX_FLAGS} more (the report and --json have them all)")


def show_findings(out: Printer, findings: Sequence[Finding]) -> None:
    """Each finding with its severity and keys; nothing where all is plausible.

    Axes that do not move in a role are left out: :func:`show_roles` lists all that a role lacks.
    """
    from sysid.datasets.checks.roles import STILL

    findings = [finding for finding in findings if finding.kinds != {STILL}]
    if not findings:
        return
    severe = sum(finding.severity == "severe" for finding in findings)
    notices = len(findings) - severe
    counts = [f"{severe} severe"] * bool(severe) + [f"{notices} notice{'s' if notices > 1 else ''}"] * bool(notices)
    out.line()
    out.entry(f"Implausible: {', '.join(counts)} ({PAGE})")
    for finding in findings:
        out.line(f"{'SEVERE' if finding.severity == 'severe' else 'notice'}  {', '.join(finding.keys)}")
        for line in finding.lines:
            out.line(f"  {line}")
    if severe:
        out.entry("Severe findings stop `sysid gap`. Correct the recipe or machine.toml, and ingest again.")
    out.line()


def show_roles(out: Printer, dataset: Dataset, location: str, *, needs: bool = True) -> dict[str, Any]:
    """The first need of the gap workflow that is not met, else what the roles lack; the same as JSON values.

    Args:
        needs: print the need; else only what the roles lack.
    """
    from dataclasses import asdict

    from sysid.datasets.checks.roles import role_lacks, unmet_need

    need = unmet_need(dataset)
    if need is not None:
        if needs:
            out.entry(f"note: {need.text}")
        return {"needs": asdict(need), "lacks": []}
    lacks = role_lacks(dataset)
    for lack in lacks[:MAX_LACKS]:
        out.entry(f"note: {lack.text}")
    if len(lacks) > MAX_LACKS:
        out.entry(f"note: {len(lacks) - MAX_LACKS} more of this kind")
    if lacks:
        suggest = command("datasets", "split", dataset.reference, "--suggest", workspace=location)
        out.line(f"Roles and what to record: {suggest}")
    return {"needs": None, "lacks": [asdict(lack) for lack in lacks]}


def show_checked(out: Printer, left: Sequence[Finding], findings: Sequence[Finding]) -> None:
    """Print the findings before a search: those that stop it, else one line each.

    Args:
        left: severe ones that are not accepted.
        findings: all.
    """
    show_findings(out, left)
    if left:
        return
    for finding in findings:
        word = "accepted" if finding.severity == "severe" else "notice"
        out.entry(f"{word}: {', '.join(finding.keys)}: {finding.lines[0]}")
