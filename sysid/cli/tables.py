"""Console tables of verbs and pipelines: datasets, errors of networks, gap results, repairs."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from sysid.cli.output import command

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from sysid.cli.output import Printer
    from sysid.datasets import Dataset
    from sysid.gap import GapResult
    from sysid.networks import Calibration
    from sysid.validate import ValidationReport


def show_dataset(out: Printer, dataset: Dataset) -> None:
    """Recordings, clocks and losses of a dataset version."""
    rows = [
        (
            recording.name,
            recording.kind,
            dataset.splits.get(recording.name, "–"),
            f"{len(recording)} poses" if recording.kind == "poses" else f"{len(recording) / recording.rate_hz:.1f} s",
            len(recording.signals),
            f"{100.0 * (1.0 - recording.table.drop(columns='time').isna().to_numpy().mean()):.1f} %",
        )
        for recording in dataset.recordings
    ]
    out.table(("recording", "kind", "role", "length", "signals", "complete"), rows, right=(3, 4, 5))
    _show_samples(out, dataset)
    for clock in dataset.clocks:
        if clock.applied:
            half = 0.5e3 * (clock.offset_interval95[1] - clock.offset_interval95[0])
            text = f"{clock.offset_s:+.6f} s ± {half:.3f} ms, skew {clock.skew_ppm:+.1f} ppm"
            if clock.reason.startswith("piece "):  # the clock was reset during the recording
                text = f"{text} ({clock.reason.partition(';')[0]})"
        else:
            text = f"not aligned: {clock.reason}"
        out.line(f"clock {clock.stream} of {clock.recording}: {text}")
    for source in dataset.sources:
        for loss in source.losses:
            out.line(f"loss in {source.path}: {loss}")


def _show_samples(out: Printer, dataset: Dataset) -> None:
    """For each signal: samples in the files, those that are used, and why others are not."""
    from sysid.display import percent
    from sysid.reports.dataset_texts import sample_lines

    rows = [
        (line.name, line.counts.samples, line.counts.used, percent(line.filled), f"{line.counts.bridged_s:.1f} s", line.lost)
        for line in sample_lines(dataset)
    ]
    if rows:
        header = ("signal", "samples", "used", "filled", "bridged", "not used")
        out.table(header, rows, right=(1, 2, 3, 4))


def show_errors(out: Printer, *reports: ValidationReport, paper: Mapping[str, float] | None = None) -> None:
    """One row per output: RMSE, 95 %, maximum, noise floor, and the best simpler model.

    ``paper`` adds a column with a published maximum [SI] by output.
    """
    from sysid.reports.result_figures import network_rows

    rows = [row for report in reports for row in network_rows(report, paper)]
    beside = [] if paper is None else ["paper's max"]
    header = ("network output", "rows", "rmse", "95 %", "max", *beside, "noise", "unit", "best simple model")
    out.table(header, rows, right=range(2, 6 + len(beside)))
    for report in reports:
        if report.recommendation:
            out.line(f"{report.model or report.kind}: {report.recommendation}")


def show_directions(out: Printer, report: ValidationReport) -> None:
    """Errors of actuator networks by the direction of motion, which indicate backlash or hysteresis."""
    from sysid.display import shown_unit

    rows = []
    for entry in report.outputs if report.kind in ("actuator", "history") else ():
        factor, unit = shown_unit(entry.unit)
        for found in entry.profiles:
            if found.variable.startswith("direction of ") and entry.rows == "motion":
                figures = [
                    f"{factor * bias:+.2f} / {factor * rmse:.2f}" if count else "–"
                    for count, bias, rmse in zip(found.count, found.bias, found.rmse, strict=True)
                ]
                floor = "–" if entry.noise_floor is None else f"{factor * entry.noise_floor:.2f}"
                rows.append((entry.output, *figures, floor, unit))
    if rows:
        header = ("by direction of the input: bias / rmse", "falling", "still", "rising", "noise", "unit")
        out.table(header, rows, right=range(1, 5))


def show_calibration(out: Printer, calibration: Calibration) -> None:
    """Parameters that the poses determine, those that they leave open, and the models that were compared."""
    from sysid.reports.calibration import model_rows, notes, parameter_rows

    header = ("parameter", "differs from the URDF by", "95 % interval", "", "log evidence")
    out.table(header, parameter_rows(calibration), right=(1, 2, 4))
    for line in notes(calibration):
        out.line(f"  {line}")
    if calibration.models:
        header = ("model", "parameters", "held-out RMS distance", "median", "log evidence")
        out.table(header, model_rows(calibration), right=(1, 2, 3, 4))


def show_localised(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """Errors of every stage, their shares of the whole gap, and the conditions of the largest."""
    from sysid.display import percent, quantity
    from sysid.figures import times
    from sysid.reports.sections.where import above_floor, sentence, significant
    from sysid.reports.words import owner_name, signal_name, stage_name

    out.line(f"{result.headline}  [{result.verdict}]")
    rows = []
    for item in sorted(result.localised, key=lambda item: -item.stage_rmse / max(item.noise_floor, 1e-300)):
        unit = dataset.units.get(item.signal)
        error, floor, chain = (quantity(value, unit) for value in (item.stage_rmse, item.noise_floor, item.free_run_rmse))
        rows.append((item.stage, item.signal, error, floor, times(item.stage_rmse, item.noise_floor), chain))
    out.table(("stage", "signal", "error", "noise floor", "times", "whole chain"), rows, right=(2, 3, 4, 5))
    shares = []
    for end, of_end in reversed(significant(result.shares, result.localised)):
        unit = dataset.units.get(f"{end}.x" if end in ("ee", "tool") else end, "m")
        for number, share in enumerate(s for s in of_end if abs(s.share) >= 0.01):
            what = f"{owner_name(end)} off by {quantity(share.rmse, unit)}" if number == 0 else ""
            shares.append((what, percent(share.share), owner_name(share.target), stage_name(share.stage)))
    if shares:
        out.table(("the whole gap", "share", "owner", "stage"), shares, right=(1,))
    for item in above_floor(result):
        maps = [m for m in result.maps if (m.stage, m.target, m.signal) == (item.stage, item.target, item.signal)]
        if maps:
            out.line(f"{signal_name(item.signal)}: {sentence(maps[0], item, dataset.units.get(item.signal, '1'))}")
    _show_left_out(out, result, dataset)


def show_responses(out: Printer, dataset: Dataset) -> list[dict[str, Any]]:
    """What the recordings show of each axis without a model; returns it as values for JSON."""
    from sysid.datasets.quality.responses import responses_of
    from sysid.display import NOTHING, interval
    from sysid.reports.sections.responses import side_texts

    responses, rows = responses_of(dataset), list[tuple[str, ...]]()
    for response in responses:
        first = response.axis, interval(*response.delay95, "s") if math.isfinite(response.delay) else NOTHING
        sides = [("positive", response.positive), ("negative", response.negative)]
        texts = [tuple(side_texts(name, side, response.unit).values()) for name, side in sides if side is not None]
        rows += [(*(first if number == 0 else ("", "")), *text) for number, text in enumerate(texts or [("", "", "")])]
    if rows:
        header = ("without a model", "delay", "command", "motion begins at", "speed at full")
        out.table(header, rows, right=(1, 3, 4))
    return [asdict(response) for response in responses]


def show_gap(out: Printer, result: GapResult, dataset: Dataset, verbose: bool = False) -> None:
    """The verdict, everything that the repair writes, unnamed errors, near misses, the gap of every signal, next steps.

    Args:
        verbose: every near miss and next step, at full length.
    """
    from sysid.cli import gap_tables
    from sysid.gap.statement import response_sentences
    from sysid.names import listed
    from sysid.reports.result_figures import error_table, named_sentence, unnamed_sentence
    from sysid.reports.words import effect_place

    machine = dataset.machine
    out.line(f"{result.headline}  [{result.verdict}, {result.seconds:.1f} s]")
    for effect in result.effects:
        gap_tables.entry(out, named_sentence(effect, result, dataset), "  ")
    for sentence in response_sentences(result.responses, bool(result.written)):
        gap_tables.entry(out, sentence, "  ")
    out.line()
    gap_tables.show_written(out, result, dataset)
    gap_tables.show_delays(out, result, dataset)
    for tie in result.ambiguous:
        names = " / ".join(effect_place(name, target, machine) for name, target in tie)
        gap_tables.entry(out, f"Cannot be distinguished: {names}", "  ")
    for item in result.unnamed:
        gap_tables.entry(out, unnamed_sentence(item, machine), "  ")
    show_residual_models(out, result, dataset)
    gap_tables.show_near_misses(out, result, dataset, verbose)
    out.show(error_table(result.gap, dataset.units))
    gap_tables.entry(out, f"Held-out recordings: {listed(result.held_out_recordings, gap_tables.RECORDINGS)}.")
    _show_left_out(out, result, dataset)
    gap_tables.show_next_steps(out, result, dataset, verbose)


def _show_left_out(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """What the machine's description contains beyond the simulation."""
    from sysid.cli import gap_tables
    from sysid.gap.statement import left_out_sentence

    sentence = left_out_sentence(dataset.machine.left_out)
    if sentence in result.notes:
        gap_tables.entry(out, sentence)


