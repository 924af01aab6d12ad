"""Console output of a dataset version: recordings, samples, clocks; coverage, noise and excitation before any fit; flags,
findings and what the roles lack; suggested roles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.cli.output import Printer, command
from sysid.display import NOTHING, percent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from sysid.datasets import Dataset, Recording
    from sysid.datasets.checks.finding import Finding
    from sysid.datasets.checks.roles import Lack
    from sysid.datasets.quality.evidence import DatasetEvidence
    from sysid.datasets.split_suggestion import SplitSuggestion
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
            f"{100.0 * _complete(recording):.1f} %",
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


def _complete(recording: Recording) -> float:
    """Share of the cells of a recording that have a value."""
    from sysid.datasets.chunked import missing

    there = sum(len(recording) - missing(recording.values(signal)) for signal in recording.signals)
    return there / max(len(recording) * len(recording.signals), 1)


def show_quality(location: str, reference: str | None, out: Printer) -> None:
    """Print evidence, flags and the verdict for every effect, and write them as JSON."""
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
    show_evidence(out, evidence, dataset)
    show_flags(out, flags)
    show_findings(out, findings)
    found = show_roles(out, dataset, location, needs=False)  # the verdicts have them
    show_excitation(out, verdicts, dataset)
    out.line(f"Pictures: {command('report', dataset.reference, workspace=location)}")
    out.json(
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
    firsts = [(group, group.verdicts[0]) for group in by_effect(ready, dataset.machine)]
    lines = [(group.title, group.places, spread(group), f"{first.need:g}", first.unit) for group, first in firsts]
    out.table(("ready", "where", "have", "need", "of what"), lines, right=(2, 3))
    for reason, groups in by_reason(hidden, dataset.machine):
        out.entry(f"cannot be shown: {reason}")
        for group in groups:
            out.entry(f"{group.title}: {group.places}", "  ")


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


def show_suggestion(location: str, reference: str, out: Printer) -> None:
    """Present and suggested roles side by side, and the command or the lines of the recipe that apply the suggestion."""
    from sysid.datasets import Store
    from sysid.datasets.checks.roles import unmet_need
    from sysid.datasets.split_suggestion import recipe_splits, suggest_split

    store = Store(location)
    manifest = store.manifest(reference)
    dataset = store.load(f"{manifest['name']}@{manifest['version']}")
    texts = dict.fromkeys(part["made"]["recipe"] for part in manifest["parts"])
    found = suggest_split(dataset, [recipe_splits(text, f"{dataset.reference}: recipe") for text in texts if text])
    _show_motion(out, found)
    _show_recordings(out, found)
    if found.named:
        out.line(f"named in the recipe, unchanged: {_some(found.named)}")
    need = unmet_need(dataset)
    if need is not None and not found.better:
        out.line(f"note: {need.text}")
    elif not found.better:
        lacking = "No other roles give the axes more motion where it is missing."
        out.line(lacking if found.suggested.lacks else "No role lacks motion.")
    elif found.cut:
        out.line(f"{_some(found.cut)}: cut into a block for each role, so that each contains its motion.")
    _show_lacks(out, "with the present roles", found.present.lacks if found.better else ())
    if need is None or found.better:
        _show_lacks(out, "with the suggestion" if found.better else "lacking", found.suggested.lacks, record=True)
    for test, other in found.repeats:
        out.line(
            f"{test} (test) has the same commands as {other}: its error shows repeatability, not accuracy on other motion."
        )
    applied = found.command(location)
    if applied:
        out.line("Apply it to this version:")
        out.line(f"  {applied}")
    if found.recipe:
        out.line(
            "Or write it in the recipe, and ingest the logs again:" if applied else "Write in the recipe, and ingest again:"
        )
        out.block("\n".join(f"  {line}" for line in found.recipe.splitlines()))
    out.json(found.to_json(location))


def _show_motion(out: Printer, found: SplitSuggestion) -> None:
    """Seconds of motion per direction, and reversals, of every axis in each role."""
    from sysid.datasets.checks.roles import ROLE_NAMES, ROLES

    shown = {"now": found.present, **({"suggested": found.suggested} if found.better else {})}
    rows: list[tuple[str, ...]] = []
    for axis in found.present.motion["fit"]:
        for number, role in enumerate(ROLES):
            cells = [axis if number == 0 else "", ROLE_NAMES[role]]
            for one in shown.values():
                motion = one.motion[role][axis]
                cells += [f"{motion.backward_s:.1f} / {motion.forward_s:.1f}", f"{motion.reversals:.0f}"]
            rows.append(tuple(cells))
    columns = [column for title in shown for column in (f"{title} s − / +", "reversals")]
    out.table(("axis", "role", *columns), rows, right=range(2, 6))
    for title, one in shown.items():
        out.line(f"{title}: {', '.join(f'{ROLE_NAMES[role]} {one.seconds[role]:.0f} s' for role in ROLES)}")


def _show_recordings(out: Printer, found: SplitSuggestion) -> None:
    from sysid.datasets.checks.roles import ROLE_NAMES

    changed = {**dict.fromkeys(found.cut, "cut"), **{name: ROLE_NAMES[role] for name, role in found.changed.items()}}
    rows = [
        (name, f"{found.seconds[name]:.1f} s", ROLE_NAMES[found.present.roles[name]], changed[name])
        for name in found.present.roles
        if name in changed
    ]
    out.table(("recording", "length", "now", "suggested"), rows, right=(1,))


def _show_lacks(out: Printer, title: str, lacks: Sequence[Lack], *, record: bool = False) -> None:
    for lack in lacks:
        out.line(f"{title}: {lack.text}")
        if record:
            out.line(f"  → {lack.record}")


def _some(names: Sequence[str], most: int = 8) -> str:
    """Names, the first ones where there are many."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
