"""Mistakes in some recordings only: one layout, logger or day of several has another unit, sign or column.

Over all recordings such an axis may look right. Each recording is therefore compared by itself, where no finding concerns the
axis as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from sysid.datasets.plausibility.axes import AxisFinding, axis_finding, merged
from sysid.datasets.plausibility.figures import AxisFigures
from sysid.datasets.plausibility.finding import Cause, Finding
from sysid.datasets.recording import Recording
from sysid.machine import Axis
from sysid.names import uncut_name

#: Quantities that a file states; the description of the machine is the same for all recordings.
OF_FILES = ("command", "driven", "joint")


#: Least range of the commands, as a share of that in all recordings: little motion is mostly backlash and friction.
COMMANDED = 0.3


def partial_findings(
    recordings: Sequence[Recording],
    whole: Sequence[AxisFigures],
    figures: Callable[[Sequence[Recording], Axis], AxisFigures],
) -> Iterator[Finding]:
    """A severe finding for each mistake that explains the figures of some recordings of motion, but not of all.

    Args:
        whole: figures over all recordings of those axes where they are plausible.
        figures: of one recording (of all its blocks) and axis.
    """
    parts = by_recording(recordings)
    if len(parts) < 2:
        return
    groups: dict[tuple[str, ...], list[AxisFinding]] = {}
    for every in whole:
        found: dict[str, AxisFinding] = {}
        for name, blocks in parts.items():
            finding = _of_file(figures(blocks, every.axis), every)
            if finding is not None:
                found[name] = finding
        if len(found) == len(parts):
            continue
        same: dict[tuple[str, tuple[str, float]], list[str]] = {}
        for name, finding in found.items():
            same.setdefault((finding.key, finding.explanations[0].key), []).append(name)
        for names in same.values():
            groups.setdefault(tuple(names), []).append(found[names[0]])
    for some, findings in groups.items():
        for merged_finding in merged(findings):
            causes = (*merged_finding.causes, *_without_effect(findings))
            yield replace(merged_finding, causes=causes, recordings=some)


def _without_effect(findings: Sequence[AxisFinding]) -> Iterator[Cause]:
    """A motion against its command, which it follows in other recordings, may also not be its own."""
    axes = tuple(finding.axis for finding in findings if finding.key.endswith(":sign"))
    if axes:
        says = "without effect in these recordings: a drive that is off, or in another mode"
        yield Cause("the command of axis", axes, says, remedy="Leave their files out: `left_out` in [recordings] of the recipe")


def by_recording(recordings: Sequence[Recording]) -> dict[str, list[Recording]]:
    """Recording of motion before it was cut → its blocks."""
    parts: dict[str, list[Recording]] = {}
    for recording in recordings:
        if recording.kind == "motion":
            parts.setdefault(uncut_name(recording.name), []).append(recording)
    return parts


def _of_file(figures: AxisFigures, whole: AxisFigures) -> AxisFinding | None:
    """A severe finding that mistakes in the file explain, with these alone."""
    if figures.command is None or whole.command is None or figures.command.width < COMMANDED * whole.command.width:
        return None
    finding = axis_finding(figures)
    if finding is None or finding.level < 2:
        return None
    kept = tuple(each for each in finding.explanations if each.key[0] in OF_FILES)
    return replace(finding, explanations=kept) if kept else None
