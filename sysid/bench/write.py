"""Writing recordings the way a site would hand them over: one folder a recording, ``machine.mcap`` and ``mocap.csv`` in it."""

from __future__ import annotations

import json
from pathlib import Path

from sysid.bench.mcap_log import write_mcap
from sysid.bench.motive_export import wall_clock, write_motive
from sysid.bench.recipe import Recipe
from sysid.bench.run import Run, simulate
from sysid.bench.truth import describe_effects, describe_run

#: The capture computer's wall clock was never set by the machine's [s].
WALL_CLOCK_AHEAD = 37.4


def write(run: Run, folder: Path) -> None:
    """Write both logs of ``run`` into ``folder`` (made where it is missing)."""
    folder.mkdir(parents=True, exist_ok=True)
    write_mcap(run.log, folder / "machine.mcap")
    settings = run.recipe.capture
    started = wall_clock(run.start_ns, WALL_CLOCK_AHEAD + run.capture.clock.offset)
    write_motive(
        run.capture,
        folder / "mocap.csv",
        f"{run.recipe.name} {run.recording.name}",
        started,
        settings.capture_rate,
        tuple(export.body for export in settings.exported_markers if export.recording == run.recording.name),
    )


def write_all(recipe: Recipe, out: Path) -> list[Path]:
    """Simulate and write every recording of ``recipe`` into ``out``, and ``out/truth.json`` beside them."""
    described = {}
    written = []
    for recording in recipe.recordings:
        run = simulate(recipe, recording)
        folder = out / recording.name
        write(run, folder)
        described[recording.name] = describe_run(run)
        written += [folder / "machine.mcap", folder / "mocap.csv"]
    path = out / "truth.json"
    truth = {
        "schema": 1,
        "recipe": recipe.name,
        "seed": recipe.seed,
        "effects": describe_effects(recipe),
        "recordings": described,
    }
    path.write_text(json.dumps(truth, indent=1) + "\n", "utf-8")
    return [*written, path]
