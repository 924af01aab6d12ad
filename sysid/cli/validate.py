"""``sysid validate MODEL NAME``: the error report of a network, and the test for drift on other datasets."""

from __future__ import annotations

import click

from sysid.cli.network_tables import show_coverage, show_directions, show_errors
from sysid.cli.output import Printer, json_option, write_json


@click.command()
@click.argument("model")
@click.argument("reference", metavar="NAME[@VERSION]")
@json_option
@click.pass_obj
def validate(location: str, model: str, reference: str, json_file: str | None) -> None:
    """Evaluate a fitted network on held-out recordings.

    On another dataset than its own, it also tests for drift: whether the recordings lie inside the fitted ranges, and whether
    the errors are significantly larger than on its own held-out rows.
    """
    from sysid.cli.version_tables import show_drift
    from sysid.errors import ExcitationError, StoreError
    from sysid.model_versions import ModelVersions
    from sysid.workspace import open_workspace

    workspace = open_workspace(location)
    dataset = workspace.dataset(reference)
    out = Printer(json_file)
    version = workspace.models.find(model)
    own = version.lineage.get("dataset_digest") == dataset.digest
    report, drift, not_evaluated = None, None, ""
    try:
        report = workspace.validation(model, dataset)
        show_errors(out, report)
        show_directions(out, report)
        show_coverage(out, report)
    except ExcitationError as error:
        if own:
            raise
        not_evaluated = str(error)  # drift may still be testable
    if not own:
        try:
            drift = ModelVersions(workspace).drift(model, dataset)
            show_drift(out, drift)
        except (ExcitationError, StoreError) as error:
            if report is None:
                raise
            out.line(f"The test for drift is not possible: {error}")
        if not_evaluated:
            out.line(f"No error report: {not_evaluated}")
    values = report.to_json() if report is not None else {"model": version.reference, "dataset": dataset.reference}
    write_json(json_file, {"schema": 1, **values, "drift": drift.to_json() if drift is not None else None})
