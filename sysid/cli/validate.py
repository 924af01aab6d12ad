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
    from sysid.front import networks

    out = Printer(json_file)
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
    write_json(json_file, found.to_json())
