"""``sysid validate MODEL NAME``: the error report of a network."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from sysid.cli.output import Printer, json_option, write_json

if TYPE_CHECKING:
    from sysid.validate import ValidationReport

#: SI → what is printed.
SHOWN = {"m": (1e3, "mm"), "rad": (57.29577951308232, "deg")}


@click.command()
@click.argument("model")
@click.argument("reference", metavar="NAME[@VERSION]")
@json_option
@click.pass_obj
def validate(workspace: str, model: str, reference: str, json_file: str | None) -> None:
    """Score a fitted network on recordings it has not seen."""
    from sysid.workspace import open_workspace

    place = open_workspace(workspace)
    report = place.validation(model, place.dataset(reference))
    out = Printer(json_file)
    show_errors(out, report)
    for entry in report.outputs:
        for spike in entry.spikes[:3]:
            factor, unit = SHOWN[entry.unit]
            where = f"{spike.time:.2f} s of {spike.recording} ({spike.cause})"
            out.line(f"spike in {entry.output}: {factor * spike.error:+.2f} {unit} at {where}")
    write_json(json_file, {"schema": 1, **report.to_json()})


def show_errors(out: Printer, report: ValidationReport) -> None:
    """One row an output: RMSE, 95 %, maximum, what sensor noise alone would give, and the best simpler model."""
    rows = []
    for entry in report.outputs:
        factor, unit = SHOWN[entry.unit]
        best = min(entry.baselines, key=lambda name: entry.baselines[name].rmse, default=None)
        figures = [f"{factor * value:.2f}" for value in (entry.metrics.rmse, entry.metrics.p95, entry.metrics.max)]
        floor = "–" if entry.noise_floor is None else f"{factor * entry.noise_floor:.2f}"
        simple = "–" if best is None else f"{best} {factor * entry.baselines[best].rmse:.2f}"
        rows.append((entry.output, entry.rows, *figures, floor, unit, simple))
    out.table(("output", "rows", "rmse", "95 %", "max", "noise", "unit", "best simple model"), rows, right=(2, 3, 4, 5))
