"""``sysid gap NAME``: where simulation and machine disagree, which effect is missing, how much of the gap it closes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from sysid.cli.output import Printer, json_option, progress_bar, write_json

if TYPE_CHECKING:
    from sysid.gap import GapResult
    from sysid.gap.result import Localised
    from sysid.machine import Machine


@click.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@click.option("--plant", default=None, metavar="PLANT[@VERSION]", help="The simulation to question; else the nominal one.")
@click.option("--localise", is_flag=True, help="Only say where they disagree.")
@click.option("--add", is_flag=True, help="Store the repaired simulation as a new plant version.")
@json_option
@click.pass_obj
def gap(workspace: str, reference: str, plant: str | None, localise: bool, add: bool, json_file: str | None) -> None:
    """Name the effects that the simulation lacks, and prove it on recordings that no fit has seen."""
    from sysid.gap import find_gap
    from sysid.workspace import open_workspace

    place = open_workspace(workspace)
    dataset = place.dataset(reference)
    questioned = place.plant(dataset, plant)
    out = Printer(json_file)
    for axis in dataset.machine.axes:
        if axis.drives == "cylinder" and axis.name not in questioned.linkages and f"{axis.name}.joint" in dataset.units:
            out.line(f"{axis.name}: no linkage, so its joint is not simulated; sysid fit actuator {dataset.name} makes one.")
    with progress_bar("gap") as progress:
        result = find_gap(dataset, questioned, registry=place.models, add=add, localise_only=localise, progress=progress)
    if localise:
        _show_localised(out, result)
    else:
        place.keep_gap(dataset, result)
        _show(out, result, dataset.machine)
        out.line(f"Look at it: sysid --workspace {workspace} report {dataset.reference}")
    write_json(json_file, result.to_json())


def _show_localised(out: Printer, result: GapResult) -> None:
    rows = [
        (
            item.stage,
            item.signal,
            f"{item.stage_rmse:.3g}",
            f"{item.noise_floor:.3g}",
            f"{item.stage_rmse / item.noise_floor:.1f}",
        )
        for item in sorted(result.localised, key=lambda item: -item.share)
    ]
    out.table(("stage", "signal", "error (SI)", "noise (SI)", "times noise"), rows, right=(2, 3, 4))


def _times(item: Localised) -> float:
    return item.stage_rmse / item.noise_floor if item.noise_floor > 0.0 else float("nan")


def _closed(result: GapResult, signal: str) -> str:
    """The closed share; nothing where there was nothing to close."""
    before, floor = result.gap.before[signal], result.gap.noise_floor[signal]
    return f"{100 * result.gap.closed(signal):.1f} %" if before > 1.05 * floor else "–"


def _show(out: Printer, result: GapResult, machine: Machine) -> None:
    from sysid.reports.effect_units import shown, shown_parameters
    from sysid.reports.words import effect_sentence, headline

    out.line(f"{headline(result.verdict, len(result.effects))}  [{result.verdict}, {result.seconds:.1f} s]")
    rows = []
    for effect in result.effects:
        texts = shown_parameters(effect.name, effect.target, effect.parameters, machine)
        out.line(f"  {effect_sentence(effect.name, effect.target, texts)}")
        for name in effect.parameters:
            value, low, high = (
                shown(effect.name, name, effect.target, number, machine, digits=4)
                for number in (effect.parameters[name], *effect.interval95[name])
            )
            rows.append((effect.name, effect.target, name, value, f"{low} … {high}", f"{100 * effect.gap_share:.0f} %"))
    if rows:
        out.table(("effect", "target", "parameter", "value", "95 %", "share"), rows, right=(3, 4, 5))
    for tie in result.ambiguous:
        out.line("  cannot be told apart: " + " / ".join(f"{name} ({target})" for name, target in tie))
    for item in result.unnamed:
        out.line(f"  left over without a name: {item.stage} of {item.target}, depends on {item.depends_on}: {item.form}")
    floor = result.gap.noise_floor
    figures = [
        (name, f"{before:.4g}", f"{result.gap.after[name]:.4g}", f"{floor[name]:.4g}", _closed(result, name))
        for name, before in result.gap.before.items()
    ]
    out.table(("signal (SI)", "before", "after", "noise floor", "closed"), figures, right=(1, 2, 3, 4))
    for step in result.next_experiment:
        out.line(f"next: {step}")
    stored = (
        f" → {result.plant_after}" if result.plant_after else " (repair not stored: --add stores it)" if result.effects else ""
    )
    out.line(f"plant {result.plant_before}{stored}; proved on {', '.join(result.held_out_recordings)}")
