"""Writing of recordings, one folder each, with ``machine.mcap`` and ``mocap.csv``.

The recipe may choose other formats: ``machine.blf`` or ``machine.asc`` with a database beside the recordings, ``mocap.c3d``.
"""

from __future__ import annotations

import json
from pathlib import Path

from simulated_bench.mcap_log import write_mcap
from simulated_bench.motive_export import wall_clock, write_motive
from simulated_bench.recipe import BenchRecipe
from simulated_bench.run import Run, simulate
from simulated_bench.truth import describe_effects, describe_run

#: Format → its file in a recording's folder.
LOG_FILES = {
    "mcap": "machine.mcap",
    "blf": "machine.blf",
    "asc": "machine.asc",
    "motive": "mocap.csv",
    "c3d": "mocap.c3d",
}  # fmt: skip

#: Offset of the capture computer's wall clock from the machine's [s].
WALL_CLOCK_AHEAD = 37.4


def write(run: Run, folder: Path) -> list[Path]:
    """Write the logs of ``run`` into ``folder`` (made where it is missing); returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for kind in run.recipe.controller.log:
        written.append(folder / LOG_FILES[kind])
        if kind == "mcap":
            write_mcap(run.log, written[-1])
        else:
            from simulated_bench.can_log import write_can

            write_can(run.log, written[-1])
    for export in run.recipe.capture.export:
        written.append(folder / LOG_FILES[export])
        if export == "motive":
            _write_motive(run, written[-1])
        else:
            from simulated_bench.c3d_export import write_c3d

            write_c3d(run.capture, written[-1])
    return written


def write_database(recipe: BenchRecipe, folder: Path) -> list[Path]:
    """Write the database of the bus where the recipe logs it; returns the files."""
    if not {"blf", "asc"} & set(recipe.controller.log):
        return []
    from simulated_bench.can_log import write_dbc

    folder.mkdir(parents=True, exist_ok=True)
    write_dbc(folder / f"{recipe.name}.dbc")
    return [folder / f"{recipe.name}.dbc"]


def _write_motive(run: Run, path: Path) -> None:
    settings = run.recipe.capture
    started = wall_clock(run.start_ns, WALL_CLOCK_AHEAD + run.capture.clock.offset)
    write_motive(
        run.capture,
        path,
        f"{run.recipe.name} {run.recording.name}",
        started,
        settings.capture_rate,
        tuple(export.body for export in settings.exported_markers if export.recording == run.recording.name),
    )


def write_all(recipe: BenchRecipe, out: Path) -> list[Path]:
    """Simulate and write every recording of ``recipe`` into ``out``, and ``out/truth.json`` beside them."""
    described = {}
    written = []
    for recording in recipe.recordings:
        run = simulate(recipe, recording)
        folder = out / recording.name
        written += write(run, folder)
        described[recording.name] = describe_run(run)
    path = out / "truth.json"
    truth = {
        "schema": 1,
        "recipe": recipe.name,
        "seed": recipe.seed,
        "effects": describe_effects(recipe),
        "recordings": described,
    }
    path.write_text(json.dumps(truth, indent=1) + "\n", "utf-8")
    return [*written, *write_database(recipe, out), path]
