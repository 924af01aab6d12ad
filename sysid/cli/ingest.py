"""``sysid ingest PATH…``: raw logs become a new version of a dataset."""

from __future__ import annotations

import time
from pathlib import Path

import click

from sysid.cli.output import Printer, json_option, progress_bar, write_json
from sysid.cli.tables import show_dataset
from sysid.errors import SettingsError


@click.command()
@click.argument("paths", metavar="PATH…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--machine", type=click.Path(path_type=Path), default=None, metavar="machine.toml", help="The machine.")
@click.option("--recipe", type=click.Path(path_type=Path), default=None, metavar="R.toml", help="Which field is which signal.")
@click.option("--name", default=None, help="Name of the dataset; else the recipe's, else the machine's.")
@click.option("--inspect", is_flag=True, help="Only show what is in the files, and draft a recipe for them.")
@click.option(
    "--draft", type=click.Path(path_type=Path), default=None, metavar="R.toml", help="With --inspect: write the draft."
)
@click.option("--reader", default=None, help="With --inspect: read the files as this format.")
@click.option("--dbc", type=click.Path(path_type=Path), default=None, help="With --inspect: the database of a CAN log.")
@json_option
@click.pass_obj
def ingest(
    workspace: str,
    paths: tuple[Path, ...],
    machine: Path | None,
    recipe: Path | None,
    name: str | None,
    inspect: bool,
    draft: Path | None,
    reader: str | None,
    dbc: Path | None,
    json_file: str | None,
) -> None:
    """Turn raw logs into a new dataset version.

    PATH is a folder DIR with DIR/<recording>/<log files>, or a log file. The same files again give the same version.
    """
    if inspect:
        from sysid.cli.ingest_inspect import inspect_paths

        inspect_paths(paths, machine, draft, reader, dbc, json_file)
        return
    for option, value in (("--draft", draft), ("--reader", reader), ("--dbc", dbc)):
        if value is not None:
            raise SettingsError(option, "given without --inspect", "both, or neither", "Add --inspect.")
    from sysid import datasets
    from sysid.cli.datasets import describe

    begin = time.perf_counter()
    with progress_bar("ingest") as progress:
        dataset = datasets.ingest(
            list(paths),
            workspace,
            machine=machine,
            recipe=recipe,
            name=name,
            progress=progress,
        )
    seconds = time.perf_counter() - begin
    out = Printer(json_file)
    show_dataset(out, dataset)
    out.line(f"{dataset.reference} in {workspace} ({seconds:.1f} s)")
    out.line(f"What it is good for: sysid --workspace {workspace} datasets {dataset.reference} --quality")
    write_json(json_file, {**describe(dataset), "seconds": seconds})
