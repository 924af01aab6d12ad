"""Findings about one axis: command range, positions, response, linkage, and sizes in its description; over all recordings, and
in some recordings only, where one layout, logger or day of several has another unit, sign or column; and columns of two axes
that are exchanged, where each axis follows the command of the other and not its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.plausibility.figures import LEAST_STRENGTH, AxisFigures, Measure, cost_of, measures_of, pairs_of, span_of
from sysid.datasets.plausibility.finding import Cause, Evidence, Finding, Severity, interval, plain, ratio_text, value
from sysid.datasets.plausibility.mistakes import Explanation, explanations_of, signal_of
from sysid.datasets.plausibility.response import Motion, changes, correlation, motion_of, response_of, strengths
from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.machine.rigid_body import moves_masses
from sysid.names import uncut_name
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Ratio of the gain that the recordings show to an estimated one from which it is said, and from which the error of the gain
#: hides those of the effects.
FAR, HIDES = 2.0, 5.0
#: The figure that gives a finding its key, where several are implausible.
_ORDER = ("command", "driven", "joint", "response", "ends", "expected")


@dataclass(frozen=True)
class AxisFinding:
    """A finding about one axis, before equal ones of several axes are merged."""

    axis: str
    key: str
    level: int
    evidence: tuple[Evidence, ...]
    explanations: tuple[Explanation, ...]


def figures_of(
    recordings: Sequence[Recording],
    machine: Machine,
    axis: Axis,
    units: Mapping[str, str],
    rate_ratio: float | None,
    time_scale: float,
) -> AxisFigures:
    """Figures of an axis.

    Args:
        units: signal → SI unit that the logs or the recipe state.
        rate_ratio: sample rate of the streams / rate of the grid.
        time_scale: stamps / true time, where their unit is known to be wrong.
    """
    motion = [recording for recording in recordings if recording.kind == "motion"]
    joint = axis_signal(axis.name, "joint")
    own = axis.drives == "joint"
    return AxisFigures(
        axis=axis,
        unit=machine.expected_unit(joint) or {"rad": "rad", "m": "m"}.get(units.get(joint, "")),
        command=span_of(motion, axis_signal(axis.name, "command")),
        driven=span_of(recordings, axis.driven),
        joint=None if own else span_of(recordings, joint),
        ends=axis.limits if own else axis.stroke,
        joint_ends=None if own else axis.limits,
        # Gravity and the other axes of an arm move an axis too: its force alone does not give its acceleration.
        response=None
        if axis.actuation == "force" and moves_masses(machine)
        else response_of(motion_of(motion, axis, axis.driven, time_scale), axis),
        expected={"velocity": axis.gain, "position": 1.0, "servo": 1.0, "force": axis.inertia or 1.0}[axis.actuation],
        pairs=pairs_of(recordings, axis),
        rate_ratio=rate_ratio,
    )


def usual_gain(whole: AxisFigures, parts: Sequence[AxisFigures]) -> tuple[float, Finding | None]:
    """The median speed at full command over recordings of a valve axis whose ``gain`` nobody states, and what to write.

    Args:
        whole: over all recordings; ``parts``: of each.
    """
    axis, responses = whole.axis, [part.response for part in parts]
    found = [abs(own.value) for own in responses if own is not None and own.strength >= LEAST_STRENGTH["velocity"]]
    usual = sorted(found)[len(found) // 2] if found else 0.0
    if usual == 0.0 or 1.0 / FAR <= usual / axis.gain <= FAR:
        return usual or axis.gain, None
    unit = "m/s" if axis.drives == "cylinder" or whole.unit == "m" else "rad/s" if whole.unit == "rad" else "1/s"
    evidence = Evidence(f"{axis.driven} moves at about {value(usual, unit)} at full command", f"gain = {axis.gain:g}")
    remedy = f'Write `gain = {usual:.3g}` and `estimated = ["gain"]`: then its exact value is found with the effects'
    cause = Cause("`gain` in machine.toml of axis", (axis.name,), "left out, or an estimate", remedy=remedy)
    severity: Severity = "notice" if 1.0 / HIDES <= usual / axis.gain <= HIDES else "severe"
    return usual, Finding((f"{axis.name}:gain",), severity, (evidence,), (cause,))


def axis_finding(figures: AxisFigures) -> AxisFinding | None:
    """What is implausible about an axis, and why; None where nothing is."""
    wrong = [measure for measure in measures_of(figures) if measure.level > 0]
    if not wrong:
        return None
    wrong.sort(key=lambda measure: (_ORDER.index(measure.quantity), measure.kind != "sign"))
    shown = [measure for measure in wrong if measure.kind != "description"] or wrong
    evidence = tuple(dict.fromkeys(Evidence(*_text(measure, figures)) for measure in shown))
    key = f"{_owner(wrong[0], figures)}:{'range' if wrong[0].kind == 'use' else wrong[0].kind}"
    level = max(measure.level for measure in wrong)
    return AxisFinding(figures.axis.name, key, level, evidence, explanations_of(figures))


def merged(findings: Sequence[AxisFinding]) -> list[Finding]:
    """One finding for all axes with the same mistake."""
    groups: dict[object, list[AxisFinding]] = {}
    for finding in findings:
        causes = tuple(explanation.key for explanation in finding.explanations)
        same = (finding.key.rpartition(":")[2], finding.level, causes) if causes else (finding.key,)
        groups.setdefault(same, []).append(finding)
    return [_merged(group) for group in groups.values()]


def _merged(group: Sequence[AxisFinding]) -> Finding:
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


def ranged(findings: Sequence[AxisFinding]) -> set[str]:
    """Axes whose range or description is implausible: whether they move in a role says nothing."""
    return {finding.axis for finding in findings if finding.key.rpartition(":")[2] in ("range", "description", "response")}


def corrections_of(findings: Sequence[AxisFinding]) -> Mapping[str, float]:
    """Axis → factor by which its joint is too large, where that is the likeliest cause."""
    found = {}
    for finding in findings:
        if finding.explanations:
            quantity, factor = finding.explanations[0].key
            if quantity in ("joint", "driven", "command+driven"):
                found[finding.axis] = factor
    return found


def _owner(measure: Measure, figures: AxisFigures) -> str:
    if measure.quantity in ("command", "driven", "joint"):
        return signal_of(figures, measure.quantity)
    return figures.axis.name


def _text(measure: Measure, figures: AxisFigures) -> tuple[str, str]:
    """What was found, and what was expected."""
    axis = figures.axis
    place = "m" if axis.drives == "cylinder" else figures.unit
    if measure.kind == "linkage":
        return _linkage_text(figures)
    if measure.kind == "description":
        return _description_text(measure, figures, place)
    if measure.kind in ("range", "use"):
        return _range_text(measure, figures, place)
    assert figures.response is not None
    driven, command = axis.driven, axis_signal(axis.name, "command")
    if measure.kind == "sign":
        text = f"{driven} moves against {command} (correlation −{figures.response.strength:.2f})"
        return text, "motion in the direction of the command"
    ratio = abs(figures.ratio or 1.0)
    if axis.actuation == "velocity":
        speed = value(abs(figures.response.value), f"{place}/s" if place else "1/s")
        if "gain" in axis.estimated:
            usual = value(figures.expected, f"{place}/s" if place else "1/s")
            return f"{driven} moves at {speed} at full command", f"about {usual} as in the other recordings"
        return f"{driven} moves at {speed} at full command, {ratio_text(ratio)} `gain`", f"about gain = {axis.gain:g}"
    if axis.follows_positions:
        return f"{driven} moves by {plain(ratio)} where {command} moves by 1", "about 1"
    mass = value(abs(figures.response.value), "kg" if place == "m" else None)
    return (
        f"{driven} accelerates as a mass or inertia of {mass} would, {ratio_text(ratio)} `inertia`",
        f"about {axis.inertia:g}",
    )


def _range_text(measure: Measure, figures: AxisFigures, place: str | None) -> tuple[str, str]:
    axis, signal = figures.axis, signal_of(figures, measure.quantity)
    span = {"command": figures.command, "driven": figures.driven, "joint": figures.joint}[measure.quantity]
    assert span is not None
    if measure.quantity == "command" and axis.actuation == "velocity":
        return f"{signal} runs from {span.low:.4g} to {span.high:.4g}", "−1 to 1"
    unit = figures.unit if measure.quantity == "joint" else place
    ends = figures.joint_ends if measure.quantity == "joint" else figures.ends
    assert ends is not None
    name = "stroke" if axis.drives == "cylinder" and measure.quantity == "driven" else "limits"
    return f"{signal} runs from {span.low:.4g} to {value(span.high, unit)}", f"{name} = {interval(*ends, unit)}"


def _linkage_text(figures: AxisFigures) -> tuple[str, str]:
    name = figures.axis.name
    if figures.pairs is not None:
        return f"{name}.joint does not follow {name}.cylinder through `linkage`", f"the angle of the triangle of {name}"
    assert figures.driven is not None
    assert figures.joint is not None
    assert figures.ends is not None
    assert figures.joint_ends is not None
    stroke = figures.driven.width / (figures.ends[1] - figures.ends[0])
    joint = figures.joint.width / (figures.joint_ends[1] - figures.joint_ends[0])
    text = f"{name}.cylinder uses {100 * stroke:.3g} % of its stroke and {name}.joint {100 * joint:.3g} % of its limits"
    return text, "similar shares"


def _description_text(measure: Measure, figures: AxisFigures, place: str | None) -> tuple[str, str]:
    axis = figures.axis
    low, high = (plain(math.exp(edge)) for edge in measure.notice)
    unit = place or ""
    if measure.quantity == "ends":
        assert figures.ends is not None
        name = "stroke" if axis.drives == "cylinder" else "limits"
        text = f"{name} = {interval(*figures.ends, unit)} of axis {axis.name} in machine.toml"
        return text, f"a width between {low} and {high} {unit}"
    return f"gain = {value(axis.gain, f'{unit}/s')} of axis {axis.name} in machine.toml", f"{low} to {high} {unit}/s"


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


#: Correlation with the own command, at most, and with that of another axis, at least, for an exchange. On honest data the own
#: correlation is 0.8 and more for valves, 0.9 and more for servos.
OWN, OTHER = 0.4, 0.65
#: Difference of the costs of ranges that decides which of commands and measurements are exchanged [nats].
DECIDED = 4.0
#: Axes without a response of their own, up to which each is compared with every other.
MOST = 500


@dataclass(frozen=True)
class Exchange:
    """Axes whose columns are exchanged: axis → the axis whose command it follows; and how many were too many to compare."""

    follows: Mapping[str, str]
    too_many: int = 0


def swap_findings(
    recordings: Sequence[Recording], figures: Mapping[str, AxisFigures], time_scale: float = 1.0
) -> tuple[list[Finding], set[str]]:
    """Findings, and the axes concerned, whose other figures then say nothing."""
    motion = [recording for recording in recordings if recording.kind == "motion"]
    axes_of = [f.axis for f in figures.values()]
    driven = _exchange(motion, axes_of, "driven", time_scale)
    with_joints = [f.axis for f in figures.values() if f.joint is not None or f.axis.drives == "joint"]
    cylinders_too = any(f.joint is not None for f in figures.values())
    joints = _exchange(motion, with_joints, "joint", time_scale) if cylinders_too else Exchange({})
    found: list[Finding] = []
    concerned: set[str] = set()
    if driven.follows:
        axes = tuple(driven.follows)
        concerned |= set(axes)
        with_joint = [axis for axis in axes if figures[axis].joint is not None]
        if with_joint and len(with_joint) == len(axes):
            causes = [
                "command" if all(joints.follows.get(axis) == other for axis, other in driven.follows.items()) else "driven"
            ]
        else:
            causes = _by_ranges(driven, figures)
        found.append(_finding(driven, figures, causes))
    if joints.follows and not concerned & set(joints.follows):
        found.append(_finding(joints, figures, ["joint"], measured="joint"))
        concerned |= set(joints.follows)
    if too_many := max(driven.too_many, joints.too_many):
        evidence = Evidence(
            f"{too_many} axes do not follow their own command", f"at most {MOST} to search for exchanged columns"
        )
        found.append(Finding(("machine:exchanged",), "notice", (evidence,)))
    return found, concerned


def _exchange(recordings: Sequence[Recording], axes: Sequence[Axis], quantity: str, time_scale: float) -> Exchange:
    from scipy.optimize import linear_sum_assignment

    follows: dict[str, str] = {}
    for actuation in ("velocity", "position", "servo"):
        suspects: list[tuple[str, Motion, Array]] = []
        for axis in axes:
            if axis.actuation != actuation:
                continue
            motion = motion_of(
                recordings, axis, axis.driven if quantity == "driven" else axis_signal(axis.name, "joint"), time_scale
            )
            moved = motion.speed if actuation == "velocity" else motion.place
            if changes(motion.command) and changes(moved) and abs(correlation(motion.command, moved, motion.delays)) < OWN:
                suspects.append((axis.name, motion, moved))
        if len(suspects) > MOST:
            return Exchange({}, len(suspects))
        if len(suspects) < 2:
            continue
        strength = strengths(
            np.column_stack([motion.command for _, motion, _ in suspects]),
            np.column_stack([moved for _, _, moved in suspects]),
            suspects[0][1].delays,
        )
        for command, answer in zip(*map(np.ndarray.tolist, linear_sum_assignment(-strength)), strict=True):
            if command != answer and strength[command, answer] > OTHER:
                follows[suspects[answer][0]] = suspects[command][0]
    # An exchange is complete: each column that is missed by one axis is found at another.
    return Exchange(follows if set(follows) == set(follows.values()) else {})


def _by_ranges(exchange: Exchange, figures: Mapping[str, AxisFigures]) -> list[str]:
    """Commands or measurements: with the right one corrected, positions lie within the ends of their axes."""
    as_it_is = sum(cost_of(replace(figures[axis], response=None)) for axis in exchange.follows)
    exchanged = sum(
        cost_of(replace(figures[other], response=None, driven=figures[axis].driven, pairs=None))
        for axis, other in exchange.follows.items()
    )
    if exchanged < as_it_is - DECIDED:
        return ["driven"]
    return ["command"] if as_it_is < exchanged - DECIDED else ["command", "driven"]


def _finding(
    exchange: Exchange, figures: Mapping[str, AxisFigures], causes: Sequence[str], measured: str = "driven"
) -> Finding:
    def signal(axis: str, quantity: str) -> str:
        return figures[axis].axis.driven if quantity == "driven" else axis_signal(axis, quantity)

    axes = list(exchange.follows)
    evidence = tuple(
        Evidence(f"{signal(axis, measured)} follows {other}.command, not {axis}.command", "each axis to follow its own command")
        for axis, other in exchange.follows.items()
    )
    named = tuple(
        Cause("the columns", tuple(signal(axis, cause) for axis in axes), "exchanged", 1.0, "Correct the recipe")
        for cause in causes
    )
    keys = tuple(f"{signal(axis, measured)}:exchanged" for axis in axes)
    return Finding(keys, "severe", evidence, named)
