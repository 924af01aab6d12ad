"""Console output of a gap result: what a repair writes, near misses, delays, and the most useful next steps."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from sysid.display import quantity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sysid.cli.output import Printer
    from sysid.datasets import Dataset
    from sysid.figures import ParameterFigure
    from sysid.gap import GapResult
    from sysid.gap.result import NearMissResult, WrittenEffect
    from sysid.machine import EffectKey

#: Columns of a sentence, and names of recordings in one.
WIDTH, RECORDINGS = 80, 8
#: Next steps and near misses that are listed, unless everything is requested.
STEPS, MISSES = 3, 5
#: Standard deviations between the value of a listed near miss and the simulation.
DISTANT = 2.0
SHARE = (
    "Share: how much of the closable error of its stage returns without this effect, the others refitted. Effects that can "
    "replace each other (dead time and lag) have small shares each, even if their sum is large."
)
LINKS = "Small errors of mass, first moment and inertia are adjusted together and have no names of their own: links of"
KINDS = {"named": "named", "tied": "one of a tie", "adjusted": "no name"}


def show_written(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """One row for every parameter that the repair writes into the plant: named, adjusted without a name, changed."""
    if not result.written:
        return
    from sysid.display import NOTHING, percent
    from sysid.effects import inertial_error
    from sysid.reports.result_figures import parameters_of
    from sysid.reports.words import effect_place

    machine = dataset.machine
    rows: list[tuple[str, ...]] = []
    links = [item.target for item in result.written if item.name == inertial_error.EFFECT.name]
    shown = [item for item in result.written if item.name != inertial_error.EFFECT.name]
    for item in shown:
        title = effect_place(item.name, item.target, dataset.machine)
        share = percent(item.gap_share) if item.gap_share is not None else NOTHING
        figures = parameters_of(item.name, item.target, item.parameters, machine, dataset.units, item.interval95, item.before)
        for number, figure in enumerate(figures):
            known = f" (was {figure.before_text})" if figure.before is not None else ""
            first = (title, share, KINDS[item.kind]) if number == 0 else ("", "", "")
            rows.append((first[0], f"{figure.label} {figure.text}{known}", figure.interval, *first[1:]))
        for key in _undetermined(result, item):
            rows.append(("", f"{key.replace('_', ' ')} not determined", "", "", ""))
    count = f"{len(result.written)} effect{'' if len(result.written) == 1 else 's'}"
    if result.plant_after:
        out.line(f"Written into plant {result.plant_after}: {count}")
    else:
        out.line(f"A repair (--add) would write {count}:")
    out.table(("effect", "value", "95 % interval", "share", "row"), rows, right=(3,))
    entry(out, SHARE)
    if links:
        entry(out, f"{LINKS} {', '.join(links)}.")
    for effect in result.effects:
        if effect.aliases:
            others = ", ".join(effect_place(name, target, dataset.machine) for name, target in effect.aliases)
            place = effect_place(effect.name, effect.target, dataset.machine)
            entry(out, f"{place}: {others} in its place changes the recordings in the same way.")
    reasons: dict[str, list[str]] = {}
    for item in shown:
        if item.kind == "adjusted":
            reasons.setdefault(plain_reason(item.why), []).append(effect_place(item.name, item.target, dataset.machine))
    for why, titles in reasons.items():
        entry(out, f"No name, because {why}: {', '.join(titles)}.")


def show_delays(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """Dead time and lag of every axis and their sum, before → after; axes without a change are left out."""
    from sysid.display import quantity
    from sysid.gap.statement import order_sentence

    def change(ends: tuple[float, float]) -> str:
        texts = [quantity(value, "s") for value in ends]
        return texts[1] if texts[0] == texts[1] else " → ".join(texts)

    rows = [
        (item.axis, change(item.dead_time), change(item.lag), change(item.total))
        for item in result.delays
        if item.dead_time[0] != item.dead_time[1] or item.lag[0] != item.lag[1]
    ]
    if rows:
        out.table(("delay", "dead time", "lag", "together"), rows, right=(1, 2, 3))
    if sentence := order_sentence(result.order):
        entry(out, sentence)


def show_near_misses(out: Printer, result: GapResult, dataset: Dataset, verbose: bool) -> None:
    """Effects that are not written and lack one condition for a name, with it; the clearest first."""
    from sysid.reports.result_figures import parameters_of
    from sysid.reports.words import effect_place

    machine = dataset.machine
    written = {(item.name, item.target, item.side) for item in result.written}
    found: dict[EffectKey, NearMissResult] = {}
    for miss in sorted(result.near_misses, key=lambda miss: -miss.distance):  # a pump shows at several stages
        found.setdefault((miss.name, miss.target, miss.side), miss)
    others = [miss for key, miss in found.items() if key not in written]
    clear = others if verbose else [miss for miss in others if miss.distance >= DISTANT]
    shown = clear if verbose else clear[:MISSES]
    if shown:
        out.line("Near misses, which are not written:")
    for miss in shown:
        figures = parameters_of(miss.name, miss.target, miss.parameters, machine, dataset.units, miss.interval95)
        values = ", ".join(map(_miss_text, figures))
        title = effect_place(miss.name, miss.target, machine)
        entry(out, f"{title}, {values}: {plain_reason(miss.lacks)}.", "  ")
    if shown and len(others) > len(shown):
        out.line(f"  ({len(others) - len(shown)} more, less clear: --verbose)")


def show_next_steps(out: Printer, result: GapResult, dataset: Dataset, verbose: bool) -> None:
    """The most useful recordings to make: planned ones, then those for ties, then those for most axes."""
    steps = next_steps(result, dataset)
    if not steps:
        return
    out.line()
    out.line("Next, the most useful first:" if len(steps) > 1 else "Next:")
    for number, step in enumerate(steps if verbose else steps[:STEPS], 1):
        entry(out, step, f"  {number}. ")
    if not verbose and len(steps) > STEPS:
        out.line(f"  ({len(steps) - STEPS} more: --verbose)")


def next_steps(result: GapResult, dataset: Dataset) -> list[str]:
    """One text for each recording to make; effects that the same motion excites are grouped over their axes."""
    from sysid.effects import effect_named
    from sysid.gap.excitation import TRAVEL_UNITS, axis_of
    from sysid.gap.servo.sag import advice_on_sag, sagging_axis
    from sysid.names import listed
    from sysid.reports.words import effect_place, effect_title

    machine, steps = dataset.machine, list[str]()
    for planned in result.experiments:
        effects = [effect for purpose in planned.purposes for effect in purpose.effects]
        places = listed(list(dict.fromkeys(effect_place(effect.name, effect.target, machine) for effect in effects)))
        again = f", {planned.repeats} times" if planned.repeats > 1 else ""
        steps.append(f"Record {planned.name}.toml ({planned.about}, {planned.seconds:.0f} s{again}): {places}.")
    sagging = [axis for tie in result.ambiguous if (axis := sagging_axis(tie, machine))]
    steps += [advice_on_sag(sagging)] if sagging else []
    for tie in (tie for tie in result.ambiguous if not sagging_axis(tie, machine)):
        names = " or ".join(effect_place(name, target, machine) for name, target in tie)
        motions = dict.fromkeys(effect_named(name).need.advice.format(axis=target) for name, target in tie)
        steps.append(f"{' '.join(motions)} These recordings cannot distinguish {names}.")
    still: dict[str, None] = {}
    groups: dict[tuple[str, str], dict[str, None]] = {}
    for item in result.excitation:
        if item.sufficient:
            continue
        axis = axis_of(item.target, machine) or item.target
        if item.unit in TRAVEL_UNITS:
            still[axis] = None
        else:
            key = effect_named(item.name).need.advice, effect_title(item.name, axis, machine)
            groups.setdefault(key, {})[item.target] = None
    if still:
        axes = listed(list(still))
        steps.append(f"Record {axes} moving over {'its range' if len(still) == 1 else 'their ranges'}: not moved so far.")
    by_motion: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (motion, title), targets in groups.items():
        by_motion.setdefault((motion, tuple(targets)), []).append(title)
    for (motion, where), titles in sorted(by_motion.items(), key=lambda item: -len(item[0][1]) * len(item[1])):
        of = listed([titles[0], *(each[0].lower() + each[1:] for each in titles[1:])])
        steps.append(f"{motion.format(axis=listed(list(where)))} {of}: not enough motion so far.")
    return steps


def entry(out: Printer, text: str, bullet: str = "") -> None:
    """A sentence, wrapped to :data:`WIDTH` columns."""
    for line in textwrap.wrap(text, WIDTH, initial_indent=bullet, subsequent_indent=" " * len(bullet)):
        out.line(line.rstrip())


def plain_reason(why: str) -> str:
    """The condition that an effect without a name fails, in plain words; one that only a stored result has, as it is."""
    from sysid.gap.reasons import Reason

    known = {str(reason): reason.plain for reason in Reason}
    return known.get(why, why) or "it was fitted beside the others"


def _undetermined(result: GapResult, item: WrittenEffect) -> Iterator[str]:
    for effect in result.effects:
        if (effect.name, effect.target, effect.side) == (item.name, item.target, item.side):
            yield from effect.undetermined


def _miss_text(figure: ParameterFigure) -> str:
    """``delay 30.0 ms ± 20 ms``."""
    low, high = figure.interval95 or (math.nan, math.nan)
    half = 0.5 * (high - low)
    if not math.isfinite(half):
        return f"{figure.label} {figure.text}"
    return f"{figure.label} {figure.text} ± {quantity(half, figure.unit, 2)}"
