"""``sysid fleet gap NAME…``: many machines of one type, their differences and drifts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import click

from sysid.cli.output import PATH, Printer, cluster_option, json_option, progress_bar, workers_option

if TYPE_CHECKING:
    from collections.abc import Callable

    from sysid.fleet.result import Condition

#: The page, relative to the workspace; the next call replaces it.
PAGE = "fleet/fleet.html"
#: Exit status if the condition of --fail-on holds.
FAILED = 3

_plant_option = click.option("--plant", metavar="PLANT[@VERSION]", help="The simulation to test; else the nominal one.")


def _false_alarms_option(of: str) -> Callable[[Any], Any]:
    return click.option(
        "--false-alarms",
        type=click.FloatRange(0.0, min_open=True),
        default=1.0,
        show_default=True,
        help=f"Accepted false alarms {of}, in 1000 hours of recorded motion.",
    )


def _fail(out: Printer, condition: str) -> NoReturn:
    """End with the status of ``--fail-on``."""
    out.line(f"Status {FAILED}: --fail-on {condition} holds.")
    raise SystemExit(FAILED)


@click.group()
def fleet() -> None:
    """Work on many machines of one type.

    `sysid fleet gap NAME…` compares them, `sysid fleet watch NAME` watches one; with --json FILE the result is written as JSON
    as well.
    """


@fleet.command()
@click.argument("references", metavar="NAME[@VERSION]…", nargs=-1, required=True)
@_plant_option
@workers_option
@cluster_option()
@_false_alarms_option("of drift for each machine")
@click.option(
    "--fail-on",
    type=click.Choice(["differs", "drift", "any"]),
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
    trusted_network: bool,
    false_alarms: float,
    fail_on: Condition | None,
    out: Printer,
) -> None:
    """Name the effects that the simulation of a type lacks, the machines on which they differ, and those that drift.

    One dataset is one machine; its recordings are in the order of their time stamps.
    """
    with progress_bar("fleet") as progress:
        progress(0.0, "loading")  # the numerical libraries, which takes seconds
        from sysid.execution import open_executor
        from sysid.fleet import fleet_gap
        from sysid.fleet.page import fleet_page, tables
        from sysid.fleet.workflow import described
        from sysid.reports.pages import write_page
        from sysid.workspace import open_workspace

        executor = open_executor(cluster, workers, trusted_network=trusted_network)
        result = fleet_gap(location, references, plant, executor, false_alarms_per_1000_hours=false_alarms, progress=progress)
    workspace = open_workspace(location)
    _, machine = described(workspace, result.machines[0].dataset)
    out.line(f"{len(result.machines)} machines: {', '.join(item.dataset for item in result.machines)}")
    for table in tables(result, machine):
        out.show(table)
    for note in result.notes:
        out.line(f"note: {note}")
    out.line(f"Page: {write_page(workspace.output(PAGE), fleet_page(result, machine))}")
    out.json(result.to_json())
    if fail_on is not None and result.fulfils(fail_on):
        _fail(out, fail_on)


@fleet.command()
@click.argument("name", metavar="NAME")
@click.argument("folders", metavar="[FOLDER]…", nargs=-1, type=PATH)
@_plant_option
@click.option(
    "--like",
    multiple=True,
    metavar="NAME[@VERSION]",
    help="Another machine of the type, whose named effects are watched as well; may be repeated.",
)
@_false_alarms_option("of the machine")
@click.option(
    "--quiet",
    type=click.FloatRange(0.0),
    default=60.0,
    show_default=True,
    help="Seconds without a change after which a log without an end is complete; the call waits for them.",
)
@click.option("--restart", is_flag=True, help="Begin again at the newest version of NAME.")
@click.option(
    "--fail-on",
    type=click.Choice(["drift", "new"]),
    help="End with status 3 if a parameter drifts, or only if no call has reported it before.",
)
@json_option
@click.pass_obj
def watch(
    location: str,
    name: str,
    folders: tuple[Path, ...],
    plant: str | None,
    like: tuple[str, ...],
    false_alarms: float,
    quiet: float,
    restart: bool,
    fail_on: Literal["drift", "new"] | None,
    out: Printer,
) -> None:
    """Watch one machine: add the recordings that arrived in FOLDER to NAME, and name the effects that drift.

    The first call names the effects of the dataset. Each later call estimates them in the new recordings only.
    """
    with progress_bar("watch") as progress:
        progress(0.0, "loading")  # the numerical libraries, which takes seconds
        from sysid.fleet.page import drift_table, fleet_page
        from sysid.fleet.watching import watch as watch_machine
        from sysid.fleet.workflow import described
        from sysid.reports.pages import write_page
        from sysid.workspace import open_workspace

        result = watch_machine(
            location,
            name,
            folders,
            plant,
            like=like,
            false_alarms_per_1000_hours=false_alarms,
            quiet_s=quiet,
            restart=restart,
            progress=progress,
        )
    workspace = open_workspace(location)
    _, machine = described(workspace, result.dataset)
    begun = result.fleet.machines[0]
    out.line(f"{result.dataset}, watched since {begun.dataset}: {len(begun.effects)} effects, {len(result.new)} new recordings")
    for recording, by in result.arrivals.replaced:
        out.line(f"replaced: {recording} has changed" if by == recording else f"replaced: {recording}, which is part of {by}")
    for recording, other in result.arrivals.repeated:
        out.line(f"not counted: {recording}, a copy of {other}")
    for recording, note in result.arrivals.notes:
        out.line(f"in part: {recording}: {note}")
    for waiting in result.arrivals.waiting:
        out.line(f"not complete yet: {waiting}")
    for recording, why in result.arrivals.left_out:
        out.line(f"left out: {recording}: {why}")
    for recording in result.dropped:
        out.line(f"no longer in {result.dataset}: {recording}")
    out.show(drift_table(result.fleet, machine))
    page = write_page(workspace.output(f"fleet/watch/{name}.html"), fleet_page(result.fleet, machine))
    out.line(f"Page: {page}")
    out.json(result.to_json())
    if (fail_on == "drift" and result.fleet.drifts) or (fail_on == "new" and result.noticed):
        _fail(out, fail_on)
