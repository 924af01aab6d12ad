"""SO-101: the gap of six ideal servos from four recordings, and the repeatability of names and values over them.

    .venv/bin/python pipelines/so101.py FOLDER_WITH_THE_RECORDINGS             (their source: datasets/so101/README.md)

Each recording is a dataset of its own, cut into blocks that fit, select and prove; nothing is shared between them.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from repeatability import repeatability, show_repeatability
from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import ingest
from sysid.gap import GapResult, find_gap
from sysid.machine import load_machine
from sysid.reports import write_report
from sysid.workspace import open_workspace

CONTENT = Path(__file__).resolve().parents[1] / "datasets" / "so101"
RECORDINGS = ("friction_gravity", "multisine", "step_response", "single_joint_elbow")


def main(raw: Path, workspace: Path, recordings: tuple[str, ...] = RECORDINGS) -> Path:
    """Run the line on the recordings in ``raw`` and return the path of ``<workspace>/so101/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "so101"
    folder.mkdir(parents=True, exist_ok=True)
    station, machine = PipelineProgress(out), load_machine(CONTENT / "machine.toml")

    gaps: dict[str, GapResult] = {}
    pages: dict[str, Path] = {}
    for name in recordings:
        with station(f"ingest, {name}") as progress:
            dataset = ingest(raw / name, workspace, recipe=CONTENT / "recipe.toml", name=f"so101-{name}", progress=progress)
        with station(f"gap, {name}") as progress:
            gaps[name] = find_gap(dataset, place.plant(dataset), place.models, add=True, progress=progress)
            place.keep_gap(dataset, gaps[name])
        pages[name] = write_report(folder / f"report-{name}.html", place.report_inputs(dataset))
        show_gap(out, gaps[name], dataset)

    repeats = repeatability(gaps)
    out.block(f"\nSO-101 over {len(gaps)} recordings; what a recording does not excite is not counted against it")
    show_repeatability(out, repeats, machine)
    rows = [(axis, *(left_over(gap, f"{axis}.joint") for gap in gaps.values())) for axis in machine.axis_names]
    out.line("Held-out RMSE of the joint [mrad]: ideal servo → repaired")
    out.table(("joint", *gaps), rows, right=range(1, len(gaps) + 1))

    result: dict[str, Any] = {"schema": 1, "runs": {name: gap.to_json() for name, gap in gaps.items()}}
    result |= {"stability": [item.to_json() for item in repeats], "seconds": station.seconds, "files": pages}
    write_json(folder / "result.json", result)
    out.block("".join(f"Report   {page}\n" for page in pages.values()) + f"Figures  {folder / 'result.json'}")
    return folder / "result.json"


def left_over(gap: GapResult, signal: str) -> str:
    return f"{1e3 * gap.gap.before[signal]:.1f} → {1e3 * gap.gap.after[signal]:.1f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder with one folder a recording")
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
