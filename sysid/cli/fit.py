"""``sysid fit actuator|motion|forward NAME``: fits, evaluates and registers networks."""

from __future__ import annotations

import time
from pathlib import Path

import click

from sysid.cli.output import Printer, json_option, progress_bar, write_json
from sysid.cli.tables import show_calibration, show_directions, show_errors


@click.command()
@click.argument("kind", type=click.Choice(["actuator", "motion", "forward"]))
@click.argument("reference", metavar="NAME[@VERSION]")
@click.option(
    "--recipe", type=click.Path(path_type=Path), default=None, metavar="R.toml", help="Keys that differ from the paper's."
)
@json_option
@click.pass_obj
def fit(location: str, kind: str, reference: str, recipe: Path | None, json_file: str | None) -> None:
    """Fit the networks of a dataset: actuator (cylinder ↔ joint), motion (commands → motion) or forward (joints → tip).

    With ``model = "history"`` under ``[actuator]`` of the recipe, actuator networks depend on past motion.

    An interrupted fit (Ctrl-C, SIGTERM, power) resumes when the same command is repeated.
    """
    from sysid.errors import ExcitationError
    from sysid.networks import (
        Calibration,
        Checkpoints,
        StructuredForward,
        fit_actuator,
        fit_forward,
        fit_history,
        fit_motion,
        load_recipe,
    )
    from sysid.validate import validate_model
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    dataset = workspace.dataset(reference)
    settings = load_recipe(recipe)
    begin = time.perf_counter()
    with progress_bar(f"fit {kind}") as progress:
        actuator = fit_history if settings.actuator.model == "history" else fit_actuator
        model = {"actuator": actuator, "motion": fit_motion, "forward": fit_forward}[kind](
            dataset, settings, progress, Checkpoints(workspace.root.path("training"))
        )
    seconds = time.perf_counter() - begin
    try:
        report = validate_model(model, dataset, recipe=settings)
    except ExcitationError as reason:
        report, not_evaluated = None, str(reason)
    version = workspace.add_network(dataset, model, settings, report)
    out = Printer(json_file)
    if isinstance(model, StructuredForward) and isinstance(model.structure, Calibration):
        show_calibration(out, model.structure)
    if report is not None:
        show_errors(out, report)
        show_directions(out, report)
    else:
        out.line(f"Not evaluated: {not_evaluated}")
    out.line(f"{version.reference} in {workspace.folder} ({seconds:.1f} s)")
    result = {"schema": 1, "model": version.reference, "dataset": dataset.reference, "seconds": seconds}
    if isinstance(model, StructuredForward) and isinstance(model.structure, Calibration):
        result["calibration"] = model.structure.to_json()
    write_json(json_file, {**result, "validation": report.to_json() if report is not None else None})
