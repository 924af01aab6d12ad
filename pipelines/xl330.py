"""XL330: the gap of an ideal servo and of its motor from logs of six seconds, and the repeatability of names over them.

    .venv/bin/python pipelines/xl330.py FOLDER_WITH_THE_JSON_FILES             (their source: datasets/xl330/README.md)

As a servo it is a position axis. As a motor it is a force axis that moves the pendulum against friction. Each of the two fast
logs of a gain is fitted alone, the other selects, and the slow one, with little excitation, is held out; then all gains.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from repeatability import repeatability, show_repeatability
from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.config import read_toml
from sysid.datasets import Dataset, ingest
from sysid.datasets.recording import Role
from sysid.gap import GapResult, find_gap
from sysid.logs import ReadOptions, reader_named
from sysid.reports import write_report
from sysid.workspace import Workspace, open_workspace

CONTENT = Path(__file__).resolve().parents[1] / "datasets" / "xl330"
#: Logs of each proportional gain in the roles fit, select, held out.
ORDERS = (("sin_sin", "sin_time_square", "up_and_down"), ("sin_time_square", "sin_sin", "up_and_down"))
GAINS = (100, 200, 400, 800)
#: Motor as published (m1 of the authors) [N·m/A, Ω], supply [V], full duty.
KT, RESISTANCE, SUPPLY, FULL_DUTY = 0.3866957639281311, 4.017129222290597, 7.4, 885.0
#: Values of m1 for the same quantities; the motor brakes itself with kt²/R.
PUBLISHED = {
    "viscous_friction": {"coefficient": 0.003661672282824312 + KT**2 / RESISTANCE},
    "coulomb_friction": {"force": 0.01283272036582759},
    "inertial_error": {"rotor": 0.0018141672784458866},
}


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the logs in ``raw`` and return the path of ``<workspace>/xl330/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "xl330"
    folder.mkdir(parents=True, exist_ok=True)
    station = PipelineProgress(out)

    with station("ingest") as progress:
        servo = ingest(raw, workspace, recipe=CONTENT / "recipe.toml", progress=progress)
        torque_logs = write_torques(raw, folder / "torque")
        motor = ingest(torque_logs, workspace, machine=CONTENT / "torque.toml", progress=progress)

    views: dict[str, Any] = {}
    pages: dict[str, Path] = {}
    for view, dataset in (("servo", servo), ("motor", motor)):
        with station(f"gap, {view}, each log"):
            runs = {part.recordings[0].name: find_gap(part, place.plant(part)) for part in log_by_log(dataset)}
        with station(f"gap, {view}, all logs"):
            whole = all_logs(dataset)
            together = find_gap(whole, place.plant(whole), place.models, add=True)
        pages[view] = report_on(place, whole, together, folder / f"report-{view}.html")
        repeats = repeatability(runs)
        out.block(f"\nThe {view}, all logs together")
        show_gap(out, together, whole)
        out.line(f"The {view}, each log alone ({len(runs)} runs; {verdicts(runs)})")
        show_repeatability(out, repeats, dataset.machine)
        views[view] = {
            "dataset": dataset.reference,
            "together": together.to_json(),
            "runs": {name: brief(gap) for name, gap in runs.items()},
            "stability": [item.to_json() for item in repeats],
        }

    rows = [
        (item["name"], key, f"{value:.4f}", f"{found['median']:.4f}", f"{len(item['named'])} logs")
        for item in views["motor"]["stability"]
        for value in PUBLISHED.get(item["name"], {}).values()  # one number each; a direction may have its own here
        for key, found in item["over_runs"].items()
    ]
    out.line("The motor beside its published parameters (fitted by the authors on more logs than these)")
    out.table(("effect", "parameter", "published", "median here", "named in"), rows, right=(2, 3))
    result = {"schema": 1, "views": views, "published": PUBLISHED, "seconds": station.seconds, "files": pages}
    write_json(folder / "result.json", result)
    out.block("".join(f"Report   {page}\n" for page in pages.values()) + f"Figures  {folder / 'result.json'}")
    return folder / "result.json"


def write_torques(raw: Path, folder: Path) -> Path:
    """One CSV a log with the torque of the motor [N·m]."""
    files = read_toml(CONTENT / "recipe.toml")["recordings"]["files"]
    for name, file in files.items():
        (log,) = reader_named("json", CONTENT).read(raw / file, ReadOptions(time="timestamp"))
        duty = (log.columns["load"] + 2**15) % 2**16 - 2**15  # written as 16 bits without a sign
        table = {
            "time": log.stamps["time"] * 1e-9,
            "arm.command [N·m]": KT / RESISTANCE * SUPPLY * duty / FULL_DUTY,
            "arm.joint [rad]": log.columns["position"],
        }
        (folder / name).mkdir(parents=True, exist_ok=True)
        pd.DataFrame(table).to_csv(folder / name / "log.csv", index=False)
    return folder


def log_by_log(dataset: Dataset) -> Iterator[Dataset]:
    """For every brisk log a dataset that fits it, with the other two of the same gain to select and to prove."""
    for gain in GAINS:
        for order in ORDERS:
            names = [f"{trajectory}-{gain}" for trajectory in order]
            recordings = tuple(dataset.recording(name) for name in names)
            yield replace(dataset, recordings=recordings, splits=dict(zip(names, ("fit", "select", "held_out"), strict=True)))


def all_logs(dataset: Dataset) -> Dataset:
    """All logs by gain: two gains to fit, one to select, one to prove."""
    roles: dict[int, Role] = {100: "fit", 800: "fit", 200: "select", 400: "held_out"}
    return replace(dataset, splits={r.name: roles[int(r.name.rsplit("-", 1)[1])] for r in dataset.recordings})


def report_on(place: Workspace, dataset: Dataset, gap: GapResult, page: Path) -> Path:
    place.keep_gap(dataset, gap)
    return write_report(page, replace(place.report_inputs(dataset), dataset=dataset))


def brief(gap: GapResult) -> dict[str, Any]:
    """What the table of repeatability is made of, and the gap."""
    full = gap.to_json()
    return {
        key: full[key] for key in ("verdict", "effects", "unnamed", "ambiguous", "gap", "excitation", "held_out_recordings")
    }


def verdicts(runs: dict[str, GapResult]) -> str:
    counts = pd.Series([gap.verdict for gap in runs.values()]).value_counts()
    return ", ".join(f"{count} {verdict}" for verdict, count in counts.items())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder with the logs of the XL330")
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
