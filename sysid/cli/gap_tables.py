"""Console output of a gap result: verdict, what a repair writes, near misses, delays, held-out errors, useful next steps; the
repair and its promotion; localisation; what recordings show without a model; repeatability of names.
"""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from sysid.cli.output import command
from sysid.display import percent, quantity

if TYPE_CHECKING:
    from pathlib import Path

    from sysid.cli.output import Printer
    from sysid.datasets import Dataset
    from sysid.figures import ParameterFigure
    from sysid.gap import GapResult
    from sysid.gap.result import NearMissResult
    from sysid.machine import EffectKey

#: Names of recordings in a sentence.
RECORDINGS = 8
#: Next steps and near misses that are listed, unless everything is requested.
STEPS, MISSES = 3, 5
#: Standard deviations between the value of a listed near miss and the simulation.
DISTANT = 2.0
SHARE = (
    "Share: how much of the closable error of its stage returns without this effect, the others refitted. Effects that can "
    "replace each other (dead time and lag) have small shares each, even if their sum is large."
)
LINKS = "Small errors of mass, first moment and inertia are adjusted together and have no names of their own: links of"


def show_gap(out: Printer, result: GapResult, dataset: Dataset, verbose: bool = False) -> None:
    """The verdict, everything that the repair writes, unnamed errors, near misses, the gap of every signal, next steps.

    Args:
        verbose: every near miss and next step, at full length.
    """
    from sysid.gap.statement import response_sentences
    from sysid.names import listed
    from sysid.reports.result_figures import error_table, named_sentence, unnamed_sentence
    from sysid.reports.words import tie_text

    machine = dataset.machine
    out.line(f"{result.headline}  [{result.verdict}, {result.seconds:.1f} s]")
    for effect in result.effects:
        out.entry(named_sentence(effect, result, dataset), "  ")
    for sentence in response_sentences(result.responses, bool(result.written)):
        out.entry(sentence, "  ")
    out.line()
    show_written(out, result, dataset)
    show_delays(out, result, dataset)
    for tie in result.ambiguous:
        out.entry(f"Cannot be distinguished: {tie_text(tie, machine)}", "  ")
    for item in result.unnamed:
        out.entry(unnamed_sentence(item, machine), "  ")
    show_residual_models(out, result, dataset)
    show_near_misses(out, result, dataset, verbose)
    out.show(error_table(result.gap, dataset.units))
    out.entry(f"Held-out recordings: {listed(result.held_out_recordings, RECORDINGS)}.")
    _show_left_out(out, result, dataset)
    show_next_steps(out, result, dataset, verbose)


