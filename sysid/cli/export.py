"""``sysid export PLANT --to TARGET``: the repaired simulation, or the card of an actuator, for another simulator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from sysid.cli.output import PATH, Printer, json_option, progress_bar

if TYPE_CHECKING:
    from sysid.export.export import Export

#: As in :mod:`sysid.export.export`, which loads the numerical libraries.
NAMES = ("mjcf", "urdf", "sdf", "isaaclab", "newton", "fmu", "simulink", "lut", "json")


@click.command()
@click.argument("reference", metavar="PLANT[@VERSION] | actuators/NAME")
@click.option("--to", "target", required=True, metavar="TARGET", help=f"{', '.join(NAMES)}.")
@click.option("--out", "folder", type=PATH, required=True, metavar="DIR", help="A new folder, or that of an earlier export.")
@click.option("--dataset", metavar="NAME[@VERSION]", help="Whose held-out recordings are replayed. Default: its own.")
@click.option("--samples", type=click.IntRange(1, 1_000_000), default=1000, show_default=True, help="Draws of the parameters.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the draws.")
@click.option("--force", is_flag=True, help="Keep an export that does not agree with the plant.")
@json_option
@click.pass_obj
def export(
    location: str, reference: str, target: str, folder: Path, dataset: str | None, samples: int, seed: int, force: bool,
    out: Printer,
) -> None:  # fmt: skip
    """Write a plant for another simulator, and keep it only if it replays the held-out recordings as the plant does.

    The card of an actuator (`sysid actuators`) is written in the same way, without a replay.
    """
    with progress_bar("export") as progress:
        progress(0.0, "loading")  # the numerical libraries, which takes seconds
        from sysid.actuators import is_card
        from sysid.export.export import check_folder, target_named
        from sysid.front import files
        from sysid.workspace import open_workspace

        target_named(target)
        check_folder(folder)
        workspace = open_workspace(location)
        recorded = None if is_card(reference) else files.replayed_dataset(workspace, reference, dataset)
        made = files.export(
            reference, target, folder, dataset=recorded or dataset, workspace=workspace, samples=samples, seed=seed,
            force=force, progress=progress,
        )  # fmt: skip
    _show(out, made, recorded.units if recorded is not None else {})
    out.json(made.to_json())


def _show(out: Printer, made: Export, units: Mapping[str, str]) -> None:
    from sysid.export.page import shown, unit_of

    out.line(f"{made.plant} for {made.target}: {made.folder / made.files[0]}")
    for item in made.lacking:
        out.line(f"not representable: {item}")
    if made.replay is None:
        out.line(made.unreplayed)
        return
    rows = []
    for row in made.replay.rows:
        values = (row.export_error, row.plant_error, row.noise, row.difference)
        cells = [shown(value, unit_of(row.signal, units)) for value in values]
        rows.append((row.signal, *cells, "yes" if row.agrees else "no"))
    what = "Free run of" if made.replay.kind == "motion" else "Forces at the measured motion of"
    out.line(f"{what} {', '.join(made.replay.recordings)}, RMS:")
    out.table(("signal", made.target, "plant", "sensor noise", "difference", "agrees"), rows, right=(1, 2, 3, 4))
    out.line(f"All files: {', '.join(made.files)}")
