"""``sysid report [NAME]``: the HTML page about a dataset and everything computed on it."""

from __future__ import annotations

from pathlib import Path

import click

from sysid.cli.output import Printer, command, json_option, write_json


@click.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--out", "path", type=click.Path(dir_okay=False, path_type=Path), default=None, metavar="FILE.html")
@json_option
@click.pass_obj
def report(location: str, reference: str | None, path: Path | None, json_file: str | None) -> None:
    """Write the HTML report of a dataset: one file that works without a network."""
    from sysid.front import files
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    dataset = workspace.dataset(reference)
    path = files.report(dataset, path, workspace)
    gap = workspace.gap(dataset)
    out = Printer(json_file)
    out.line(f"{path}  ({path.stat().st_size / 1e6:.1f} MB)")
    if gap is None:
        out.line(f"The report has no comparison with a simulation yet: {command('gap', dataset.name, workspace=location)}")
    verdict = gap.verdict if gap is not None else None
    write_json(json_file, {"schema": 1, "file": path, "dataset": dataset.reference, "verdict": verdict})