def _show_left_out(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """What the machine's description contains beyond the simulation."""
    from sysid.gap.statement import left_out_sentence

    sentence = left_out_sentence(dataset.machine.left_out)
    if sentence in result.notes:
        out.entry(sentence)


def show_missing(out: Printer, result: GapResult) -> None:
    """What follows the decision and could not be computed."""
    from sysid.gap.statement import missing_sentences

    for sentence in missing_sentences(result.missing):
        out.entry(sentence)


def show_localised(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """Errors of every stage, their shares of the whole gap, and the conditions of the largest."""
    from sysid.front.gap import localised_table
    from sysid.reports.sections.where import above_floor, listed_shares, maps_of, sentence
    from sysid.reports.words import owner_name, signal_name, stage_name

    out.line(f"{result.headline}  [{result.verdict}]")
    out.show(localised_table(result, dataset))
    shares = []
    for end, unit, of_end, _ in listed_shares(result, dataset.units):
        for number, share in enumerate(of_end):
            what = f"{owner_name(end)} off by {quantity(share.rmse, unit)}" if number == 0 else ""
            shares.append((what, percent(share.share), owner_name(share.target), stage_name(share.stage)))
    out.table(("the whole gap", "share", "owner", "stage"), shares, right=(1,))
    for item in above_floor(result):
        if maps := maps_of(result, item):
            out.line(f"{signal_name(item.signal)}: {sentence(maps[0], item, dataset.units.get(item.signal, '1'))}")
    _show_left_out(out, result, dataset)


def show_responses(out: Printer, dataset: Dataset) -> list[dict[str, Any]]:
    """What the recordings show of each axis without a model; returns it as values for JSON."""
    from sysid.datasets.quality.responses import responses_of
    from sysid.reports.sections.responses import response_table

    responses = responses_of(dataset)
    out.show(response_table(responses, "without a model"))
    return [asdict(response) for response in responses]


def show_written(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """One row for every parameter that the repair writes into the plant: named, adjusted without a name, changed."""
    if not result.written:
        return
    from sysid.effects import inertial_error
    from sysid.front.gap import written_table
    from sysid.reports.words import effect_place

    links = [item.target for item in result.written if item.name == inertial_error.EFFECT.name]
    shown = [item for item in result.written if item.name != inertial_error.EFFECT.name]
    count = f"{len(result.written)} effect{'' if len(result.written) == 1 else 's'}"
    if result.plant_after:
        out.line(f"Written into plant {result.plant_after}: {count}")
    else:
        out.line(f"The repair has {count}:")
    out.show(written_table(result, dataset))
    out.entry(SHARE)
    if links:
        out.entry(f"{LINKS} {', '.join(links)}.")
    for effect in result.effects:
        if effect.aliases:
            others = ", ".join(effect_place(name, target, dataset.machine) for name, target in effect.aliases)
            place = effect_place(effect.name, effect.target, dataset.machine)
            out.entry(f"{place}: {others} in its place changes the recordings in the same way.")
    reasons: dict[str, list[str]] = {}
    for item in shown:
        if item.kind == "adjusted":
            reasons.setdefault(plain_reason(item.why), []).append(effect_place(item.name, item.target, dataset.machine))
    for why, titles in reasons.items():
        out.entry(f"No name, because {why}: {', '.join(titles)}.")


def show_delays(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """Dead time and lag of every axis and their sum, before → after; axes without a change are left out."""
    from sysid.gap.statement import order_sentence

    def change(ends: tuple[float, float]) -> str:
        texts = [quantity(value, "s") for value in ends]
        return texts[1] if texts[0] == texts[1] else " → ".join(texts)

    rows = [
        (item.axis, change(item.dead_time), change(item.lag), change(item.total))
        for item in result.delays
        if item.dead_time[0] != item.dead_time[1] or item.lag[0] != item.lag[1]
    ]
    out.table(("delay", "dead time", "lag", "together"), rows, right=(1, 2, 3))
    if sentence := order_sentence(result.order):
        out.entry(sentence)


def show_residual_models(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """Residual networks: held-out error of the stage without and with each, or why there is none."""
    from sysid.reports.result_figures import residual_sentence

    for item in result.carried:
        text = residual_sentence(item, dataset) if item.accepted else f"no residual network: {item.text}"
        out.line(f"  {text}")


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
        out.entry(f"{title}, {values}: {plain_reason(miss.lacks)}.", "  ")
    if shown and len(others) > len(shown):
        out.line(f"  ({len(others) - len(shown)} more, less clear: --verbose)")


def _miss_text(figure: ParameterFigure) -> str:
    """``delay 30.0 ms ± 20 ms``."""
    low, high = figure.interval95 or (math.nan, math.nan)
    half = 0.5 * (high - low)
    if not math.isfinite(half):
        return f"{figure.label} {figure.text}"
    return f"{figure.label} {figure.text} ± {quantity(half, figure.unit, 2)}"


def show_next_steps(out: Printer, result: GapResult, dataset: Dataset, verbose: bool) -> None:
    """The most useful recordings to make: planned ones, then those for ties, then those for most axes."""
    from sysid.reports.result_figures import next_steps

    steps = next_steps(result, dataset)
    if not steps:
        return
    out.line()
    out.line("Next, the most useful first:" if len(steps) > 1 else "Next:")
    for number, step in enumerate(steps if verbose else steps[:STEPS], 1):
        out.entry(step, f"  {number}. ")
    if not verbose and len(steps) > STEPS:
        out.line(f"  ({len(steps) - STEPS} more: --verbose)")


def plain_reason(why: str) -> str:
    """The condition that an effect without a name fails, in plain words; one that only a stored result has, as it is."""
    from sysid.gap.reasons import Reason

    known = {str(reason): reason.plain for reason in Reason}
    return known.get(why, why) or "it was fitted beside the others"


def show_repair(
    out: Printer, result: GapResult, dataset: Dataset, folder: Path | None = None, workspace: str | Path | None = None
) -> None:
    """The change of ``machine.toml`` by ``--add``, the promotion with its checks, and commands to apply or undo it.

    Args:
        folder: of the result and its ``machine.diff``.
        workspace: for the printed commands.
    """
    name = result.plant_after.partition("@")[0]
    out.line(f"Plant {result.plant_after} = plant {result.plant_before} repaired. Change of machine.toml (SI units):")
    out.line()
    for line in result.machine_diff.splitlines():
        out.line(f"  {line}".rstrip())
    out.line()
    for item in result.carried:
        if item.accepted:
            out.line(
                f"It also contains unnamed_residual ({item.stage} of {item.target}), a network, which machine.toml cannot "
                f"describe; it is only in {result.plant_after}."
            )
    if folder is not None and result.machine_diff:
        out.line(f"Apply it: patch machine.toml {shlex.quote(str(folder / 'machine.diff'))}, and ingest again.")
    found = result.promotion
    if found is None:
        return
    for check in found.checks:
        out.line(f"  {check.status:<8}  {check.name}: {check.text}")
    if found.promoted:
        instead = f" instead of {found.previous}" if found.previous not in ("", found.version) else ""
        out.line(f"Promoted: `{name}` alone now means plant {found.version}{instead}.")
        back = found.previous if found.previous != found.version else result.plant_before
        out.line(
            f"Undo it:  {command('models', 'promote', back, workspace=workspace)}   ({back} and machine.toml are unchanged)"
        )
    else:
        out.line(f"Not promoted: {found.reason}.")
        champion = f"`{name}` alone still means {found.current}" if found.current else "No version of this name is promoted"
        anyway = f"{command('models', 'promote', found.version, workspace=workspace)} --anyway 'WHY'"
        out.line(f"{champion}; {found.version} is stored. To promote it regardless: {anyway}")
    out.line(f"`{command('gap', dataset.name)}` without --plant still tests the simulation that machine.toml describes.")


def show_world(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """The held-out gap in the PyBullet world and with the compiled plant, before and after."""
    found = result.world_gap
    if found is None:
        return
    rows = []
    for name in found.world.before:
        columns = (found.world.before, found.world.after, found.compiled.before, found.compiled.after)
        rows.append((name, *(quantity(column[name], dataset.units.get(name)) for column in columns)))
    header = ("in the PyBullet world", "before", "after", "compiled before", "compiled after")
    out.table(header, rows, right=range(1, 5))
    if found.skipped:
        out.line(f"Not run in the PyBullet world: {found.skipped}")
