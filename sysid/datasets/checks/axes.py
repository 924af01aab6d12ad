"""Checks of one axis after the other, by its figures: over all recordings; and in some recordings only, where one layout,
logger or day of several has another unit, sign or column.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from sysid.datasets.checks.figures import AxisFigures, CheckContext
from sysid.datasets.checks.finding import Cause, Evidence, Finding, Severity, with_unit
from sysid.datasets.checks.measures import LEAST_STRENGTH, Measure, measures_of
from sysid.datasets.checks.mistakes import Explanation, explanations_of

#: Ratio of the gain that the recordings show to an estimated one from which it is said, and from which the error of the gain
#: hides those of the effects.
FAR, HIDES = 2.0, 5.0
#: The figure that gives a finding its key, where several are implausible.
_ORDER = ("command", "driven", "joint", "response", "ends", "expected")
#: Quantities that a file states; the description of the machine is the same for all recordings.
OF_FILES = ("command", "driven", "joint")
#: Least range of the commands, as a share of that in all recordings: little motion is mostly backlash and friction.
COMMANDED = 0.3


def check_gains(data: CheckContext) -> Iterator[Finding]:
    """The speed at full command of a valve axis against a ``gain`` that nobody states: expected is that of most recordings."""
    for name, whole in data.figures.items():
        axis, response = whole.axis, whole.response
        if axis.actuation != "velocity" or "gain" not in axis.estimated or response is None:
            continue
        responses = [data.figures_of(blocks, axis).response for blocks in data.by_recording.values()]
        found = [abs(own.value) for own in responses if own is not None and own.strength >= LEAST_STRENGTH["velocity"]]
        usual = sorted(found)[len(found) // 2] if found else 0.0
        data.usual_gains[name] = usual or axis.gain
        data.figures[name] = replace(whole, expected=abs(response.value) or whole.expected)
        if usual == 0.0 or 1.0 / FAR <= usual / axis.gain <= FAR or data.time_scale != 1.0:
            continue
        unit = f"{whole.driven_unit}/s" if whole.driven_unit else "1/s"
        evidence = Evidence(f"{axis.driven} moves at about {with_unit(usual, unit)} at full command", f"gain = {axis.gain:g}")
        remedy = f'Write `gain = {usual:.3g}` and `estimated = ["gain"]`: then its exact value is found with the effects'
        cause = Cause("`gain` in machine.toml of axis", (name,), "left out, or an estimate", remedy=remedy)
        severity: Severity = "notice" if 1.0 / HIDES <= usual / axis.gain <= HIDES else "severe"
        yield Finding((f"{name}:gain",), severity, (evidence,), (cause,))


@dataclass(frozen=True)
class AxisFinding:
    """A finding about one axis, before equal ones of several axes are merged."""

    axis: str
    key: str
    level: int
    evidence: tuple[Evidence, ...]
    explanations: tuple[Explanation, ...]


def check_axes(data: CheckContext) -> list[Finding]:
    """Command range, positions, response, linkage, and sizes in the description, over all recordings."""
    single = [finding for figures in data.clear if (finding := _axis_finding(figures)) is not None]
    for finding in single:
        data.unclear.add(finding.axis)
        if finding.key.rpartition(":")[2] in ("range", "description", "response"):
            data.doubtful.add(finding.axis)
        if finding.explanations:
            quantity, factor = finding.explanations[0].key
            if quantity in ("joint", "driven", "command+driven"):
                data.corrections[finding.axis] = factor
    return _merged(single)


def check_recordings(data: CheckContext) -> Iterator[Finding]:
    """A severe finding for each mistake that explains the figures of some recordings of motion, but not of all.

    Only of axes that are plausible over all recordings.
    """
    parts = data.by_recording
    if len(parts) < 2:
        return
    groups: dict[tuple[str, ...], list[AxisFinding]] = {}
    for whole in data.clear:
        found: dict[str, AxisFinding] = {}
        for name, blocks in parts.items():
            own = data.figures_of(blocks, whole.axis)
            finding = _of_file(replace(own, expected=data.usual_gains.get(whole.axis.name, whole.expected)), whole)
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
        data.doubtful |= {re.split("[.:]", finding.key)[0] for finding in findings}
        for merged in _merged(findings):
            yield replace(merged, causes=(*merged.causes, *_without_effect(findings)), recordings=some)


def _axis_finding(figures: AxisFigures) -> AxisFinding | None:
    """What is implausible about an axis, and why; None where nothing is."""
    wrong = [measure for measure in measures_of(figures) if measure.level > 0]
    if not wrong:
        return None
    wrong.sort(key=lambda measure: (_ORDER.index(measure.quantity), measure.kind != "sign"))
    shown = [measure for measure in wrong if measure.kind != "description"] or wrong
    evidence = tuple(dict.fromkeys(measure.evidence() for measure in shown if measure.evidence is not None))
    level = max(measure.level for measure in wrong)
    return AxisFinding(figures.axis.name, _key(wrong[0], figures), level, evidence, explanations_of(figures))


def _key(measure: Measure, figures: AxisFigures) -> str:
    owner = figures.signal(measure.quantity) if measure.quantity in OF_FILES else figures.axis.name
    return f"{owner}:{'range' if measure.kind == 'use' else measure.kind}"


def _of_file(figures: AxisFigures, whole: AxisFigures) -> AxisFinding | None:
    """A severe finding that mistakes in the file explain, with these alone."""
    if figures.command is None or whole.command is None or figures.command.width < COMMANDED * whole.command.width:
        return None
    finding = _axis_finding(figures)
    if finding is None or finding.level < 2:
        return None
    kept = tuple(each for each in finding.explanations if each.key[0] in OF_FILES)
    return replace(finding, explanations=kept) if kept else None


def _without_effect(findings: Sequence[AxisFinding]) -> Iterator[Cause]:
    """A motion against its command, which it follows in other recordings, may also not be its own."""
    axes = tuple(finding.axis for finding in findings if finding.key.endswith(":sign"))
    if axes:
        says = "without effect in these recordings: a drive that is off, or in another mode"
        yield Cause("the command of axis", axes, says, remedy="Leave their files out: `left_out` in [recordings] of the recipe")


def _merged(findings: Sequence[AxisFinding]) -> list[Finding]:
    """One finding for all axes with the same mistake."""
    groups: dict[object, list[AxisFinding]] = {}
    for finding in findings:
        causes = tuple(explanation.key for explanation in finding.explanations)
        same = (finding.key.rpartition(":")[2], finding.level, causes) if causes else (finding.key,)
        groups.setdefault(same, []).append(finding)
    return [_one_of(group) for group in groups.values()]


def _one_of(group: Sequence[AxisFinding]) -> Finding:
    first = group[0]
    causes = []
    for number, explanation in enumerate(first.explanations):
        cause = explanation.cause
        for other in group[1:]:
            cause = cause.joined(other.explanations[number].cause)
        causes.append(cause)
    return Finding(
        keys=tuple(finding.key for finding in group),
        severity="severe" if first.level > 1 else "notice",
        evidence=tuple(evidence for finding in group for evidence in finding.evidence),
        causes=tuple(causes),
    )
