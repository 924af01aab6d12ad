"""``sysid fit actuator|motion|forward NAME…``: fits, evaluates and registers networks."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.cli.executor_options import cluster_option, workers_option
from sysid.cli.network_tables import show_calibration, show_directions, show_errors
from sysid.cli.output import Printer, json_option, progress_bar, write_json

if TYPE_CHECKING:
    from sysid.networks import Calibration, Model, NetworkRecipe
    from sysid.progress import Progress
    from sysid.validate import ValidationReport


@click.command()
@click.argument("kind", type=click.Choice(["actuator", "motion", "forward"]))
@click.argument("references", nargs=-1, required=True, metavar="NAME[@VERSION]…")
@click.option(
    "--recipe", type=click.Path(path_type=Path), default=None, metavar="R.toml", help="Keys that differ from the paper's."
)
@workers_option
@cluster_option("For several datasets: address of a Dask scheduler, as tcp://HOST:PORT.")
@json_option
@click.pass_obj
def fit(
    location: str,
    kind: str,
    references: tuple[str, ...],
    recipe: Path | None,
    workers: int,
    cluster: str | None,
    trusted_network: bool,
    json_file: str | None,
) -> None:
    """Fit the networks of datasets: actuator (cylinder ↔ joint), motion (commands → motion) or forward (joints → tip).

    With ``model = "history"`` under ``[actuator]`` of the recipe, actuator networks depend on past motion.

    The networks of one dataset are fitted here, on all cores; several datasets are tasks, with the same networks. An
    interrupted fit (Ctrl-C, SIGTERM, power) resumes when the same command is repeated.
    """
    from sysid.networks import load_recipe

    settings = load_recipe(recipe)
    out = Printer(json_file)
    if len(references) == 1:
        with progress_bar(f"fit {kind}") as progress:
            found = _fitted(location, kind, references[0], settings, progress)
        _show(out, found)
        write_json(json_file, {"schema": 1, **found.to_json()})
        return
    from sysid.execution import open_executor

    with progress_bar(f"fit {kind}, {len(references)} datasets") as progress:
        calls = [(location, kind, reference, settings) for reference in references]
        results = open_executor(cluster, workers, trusted_network=trusted_network).run(_task, calls, progress, reports=True)
    columns = ("model", "network output", "rows", "rmse", "95 %", "max", "time")
    out.table(columns, [row for result in results for row in _rows(result)], right=(3, 4, 5, 6))
    write_json(json_file, {"schema": 1, "fits": results})


@dataclass(frozen=True)
class _Fit:
    """A registered network with its evaluation; ``not_evaluated``: why there is none."""

    version: str
    dataset: str
    folder: str
    model: Model
    report: ValidationReport | None
    not_evaluated: str
    seconds: float

    @property
    def calibration(self) -> Calibration | None:
        from sysid.networks import Calibration, StructuredForward

        structure = self.model.structure if isinstance(self.model, StructuredForward) else None
        return structure if isinstance(structure, Calibration) else None

    def to_json(self) -> dict[str, Any]:
        result: dict[str, Any] = {"model": self.version, "dataset": self.dataset, "seconds": self.seconds}
        if self.calibration is not None:
            result["calibration"] = self.calibration.to_json()
        return {**result, "validation": self.report.to_json() if self.report is not None else None}


def _fitted(location: str, kind: str, reference: str, settings: NetworkRecipe, progress: Progress) -> _Fit:
    from sysid.errors import ExcitationError
    from sysid.networks import Checkpoints, fit_actuator, fit_forward, fit_history, fit_motion
    from sysid.validate import validate_model
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    dataset = workspace.dataset(reference)
    begin = time.perf_counter()
    actuator = fit_history if settings.actuator.model == "history" else fit_actuator
    model = {"actuator": actuator, "motion": fit_motion, "forward": fit_forward}[kind](
        dataset, settings, progress, Checkpoints(workspace.root.path("training"))
    )
    seconds = time.perf_counter() - begin
    not_evaluated = ""
    try:
        report = validate_model(model, dataset, recipe=settings)
    except ExcitationError as reason:
        report, not_evaluated = None, str(reason)
    version = workspace.add_network(dataset, model, settings, report)
    return _Fit(version.reference, dataset.reference, str(workspace.folder), model, report, not_evaluated, seconds)


def _task(location: str, kind: str, reference: str, settings: NetworkRecipe, progress: Progress) -> dict[str, Any]:
    """Task: the fit of one dataset, registered, as JSON."""
    return _fitted(location, kind, reference, settings, progress).to_json()


def _show(out: Printer, found: _Fit) -> None:
    if found.calibration is not None:
        show_calibration(out, found.calibration)
    if found.report is not None:
        show_errors(out, found.report)
        show_directions(out, found.report)
    else:
        out.line(f"Not evaluated: {found.not_evaluated}")
    out.line(f"{found.version} in {found.folder} ({found.seconds:.1f} s)")


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
