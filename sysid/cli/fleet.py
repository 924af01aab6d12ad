"""``sysid fleet gap NAME…``: many machines of one type, their differences and drifts."""

from __future__ import annotations

from typing import Literal

import click

from sysid.cli.output import Printer, json_option, progress_bar, write_json

#: The page, relative to the workspace; the next call replaces it.
PAGE = "fleet/fleet.html"
#: Exit status if the condition of --fail-on holds.
FAILED = 3
Condition = Literal["differs", "drift", "any"]


@click.group()
def fleet() -> None:
    """Work on many machines of one type.

    `sysid fleet gap NAME…` compares them; with --json FILE the result is written as JSON as well.
    """


@fleet.command()
@click.argument("references", metavar="NAME[@VERSION]…", nargs=-1, required=True)
@click.option("--plant", default=None, metavar="PLANT[@VERSION]", help="The simulation to test; else the nominal one.")
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes on this machine.")
@click.option(
    "--cluster",
    envvar="SYSID_CLUSTER",
    default=None,
    metavar="ADDRESS",
    help="Address of a Dask scheduler, as tcp://HOST:PORT.",
)
@click.option(
    "--false-alarms",
    type=click.FloatRange(0.0, min_open=True),
    default=1.0,
    show_default=True,
    help="Accepted false alarms of drift for each machine, in 1000 hours of recorded motion.",
)
@click.option(
    "--fail-on",
    type=click.Choice(["differs", "drift", "any"]),
    default=None,
    help="End with status 3 if machines differ, or if a parameter drifts, for a scheduled run.",
)
@json_option
@click.pass_obj
def gap(
    location: str,
    references: tuple[str, ...],
    plant: str | None,
    workers: int,
    cluster: str | None,
    false_alarms: float,
    fail_on: Condition | None,
    json_file: str | None,
) -> None:
    """Name the effects that the simulation of a type lacks, the machines on which they differ, and those that drift.

    One dataset is one machine; its recordings are in the order of their time stamps.
    """
    out = Printer(json_file)
    with progress_bar("fleet") as progress:
        progress(0.0, "loading")  # the numerical libraries, which takes seconds
        from sysid.execution import open_executor
        from sysid.fleet import fleet_gap
        from sysid.fleet.page import fleet_page
        from sysid.fleet.tables import tables
        from sysid.fleet.workflow import described
        from sysid.reports.pages import write_page
        from sysid.workspace import open_workspace

        executor = open_executor(cluster, workers)
        result = fleet_gap(location, references, plant, executor, false_alarms_per_1000_hours=false_alarms, progress=progress)
    workspace = open_workspace(location)
    _, machine = described(workspace, result.machines[0].dataset)
    out.line(f"{len(result.machines)} machines: {', '.join(item.dataset for item in result.machines)}")
    for table in tables(result, machine):
        if table.rows:
            out.table(table.header, table.rows, table.right)
        else:
            out.line(table.empty)
    for note in result.notes:
        out.line(f"note: {note}")
    out.line(f"Page: {write_page(workspace.output(PAGE), fleet_page(result, machine))}")
    write_json(json_file, result.to_json())
    if fail_on is not None and result.fulfils(fail_on):
        out.line(f"Status {FAILED}: --fail-on {fail_on} holds.")
        raise SystemExit(FAILED)
