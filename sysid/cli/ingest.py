"""``sysid ingest PATH…``: creates a dataset version from raw logs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from sysid.cli.dataset_tables import show_dataset
from sysid.cli.output import PATH, Printer, cluster_option, command, json_option, workers_option
from sysid.errors import SettingsError

if TYPE_CHECKING:
    from sysid.datasets import Role


@click.command()
@click.argument("paths", metavar="PATH…", nargs=-1, required=True, type=PATH)
@click.option("--machine", type=PATH, metavar="machine.toml", help="The machine.")
@click.option("--recipe", type=PATH, metavar="R.toml", help="Which field is which signal.")
@click.option("--name", help="Name of the dataset; else the recipe's, else the machine's.")
@click.option("--append", "to", metavar="NAME[@VERSION]", help="Only read recordings that NAME does not hold, and add them.")
@click.option("--role", metavar="fit|select|held_out", help="With --append: role of the new recordings; else the recipe's.")
@click.option("--inspect", is_flag=True, help="Only show the content of the files, and draft a recipe.")
@click.option("--draft", type=PATH, metavar="R.toml", help="With --inspect: write the draft.")
@click.option("--reader", help="With --inspect: read the files as this format.")
@click.option("--dbc", type=PATH, help="With --inspect: the database of a CAN log.")
@click.option("--propose-frame", is_flag=True, help="Only print the capture frame that follows from the recipe's survey.")
@workers_option
@cluster_option()
@json_option
@click.pass_obj
def ingest(
    workspace: str,
    paths: tuple[Path, ...],
    machine: Path | None,
    recipe: Path | None,
    name: str | None,
    to: str | None,
    role: Role | None,
    inspect: bool,
    draft: Path | None,
    reader: str | None,
    dbc: Path | None,
    propose_frame: bool,
    workers: int,
    cluster: str | None,
    trusted_network: bool,
    out: Printer,
) -> None:
    """Turn raw logs into a new dataset version.

    PATH is a folder DIR with DIR/<recording>/<log files>, or a log file. Equal files give the same version.

    With --append the new version holds the recordings of NAME, unchanged and with their roles, and those of PATH that NAME does
    not hold. Their role is --role, else that of the recipe's splits, else fit. Machine and recipe are those of NAME.
    """
    if propose_frame:
        from sysid.cli.ingest_inspect import propose

        propose(paths, machine, recipe, out)
        return
    if inspect:
        from sysid.cli.ingest_inspect import inspect_paths

        inspect_paths(paths, machine, draft, reader, dbc, out)
        return
    for option, value in (("--draft", draft), ("--reader", reader), ("--dbc", dbc)):
        if value is not None:
            raise SettingsError(option, "given without --inspect", "both, or neither", "Add --inspect.")
    from sysid.cli.dataset_tables import show_findings, show_roles
    from sysid.cli.datasets import describe
    from sysid.datasets import Store
    from sysid.datasets.checks.run import check_plausibility
    from sysid.execution import open_executor
    from sysid.front import logs

    apart = cluster is not None or workers > 1
    executor = open_executor(cluster, workers, trusted_network=trusted_network) if apart else None
    store = Store(workspace)
    before = store.manifest(to)["version"] if to is not None else 0
    begin = time.perf_counter()
    dataset = logs.ingest(
        paths, workspace, machine=machine, recipe=recipe, name=name, append_to=to, role=role, executor=executor
    )
    seconds = time.perf_counter() - begin
    show_dataset(out, dataset)
    for note in dataset.quality.get("notes", ()):
        out.line(f"note: {note}")
    for line in dataset.machine.left_out:
        out.entry(f"left out of machine.toml: {line}")
    found = show_roles(out, dataset, workspace)
    if to is not None and dataset.version == before:
        out.line(f"{dataset.reference} already holds all of these recordings: nothing was added.")
    elif to is not None:
        for added in store.tables(dataset.reference)[-1].recordings:
            as_role = f" as {dataset.splits[added]}" if added in dataset.splits else ""
            out.line(f"added to {dataset.name}@{before}: {added}{as_role}")
    findings = check_plausibility(dataset)
    show_findings(out, findings)
    out.line(f"{dataset.reference} in {workspace} ({seconds:.1f} s)")
    out.line(f"Coverage and excitation: {command('datasets', dataset.reference, '--quality', workspace=workspace)}")
    plausibility = [finding.to_json() for finding in findings]
    out.json({**describe(dataset), "plausibility": plausibility, **found, "seconds": seconds})
