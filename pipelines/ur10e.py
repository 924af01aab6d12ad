"""UR10e: friction of six joints from URDF and motor currents, and a payload from the repaired plant.

    .venv/bin/python pipelines/ur10e.py FOLDER_WITH_THE_LOGS_AND_THE_URDF      (their source: datasets/ur10e/README.md)

Without the payload the plant is repaired; each log with the payload is then a dataset of its own, tested against that repair.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import Dataset, ingest
from sysid.gap import GapResult, find_gap
from sysid.reports import write_report
from sysid.workspace import open_workspace

CONTENT = Path(__file__).resolve().parents[1] / "datasets" / "ur10e"
LOADED = {"harmonics_14_load": "ur-20_02_19_14harm50secLoad.csv", "harmonics_15_load": "ur-20_02_19_15harm50secLoad.csv"}
#: Of the authors [kg].
PAYLOAD = 2.805
COLUMNS = 31


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the files in ``raw`` and return the path of ``<workspace>/ur10e/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "ur10e"
    station = PipelineProgress(out)
    site = prepare(raw, folder / "site")

    gaps: dict[str, GapResult] = {}
    pages: dict[str, Path] = {}
    torques: dict[str, dict[str, float]] = {}
    for name in ("ur10e", *LOADED):
        with station(f"ingest, {name}") as progress:
            dataset = ingest(site / "logs", workspace, recipe=site / f"{name}.toml", progress=progress)
        with station(f"gap, {name}") as progress:
            tested = place.plant(dataset) if name == "ur10e" else place.plant(dataset, gaps["ur10e"].plant_after)
            gaps[name] = find_gap(dataset, tested, place.models, add=name == "ur10e", world=False, progress=progress)
            place.keep_gap(dataset, gaps[name])
        pages[name] = write_report(folder / f"report-{name}.html", place.report_inputs(dataset))
        torques[name] = torque_of(dataset, gaps[name])
        show_gap(out, gaps[name], dataset)

    found = {name: payload_of(gaps[name]) for name in LOADED}
    rows = [(name, "–" if mass is None else f"{mass:.2f}", f"{PAYLOAD}") for name, mass in found.items()]
    out.line("Payload [kg]: found, published")
    out.table(("log", "found", "published"), rows, right=(1, 2))
    left = {
        name: {signal: gap.gap.after[signal] / size for signal, size in torques[name].items()} for name, gap in gaps.items()
    }
    out.line("Held-out force error / torque (RMS), repaired")
    out.table(
        ("signal", *left), [(s, *(f"{100.0 * left[name][s]:.1f} %" for name in left)) for s in left["ur10e"]], right=(1, 2, 3)
    )
    result: dict[str, Any] = {"schema": 1, "runs": {name: gap.to_json() for name, gap in gaps.items()}, "payload": found}
    result |= {"published": {"payload": PAYLOAD}, "left": left, "seconds": station.seconds, "files": pages}
    write_json(folder / "result.json", result)
    out.block("".join(f"Report   {page}\n" for page in pages.values()) + f"Figures  {folder / 'result.json'}")
    return folder / "result.json"


def prepare(raw: Path, site: Path) -> Path:
    """The site: machine and URDF, one recipe for each dataset, logs without damaged rows at their start."""
    logs = site / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(CONTENT / "machine.toml", site / "machine.toml")
    shutil.copyfile(raw / "ur10e.urdf", site / "ur10e.urdf")
    text = (CONTENT / "recipe.toml").read_text("utf-8")
    recipe = tomllib.loads(text)
    (site / "ur10e.toml").write_text(text, "utf-8")
    streams = text[text.index("[[streams]]") :]
    for name, file in LOADED.items():
        head = f'schema = 1\nname = "{name}"\nmachine = "machine.toml"\n\n[recordings]\nfiles = {{ {name} = "{file}" }}\n\n'
        (site / f"{name}.toml").write_text(head + streams, "utf-8")
    for file in (*recipe["recordings"]["files"].values(), *LOADED.values()):
        with (raw / file).open(newline="", encoding="utf-8") as source:
            kept = undamaged([row for row in csv.reader(source) if len(row) == COLUMNS])
        with (logs / file).open("w", newline="", encoding="utf-8") as target:
            csv.writer(target).writerows(kept)
    return site


def undamaged(rows: list[list[str]]) -> list[list[str]]:
    """The rows after the last one whose stamp is not within a second of the next."""
    stamps = np.array([float(row[0]) for row in rows])
    jumps = np.flatnonzero(~(np.abs(np.diff(stamps)) < 1.0))
    return rows[int(jumps[-1]) + 1 :] if len(jumps) else rows


def torque_of(dataset: Dataset, gap: GapResult) -> dict[str, float]:
    """Root mean square of the torque of each joint in the held-out recordings [N·m]."""
    held_out = [dataset.recording(name) for name in gap.held_out_recordings]
    signals = [f"{name}.command" for name in dataset.machine.axis_names]
    return {s: float(np.sqrt(np.nanmean(np.concatenate([r.values(s) for r in held_out]) ** 2))) for s in signals}


def payload_of(gap: GapResult) -> float | None:
    """The named payload [kg]."""
    return next((float(e.parameters["mass"]) for e in gap.effects if e.name == "payload"), None)  # type: ignore[arg-type]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
