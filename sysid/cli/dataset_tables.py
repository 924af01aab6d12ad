"""Console output of a dataset version: recordings, samples, clocks; coverage, noise and excitation before any fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.cli.output import Printer, command, write_json
from sysid.display import NOTHING, percent

if TYPE_CHECKING:
    from sysid.datasets import Dataset
    from sysid.datasets.quality.evidence import DatasetEvidence
    from sysid.gap.experiment.excitation_verdict import ExcitationReport


def show_dataset(out: Printer, dataset: Dataset) -> None:
    """Recordings, samples, clocks and losses of a dataset version."""
    from sysid.reports.dataset_texts import clock_text, length_text, sample_table

    rows = [
        (
            recording.name,
            recording.kind,
            dataset.splits.get(recording.name, NOTHING),
            length_text(recording.kind, len(recording), recording.rate_hz),
            len(recording.signals),
            f"{100.0 * (1.0 - recording.table.drop(columns='time').isna().to_numpy().mean()):.1f} %",
        )
        for recording in dataset.recordings
    ]
    out.table(("recording", "kind", "role", "length", "signals", "complete"), rows, right=(3, 4, 5))
    out.show(sample_table(dataset))
    for clock in dataset.clocks:
        part = f" ({clock.reason.partition(';')[0]})" if clock.applied and clock.reason.startswith("piece ") else ""
        out.line(f"clock {clock.stream} of {clock.recording}: {clock_text(clock)}{part}")
    for source in dataset.sources:
        for loss in source.losses:
            out.line(f"loss in {source.path}: {loss}")


def show_quality(location: str, reference: str | None, json_file: str | None) -> None:
    """Print evidence, flags and the verdict for every effect, and write them as JSON."""
    from sysid.cli.checks import show_findings, show_flags, show_roles
    from sysid.datasets.checks.run import check_plausibility
    from sysid.datasets.quality.evidence import evidence_of
    from sysid.gap.experiment.excitation_verdict import excitation_report
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    dataset = workspace.dataset(reference)
    evidence = evidence_of(dataset)
    verdicts = excitation_report(dataset, workspace.plant(dataset))
    findings = check_plausibility(dataset)
    flags = list(dataset.quality.get("flags", ()))
    out = Printer(json_file)
    show_evidence(out, evidence, dataset)
    show_flags(out, flags)
    show_findings(out, findings)
    found = show_roles(out, dataset, location, needs=False)  # the verdicts have them
    show_excitation(out, verdicts, dataset)
    out.line(f"Pictures: {command('report', dataset.reference, workspace=location)}")
    write_json(
        json_file,
        {
            "schema": 1,
            "dataset": dataset.reference,
            "evidence": evidence.to_json(),
            "flags": flags,
            "plausibility": [finding.to_json() for finding in findings],
            "readiness": verdicts.to_json(),
            **found,
        },
    )


def show_evidence(out: Printer, evidence: DatasetEvidence, dataset: Dataset) -> None:
    """Commands and motion of each axis, coverage of the joint space, phases of rest, noise."""
    from sysid.reports.dataset_texts import noise_table, rest_sentence, use_table

    out.show(use_table(evidence, dataset))
    if evidence.maps:
        maps = sorted(evidence.maps, key=lambda item: item.covered_moving)
        listed = ", ".join(f"{m.first.axis}–{m.second.axis} {percent(m.covered_moving)}" for m in maps[:6])
        more = f" and {len(maps) - 6} more above" if len(maps) > 6 else ""
        posed = min(m.covered for m in maps)
        poses = f" (with the poses {percent(posed)} or more)" if posed > maps[0].covered_moving else ""
        out.entry(f"joint space, share of cells visited in motion: {listed}{more}{poses}")
    if evidence.together_s:
        both = sorted(evidence.together_s.items(), key=lambda item: item[1])
        listed = ", ".join(f"{a}+{b} {seconds:.0f} s" for (a, b), seconds in both[:6])
        out.entry(f"commanded together: {listed}{f' and {len(both) - 6} pairs longer' if len(both) > 6 else ''}")
    out.entry(rest_sentence(evidence))
    out.show(noise_table(evidence, dataset))


def show_excitation(out: Printer, found: ExcitationReport, dataset: Dataset) -> None:
    """For every effect and location: ready, not enough, or not observable with these sensors."""
    from sysid.reports.dataset_texts import amount, by_effect, by_reason, place, request_text, spread
    from sysid.reports.words import effect_title

    for note in found.notes:
        out.entry(f"note: {note}")
    ready, lacking, hidden = (found.of(status) for status in ("ready", "lacking", "hidden"))
    some = ", ".join(found.counted) or "no recording of motion"
    counted = f"counted in {some if len(found.counted) < 8 else f'{len(found.counted)} recordings'}"
    out.line()
    out.entry(
        f"Excitation of the effects: {len(ready)} ready, {len(lacking)} not enough, {len(hidden)} cannot be shown ({counted})"
    )
    if lacking:
        rows = [(effect_title(v.name, v.target, dataset.machine), place(v), amount(v), v.unit) for v in lacking]
        out.table(("not enough", "where", "have of need", "of what"), rows, right=(2,))
        for request in found.requests:
            out.entry(request_text(request, dataset.machine), "  → ")
        out.line()
    if ready:
        firsts = [(group, group.verdicts[0]) for group in by_effect(ready, dataset.machine)]
        lines = [(group.title, group.places, spread(group), f"{first.need:g}", first.unit) for group, first in firsts]
        out.table(("ready", "where", "have", "need", "of what"), lines, right=(2, 3))
    for reason, groups in by_reason(hidden, dataset.machine):
        out.entry(f"cannot be shown: {reason}")
        for group in groups:
            out.entry(f"{group.title}: {group.places}", "  ")
