"""What a dataset shows, as text for terminal, report and site: flags of ingest, one line per event with its signals, the most
severe kinds first; what became of the samples of each signal; how many clocks are aligned; excitation verdicts in groups.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from sysid import display
from sysid.datasets.chunked import missing
from sysid.datasets.quality.evidence import DatasetEvidence
from sysid.datasets.quality.sample_counts import SampleCounts, stored_counts, together
from sysid.datasets.quality.use import AxisUse
from sysid.datasets.recording import ClockRecord, Dataset
from sysid.display import NOTHING
from sysid.figures import Table
from sysid.gap.experiment.excitation_verdict import ExcitationVerdict, RecordingRequest
from sysid.machine import Axis, Machine
from sysid.reports import words
from sysid.signals import axis_signal

#: Kinds with wrong values before kinds with missing values.
_ORDER = ("marker_swap", "jump", "outlier", "stuck", "saturation", "stamps", "dropout", "jitter")


@dataclass(frozen=True)
class FlagLine:
    """One event in one or more signals."""

    recording: str
    kind: str
    signals: str
    from_s: float
    to_s: float
    text: str


def flag_lines(flags: Sequence[Mapping[str, Any]]) -> list[FlagLine]:
    """``quality["flags"]`` of a dataset version as lines; an event of several signals is one line."""
    events: dict[tuple[str, str, float, float, str], list[str]] = {}
    for flag in flags:
        key = (str(flag["recording"]), str(flag["kind"]), float(flag["from_s"]), float(flag["to_s"]), str(flag["text"]))
        events.setdefault(key, []).append(words.signal_name(str(flag["signal"])))
    ordered = sorted(events.items(), key=lambda item: (_rank(item[0][1]), item[0][0], item[0][2]))
    return [
        FlagLine(recording, kind.replace("_", " "), _listed(names), begin, end, text)
        for (recording, kind, begin, end, text), names in ordered
    ]


def kinds_of(lines: Sequence[FlagLine]) -> str:
    """``4 × marker swap, 23 × dropout``."""
    return ", ".join(f"{count} × {kind}" for kind, count in Counter(line.kind for line in lines).items())


def _rank(kind: str) -> int:
    return _ORDER.index(kind) if kind in _ORDER else 0


def _listed(names: Sequence[str]) -> str:
    """All names, or the first two and the number of others."""
    unique = list(dict.fromkeys(names))
    return ", ".join(unique) if len(unique) <= 3 else f"{', '.join(unique[:2])} and {len(unique) - 2} more"


def sample_table(dataset: Dataset) -> Table:
    """For each signal, in the order of the machine and second sources after the first: samples in the files, those that are
    used, rows with a value (of the first source), and why samples are not used.
    """
    found: dict[tuple[str, bool], list[SampleCounts]] = {}
    for entries in dataset.quality.get("streams", {}).values():
        for key, figures in entries.items():
            found.setdefault((key.rpartition("/")[2], figures["primary"]), []).append(stored_counts(figures))
    rows = []
    for signal, primary in ((signal, primary) for signal in dataset.machine.signals for primary in (True, False)):
        if (signal, primary) in found:
            counts = together(found[signal, primary])
            name, filled = (signal, _filled(dataset, signal)) if primary else (f"{signal} (second)", NOTHING)
            rows.append((name, counts.samples, counts.used, filled, f"{counts.bridged_s:.1f} s", _lost(counts)))
    return Table(("signal", "samples", "used", "filled", "bridged", "not used"), rows, (1, 2, 3, 4))


def _filled(dataset: Dataset, signal: str) -> str:
    """Share of the rows of its recordings that have a value."""
    own = [recording.values(signal) for recording in dataset.recordings if signal in recording.signals]
    rows = sum(map(len, own))
    return display.percent(sum(len(values) - missing(values) for values in own) / rows) if rows else NOTHING


def _lost(counts: SampleCounts) -> str:
    """Why samples are not used, with their numbers."""
    own = {"empty": counts.empty, "repeated": counts.repeated, "in guards between blocks": counts.between}
    return ", ".join(f"{count} {reason}" for reason, count in (own | {**counts.lost}).items() if count) or NOTHING


def noise_table(evidence: DatasetEvidence, dataset: Dataset, spell: Callable[[str], str] = str) -> Table:
    """Standard deviation of the noise of each signal, by source; ``spell``: of the name of a signal."""
    rows = []
    for signal, level in evidence.noise.items():
        values = (level.sheet, level.moving, level.still, level.repeats)
        texts = (NOTHING if value is None else display.quantity(value, dataset.units.get(signal)) for value in values)
        rows.append((spell(signal), *texts))
    return Table(("noise", "data sheet", "its samples", "at rest", "same commands again"), rows, (1, 2, 3, 4))


def use_table(evidence: DatasetEvidence, dataset: Dataset) -> Table:
    """Commands and motion of each axis: shares of its range and of its commands, seconds in either direction, reversals."""
    spans, rows = {span.axis: span for span in evidence.spans}, []
    for name, use in evidence.axes.items():
        span = spans.get(name)
        seen = NOTHING if span is None else display.percent(span.covered_moving) if span.source == "limits" else "no limits"
        visited = f"{display.percent(use.covered(-1))} / {display.percent(use.covered(1))}"
        cells = use_cells(use, dataset.machine.axis(name).follows_positions)
        rows.append((name, seen, visited, *cells, display.fixed(use.idle_s, 1), use.command_changes, use.reversals))
    header = ("axis", "range in motion", "commands − / +", *USES, "idle s", "changes", "reversals")
    return Table(header, rows, range(1, 9))


def use_cells(use: AxisUse, follows_positions: bool) -> tuple[str, str, str]:
    """Seconds in either direction, below :data:`USES`; an axis whose command is a position has no small commands."""
    small = NOTHING if follows_positions else _sides(use.small_negative_s, use.small_positive_s)
    return _sides(use.negative_s, use.positive_s), small, _sides(use.slow_negative_s, use.slow_positive_s)


USES = ("s − / +", "small s − / +", "slow s − / +")


def _sides(negative: float, positive: float) -> str:
    return f"{display.fixed(negative, 1)} / {display.fixed(positive, 1)}"


def rest_sentence(evidence: DatasetEvidence) -> str:
    """How often and how long the machine was at rest."""
    phases = [phase for recording in evidence.recordings for phase in recording.rests]
    if not phases:
        return "The machine was never at rest for a second."
    times, postures = len(phases), len(evidence.postures)
    total, longest = sum(phase.seconds for phase in phases), max(phase.seconds for phase in phases)
    return (
        f"The machine was at rest {times} time{'s' if times > 1 else ''}, {display.number(total)} s in all, at most "
        f"{display.number(longest)} s, in {postures} different posture{'s' if postures > 1 else ''}."
    )


def flag_table(lines: Sequence[FlagLine]) -> Table:
    """Events that ingest flagged."""
    rows = [
        (
            line.recording,
            line.signals,
            line.kind,
            f"{display.fixed(line.from_s, 2)} to {display.fixed(line.to_s, 2)}",
            line.text,
        )
        for line in lines
    ]
    return Table(("Recording", "Signals", "Kind", "From – to [s]", "Details"), rows, (3,))


def file_table(sources: Iterable[tuple[str, int, str, Sequence[str]]]) -> Table:
    """Raw files: path, size in bytes, sha256, what could not be read."""
    rows = [
        (path, display.size_text(size), Markup("<code>{}…</code>").format(sha256[:16]), "; ".join(losses))
        for path, size, sha256, losses in sources
    ]
    return Table(("File", "Size", "sha256", "Losses"), rows, (1,))


#: Role of a recording in the split → its name on pages.
ROLES = {"fit": "fit", "select": "selection", "held_out": "held out"}


def role_text(kind: str, role: str | None) -> str:
    """The role of a recording; static poses have none."""
    return "static poses" if kind == "poses" else ROLES.get(role or "", "no role")


def length_text(kind: str, rows: int, rate_hz: float) -> str:
    """``61.2 s``, or ``60 poses``."""
    return f"{rows} poses" if kind == "poses" else f"{rows / rate_hz:.1f} s"


def clock_text(clock: ClockRecord) -> str:
    """``+0.300012 s ± 0.104 ms, skew +12.1 ppm``."""
    if not clock.applied:
        return f"not aligned: {clock.reason}"
    text = f"{clock.offset_s:+.6f} s ± {1e3 * half_offset(clock):.3f} ms, skew {clock.skew_ppm:+.1f} ppm"
    return text.replace("-", display.MINUS)


def half_offset(clock: ClockRecord) -> float:
    """Half of the 95 % interval of the offset of a clock [s]."""
    low, high = clock.offset_interval95
    return 0.5 * (high - low)


def clock_table(clocks: Sequence[ClockRecord]) -> Table:
    """Offset and skew of each clock with half of their intervals, and what it was aligned on or why it was not."""
    rows: list[tuple[str, ...]] = []
    for clock in clocks:
        signals, low, high = ", ".join(clock.used_signals), *clock.skew_interval95
        offset = display.fixed(clock.offset_s, 6), display.fixed(1e3 * half_offset(clock), 3)
        figures = (*offset, display.fixed(clock.skew_ppm, 1), display.fixed(0.5 * (high - low), 1))
        why = Markup('{} <span class="quiet">({})</span>').format(signals, clock.reason) if clock.reason else signals
        shown = (*figures, why) if clock.applied else ("not aligned", "", "", "", clock.reason)
        rows.append((clock.recording, clock.stream, *shown))
    header = ("Recording", "Clock", "Offset [s]", "± [ms]", "Skew [ppm]", "±", "Aligned on")
    row_classes = {number: "refused" for number, clock in enumerate(clocks) if not clock.applied}
    return Table(header, rows, range(2, 6), row_classes=row_classes)


#: An offset whose 95 % interval is wider than this is of no use at the usual rate of 100 Hz: half a sample [s].
COARSE_S = 0.005


def clock_summary(clocks: Sequence[ClockRecord]) -> str:
    """How many clocks are aligned, and which are known less exactly or not at all."""
    fine = sum(clock.applied and half_offset(clock) <= COARSE_S for clock in clocks)
    coarse = [clock.recording for clock in clocks if clock.applied and half_offset(clock) > COARSE_S]
    left = [clock.recording for clock in clocks if not clock.applied]
    parts = [f"{fine} of {len(clocks)} clocks are aligned to within {1e3 * COARSE_S:.0f} ms"]
    parts += [f"{', '.join(coarse)}: known less exactly"] if coarse else []
    parts += [f"{', '.join(left)}: not aligned"] if left else []
    return "; ".join(parts) + "."


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
