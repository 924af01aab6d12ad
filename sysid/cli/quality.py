"""``sysid datasets NAME --quality``: coverage, noise, flags and excitation of a dataset, before any fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.cli.output import Printer, command, write_json

if TYPE_CHECKING:
    from sysid.datasets import Dataset
    from sysid.datasets.quality.evidence import DatasetEvidence
    from sysid.gap.experiment.excitation_verdict import ExcitationReport


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
    from sysid.display import percent, quantity

    spans = {span.axis: span for span in evidence.spans}
    rows = []
    for name, use in evidence.axes.items():
        span = spans.get(name)
        rows.append(
            (
                name,
                "–" if span is None else percent(span.covered_moving) if span.source == "limits" else "no limits",
                f"{percent(use.covered(-1))} / {percent(use.covered(1))}",
                f"{use.negative_s:.0f} / {use.positive_s:.0f}",
                f"{use.small_negative_s:.1f} / {use.small_positive_s:.1f}",
                use.command_changes,
                use.reversals,
                f"{use.slow_negative_s:.1f} / {use.slow_positive_s:.1f}",
            )
        )
    if rows:
        header = (
            *("axis", "range in motion", "commands − / +", "s − / +", "small s − / +"),
            *("changes", "reversals", "slow s − / +"),
        )
        out.table(header, rows, right=range(1, 8))
    if evidence.maps:
        maps = sorted(evidence.maps, key=lambda item: item.covered_moving)
        listed = ", ".join(f"{m.first.axis}–{m.second.axis} {percent(m.covered_moving)}" for m in maps[:6])
        more = f" and {len(maps) - 6} more above" if len(maps) > 6 else ""
        posed = min(m.covered for m in maps)
        poses = f" (with the poses {percent(posed)} or more)" if posed > maps[0].covered_moving else ""
        out.line(f"joint space, share of cells visited in motion: {listed}{more}{poses}")
    if evidence.together_s:
        both = sorted(evidence.together_s.items(), key=lambda item: item[1])
        listed = ", ".join(f"{a}+{b} {seconds:.0f} s" for (a, b), seconds in both[:6])
        out.line(f"commanded together: {listed}{f' and {len(both) - 6} pairs longer' if len(both) > 6 else ''}")
    phases = [phase for recording in evidence.recordings for phase in recording.rests]
    if phases:
        longest = max(phase.seconds for phase in phases)
        out.line(
            f"at rest: {len(phases)} phases, {sum(p.seconds for p in phases):.0f} s in all, the longest {longest:.1f} s, "
            f"in {len(evidence.postures)} different posture{'s' if len(evidence.postures) != 1 else ''}"
        )
    else:
        out.line("at rest: no phase of a second or more")
    noise = []
    for signal, level in evidence.noise.items():
        unit = dataset.units.get(signal)
        values = (level.sheet, level.moving, level.still, level.repeats)
        noise.append((signal, *("–" if value is None else quantity(value, unit) for value in values)))
    out.table(("noise", "data sheet", "its samples", "at rest", "same commands again"), noise, right=range(1, 5))


def show_excitation(out: Printer, found: ExcitationReport, dataset: Dataset) -> None:
    """For every effect and location: ready, not enough, or not observable with these sensors."""
    from sysid.reports.dataset_texts import amount, by_effect, by_reason, place, request_text, spread
    from sysid.reports.words import effect_title

    for note in found.notes:
        out.line(f"note: {note}")
    ready, lacking, hidden = (found.of(status) for status in ("ready", "lacking", "hidden"))
    some = ", ".join(found.counted) or "no recording of motion"
    counted = f"counted in {some if len(found.counted) < 8 else f'{len(found.counted)} recordings'}"
    out.line()
    out.line(
        f"Excitation of the effects: {len(ready)} ready, {len(lacking)} not enough, {len(hidden)} cannot be shown ({counted})"
    )
    if lacking:
        rows = [(effect_title(v.name, v.target, dataset.machine), place(v), amount(v), v.unit) for v in lacking]
        out.table(("not enough", "where", "have of need", "of what"), rows, right=(2,))
        for request in found.requests:
            out.line(f"  → {request_text(request, dataset.machine)}")
        out.line()
    if ready:
        firsts = [(group, group.verdicts[0]) for group in by_effect(ready, dataset.machine)]
        lines = [(group.title, group.places, spread(group), f"{first.need:g}", first.unit) for group, first in firsts]
        out.table(("ready", "where", "have", "need", "of what"), lines, right=(2, 3))
    for reason, groups in by_reason(hidden, dataset.machine):
        out.line(f"cannot be shown: {reason}")
        for group in groups:
            out.line(f"  {group.title}: {group.places}")
