"""``sysid fit actuator|motion|forward NAME…``: fits, evaluates and registers networks; and ``sysid validate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.cli.network_tables import show_calibration, show_coverage, show_directions, show_errors
from sysid.cli.output import PATH, Printer, cluster_option, json_option, progress_bar, workers_option

if TYPE_CHECKING:
    from sysid.front.networks import FittedNetwork, Kind
    from sysid.networks import NetworkRecipe
    from sysid.progress import Progress


@click.command()
@click.argument("kind", type=click.Choice(["actuator", "motion", "forward"]))
@click.argument("references", nargs=-1, required=True, metavar="NAME[@VERSION]…")
@click.option("--recipe", type=PATH, metavar="R.toml", help="Keys that differ from the default.")
@workers_option
@cluster_option("For several datasets: address of a Dask scheduler, as tcp://HOST:PORT.")
@json_option
@click.pass_obj
def fit(
    location: str,
    kind: Kind,
    references: tuple[str, ...],
    recipe: Path | None,
    workers: int,
    cluster: str | None,
    trusted_network: bool,
    out: Printer,
) -> None:
    """Fit the networks of datasets: actuator (cylinder ↔ joint), motion (commands → motion) or forward (joints → tip).

    With ``model = "history"`` under ``[actuator]`` of the recipe, actuator networks depend on past motion.

    The networks of one dataset are fitted here, on all cores; several datasets are tasks, with the same networks. An
    interrupted fit (Ctrl-C, SIGTERM, power) resumes when the same command is repeated.
    """
    from sysid.front import networks
    from sysid.networks import load_recipe

    settings = load_recipe(recipe)
    if len(references) == 1:
        found = networks.fit(kind, references[0], location, recipe=settings)
        _show(out, found, location)
        out.json({"schema": 1, **found.to_json()})
        return
    from sysid.execution import open_executor

    with progress_bar(f"fit {kind}, {len(references)} datasets") as progress:
        calls = [(location, kind, reference, settings) for reference in references]
        results = open_executor(cluster, workers, trusted_network=trusted_network).run(_task, calls, progress, reports=True)
    columns = ("model", "network output", "rows", "rmse", "95 %", "max", "time")
    out.table(columns, [row for result in results for row in _rows(result)], right=(3, 4, 5, 6))
    out.json({"schema": 1, "fits": results})


def _task(location: str, kind: Kind, reference: str, settings: NetworkRecipe, progress: Progress) -> dict[str, Any]:
    """Task: the fit of one dataset, registered, as JSON."""
    from sysid.front import networks

    return networks.fit(kind, reference, location, recipe=settings, progress=progress).to_json()


def _show(out: Printer, found: FittedNetwork, location: str) -> None:
    from sysid.location import local_folder

    if found.calibration is not None:
        show_calibration(out, found.calibration)
    if found.report is not None:
        show_errors(out, found.report)
        show_directions(out, found.report)
    else:
        out.line(f"Not evaluated: {found.not_evaluated}")
    out.line(f"{found.version} in {local_folder(location)} ({found.seconds:.1f} s)")


def _rows(result: Mapping[str, Any]) -> Sequence[tuple[str, ...]]:
    """Rows of one fit of several: the errors of each output."""
    from sysid.display import NOTHING
    from sysid.figures import NetworkError

    head, taken = str(result["model"]), f"{result['seconds']:.1f} s"
    if result["validation"] is None:
        return [(head, "not evaluated", *[NOTHING] * 4, taken)]
    rows = []
    for entry in result["validation"]["outputs"]:
        errors = {key: entry["metrics"][key] for key in ("rmse", "p95", "max")}
        figure = NetworkError(entry["output"], entry["rows"], entry["unit"], **errors)
        rows.append((head, figure.output, figure.rows, *figure.texts, taken))
    return rows


@click.command()
@click.argument("model")
@click.argument("reference", metavar="NAME[@VERSION]")
@json_option
@click.pass_obj
def validate(location: str, model: str, reference: str, out: Printer) -> None:
    """Evaluate a fitted network on held-out recordings.

    On another dataset than its own, it also tests for drift: whether the recordings lie inside the fitted ranges, and whether
    the errors are significantly larger than on its own held-out rows.
    """
    from sysid.cli.version_tables import show_drift
    from sysid.front import networks

    found = networks.validate(model, reference, location)
    if found.report is not None:
        show_errors(out, found.report)
        show_directions(out, found.report)
        show_coverage(out, found.report)
    if found.drift is not None:
        show_drift(out, found.drift)
    if found.not_tested:
        out.line(f"The test for drift is not possible: {found.not_tested}")
    if found.not_evaluated:
        out.line(f"No error report: {found.not_evaluated}")
    out.json(found.to_json())