def show_missing(out: Printer, result: GapResult) -> None:
    """What follows the decision and could not be computed."""
    from sysid.cli import gap_tables
    from sysid.gap.statement import missing_sentences

    for sentence in missing_sentences(result.missing):
        gap_tables.entry(out, sentence)


def show_residual_models(out: Printer, result: GapResult, dataset: Dataset) -> None:
    """Residual networks: held-out error of the stage without and with each, or why there is none."""
    from sysid.figures import ErrorFigure

    for item in result.carried:
        if not item.accepted:
            out.line(f"  no residual network: {item.text}")
            continue
        unit = dataset.units.get(item.signal) or dataset.machine.expected_unit(item.signal) or "1"
        before, after, floor = ErrorFigure(item.signal, unit, item.before, item.after, item.noise_floor).texts
        out.line(
            f"  bounded residual network (unnamed_residual): {item.stage} of {item.target}, held-out error {before} → "
            f"{after} (noise floor {floor}). It is fitted to the recordings and has no physical cause."
        )


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
    from sysid.display import quantity

    found = result.world_gap
    if found is None:
        return
    rows = []
    for name in found.world.before:
        columns = (found.world.before, found.world.after, found.compiled.before, found.compiled.after)
        rows.append((name, *(quantity(column[name], dataset.units.get(name)) for column in columns)))
    if rows:
        header = ("in the PyBullet world", "before", "after", "compiled before", "compiled after")
        out.table(header, rows, right=range(1, 5))
    if found.skipped:
        out.line(f"Not run in the PyBullet world: {found.skipped}")
