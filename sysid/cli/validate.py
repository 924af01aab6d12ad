"""``sysid validate MODEL NAME``: the error report of a network."""

from __future__ import annotations

import click

from sysid.cli.output import Printer, json_option, write_json
from sysid.cli.tables import show_errors


@click.command()
@click.argument("model")
@click.argument("reference", metavar="NAME[@VERSION]")
@json_option
@click.pass_obj
def validate(workspace: str, model: str, reference: str, json_file: str | None) -> None:
    """Score a fitted network on recordings it has not seen."""
    from sysid.reports.display import shown_unit
    from sysid.workspace import open_workspace

    place = open_workspace(workspace)
    report = place.validation(model, place.dataset(reference))
    out = Printer(json_file)
    show_errors(out, report)
    for entry in report.outputs:
        for spike in entry.spikes[:3]:
            factor, unit = shown_unit(entry.unit)
            where = f"{spike.time:.2f} s of {spike.recording} ({spike.cause})"
            out.line(f"spike in {entry.output}: {factor * spike.error:+.2f} {unit} at {where}")
    write_json(json_file, {"schema": 1, **report.to_json()})
