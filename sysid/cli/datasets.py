"""``sysid datasets [NAME]``: what the workspace holds, or what one dataset version is made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from sysid.cli.output import Printer, json_option, write_json
from sysid.cli.tables import show_dataset

if TYPE_CHECKING:
    from sysid.datasets import Dataset


@click.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--quality", is_flag=True, help="What NAME is good for: coverage, noise, and a verdict for every effect.")
@json_option
@click.pass_obj
def datasets(workspace: str, reference: str | None, quality: bool, json_file: str | None) -> None:
    """List dataset versions, or show one."""
    from sysid.datasets import Store

    if quality:
        from sysid.cli.quality import show_quality

        show_quality(workspace, reference, json_file)
        return

    out = Printer(json_file)
    store = Store(workspace)
    if reference is not None:
        dataset = store.load(reference)
        show_dataset(out, dataset)
        write_json(json_file, describe(dataset))
        return
    entries = store.list()
    write_json(json_file, {"schema": 1, "datasets": [_entry(entry) for entry in entries]})
    if not entries:
        out.line(f"No datasets in {workspace} yet: sysid ingest PATH makes one.")
        return
    rows = [
        (entry.reference, entry.machine, entry.recordings, f"{entry.seconds:.0f}", entry.created, entry.digest[:12])
        for entry in entries
    ]
    out.table(("dataset", "machine", "recordings", "seconds", "made", "content"), rows, right=(2, 3))


def _entry(entry: Any) -> dict[str, Any]:
    return {
        "dataset": entry.reference,
        "machine": entry.machine,
        "recordings": entry.recordings,
        "seconds": entry.seconds,
        "created": entry.created,
        "digest": entry.digest,
    }


def describe(dataset: Dataset) -> dict[str, Any]:
    """A dataset version for machines; :func:`sysid.cli.tables.show_dataset` is for people."""
    from dataclasses import asdict

    return {
        "schema": 1,
        "dataset": dataset.reference,
        "digest": dataset.digest,
        "machine": dataset.machine.name,
        "recordings": [
            {
                "name": recording.name,
                "kind": recording.kind,
                "role": dataset.splits.get(recording.name),
                "rows": len(recording),
                "rate_hz": recording.rate_hz,
                "signals": list(recording.signals),
            }
            for recording in dataset.recordings
        ],
        "units": dict(dataset.units),
        "clocks": [asdict(clock) for clock in dataset.clocks],
        "sources": [asdict(source) for source in dataset.sources],
        "quality": dict(dataset.quality),
    }
