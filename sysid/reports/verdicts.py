"""Excitation verdicts grouped and formatted for terminal and report."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from sysid import display
from sysid.gap.experiment.excitation_verdict import ExcitationVerdict, RecordingRequest
from sysid.machine import Axis, Machine
from sysid.reports import words
from sysid.signals import axis_signal

#: Side of the joint sensor → text.
SIDES = {"drive": "ahead of the sensor", "structure": "behind the sensor"}
_SHARE = re.compile(r"(?P<share>\d+ %|half) of (its|the) range")


@dataclass(frozen=True)
class VerdictGroup:
    """Verdicts with the same effect as one line."""

    title: str
    verdicts: tuple[ExcitationVerdict, ...]

    @property
    def places(self) -> str:
        """``slew, boom ahead of the sensor; boom behind the sensor``."""
        sides: dict[str, dict[str, None]] = {}
        for verdict in self.verdicts:
            sides.setdefault(SIDES.get(verdict.side or "", ""), {})[words.owner_name(verdict.target)] = None
        return "; ".join(f"{', '.join(targets)} {side}".rstrip() for side, targets in sides.items())


def place(verdict: ExcitationVerdict) -> str:
    """The target, with the side of its joint sensor if there are two."""
    return f"{words.owner_name(verdict.target)} {SIDES.get(verdict.side or '', '')}".rstrip()


def by_effect(verdicts: Sequence[ExcitationVerdict], machine: Machine) -> list[VerdictGroup]:
    """One group for each effect and title, in the order of the chain."""
    found: dict[str, list[ExcitationVerdict]] = {}
    for verdict in verdicts:
        found.setdefault(words.effect_title(verdict.name, verdict.target, machine), []).append(verdict)
    return [VerdictGroup(title, tuple(group)) for title, group in found.items()]


def by_reason(verdicts: Sequence[ExcitationVerdict], machine: Machine) -> list[tuple[str, list[VerdictGroup]]]:
    """Reason → effects that are not observable because of it, the reason with most effects first."""
    found: dict[str, list[ExcitationVerdict]] = {}
    for verdict in verdicts:
        found.setdefault(verdict.text, []).append(verdict)
    groups = [(reason, by_effect(group, machine)) for reason, group in found.items()]
    return sorted(groups, key=lambda item: -sum(len(group.verdicts) for group in item[1]))


def amount(verdict: ExcitationVerdict) -> str:
    """``39 of 60``: available of needed."""
    if verdict.have is None or verdict.need is None:
        return display.NOTHING
    return f"{_count(verdict.have, verdict.need)} of {verdict.need:g}"


def spread(group: VerdictGroup) -> str:
    """``35 to 98``: the smallest and the largest count of a group."""
    counts = sorted({v.have for v in group.verdicts if v.have is not None})
    if not counts:
        return display.NOTHING
    need = max(v.need or 0.0 for v in group.verdicts)
    ends = list(dict.fromkeys(_count(value, need) for value in (counts[0], counts[-1])))
    return " to ".join(ends)


def request_text(request: RecordingRequest, machine: Machine) -> str:
    """What to record; shares of a range are followed by their size in degrees or millimetres."""
    axes = [machine.axis(name) for name in dict.fromkeys(target for _, target in request.effects) if name in machine.axis_names]

    def sized(match: re.Match[str]) -> str:
        share = 0.5 if match["share"] == "half" else float(match["share"].split()[0]) / 100.0
        sizes = [(axis.name, size) for axis in axes if (size := _size(axis, share, machine))]
        listed = ", ".join(size if len(sizes) == 1 else f"{name} {size}" for name, size in sizes)
        return f"{match[0]} ({listed})" if sizes else match[0]

    return _SHARE.sub(sized, request.record)


def _size(axis: Axis, share: float, machine: Machine) -> str:
    """A share of the axis's joint range, else of its driven signal; empty if the range is unknown."""
    signal, ends = (axis_signal(axis.name, "joint"), axis.limits) if axis.limits is not None else (axis.driven, axis.range)
    span = ends[1] - ends[0]
    unit = machine.expected_unit(signal)
    return display.quantity(share * span, unit, 2) if 0.0 < span < float("inf") and unit is not None else ""


def _count(have: float, need: float) -> str:
    """A whole number, unless rounding would change the comparison with ``need``."""
    whole = f"{have:.0f}"
    return whole if (float(whole) >= need) == (have >= need) else display.number(have)
