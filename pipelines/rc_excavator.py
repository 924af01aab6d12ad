"""RC excavator: the gap of a linear-rate simulation of three hydraulic cylinders, from a joystick log of two minutes.

    .venv/bin/python pipelines/rc_excavator.py FOLDER_WITH_THE_CSV_FILES         (their source: datasets/rc_excavator/README.md)

The last third of the manual log is held out and proves the dead-bands. The step files, full command in either direction, are
held out too: they prove speed and delay, read off the measured and the simulated strokes in the same way.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.cli.gap_tables import show_gap, show_repair
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import Recording, ingest
from sysid.display import fixed
from sysid.gap import find_gap
from sysid.plant import Plant, free_run
from sysid.reports import write_report
from sysid.workspace import open_workspace

Array = npt.NDArray[np.float64]
RECIPE = Path(__file__).resolve().parents[1] / "datasets" / "rc_excavator" / "recipe.toml"
#: Rows of a stroke later than this after its start belong to steady motion [s].
STEADY = 0.5
#: A command above this share is a full one.
FULL = 0.9


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the files in ``raw`` and return the path of ``<workspace>/rc_excavator/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "rc_excavator"
    folder.mkdir(parents=True, exist_ok=True)
    station = PipelineProgress(out)

    with station("ingest") as progress:
        dataset = ingest(raw, workspace, recipe=RECIPE, progress=progress)
    plant = place.plant(dataset)  # speed = gain · command, nothing else
    with station("gap") as progress:
        gap = find_gap(dataset, plant, place.models, add=True, progress=progress)
        place.keep_gap(dataset, gap)
    with station("report"):
        page = write_report(folder / "report.html", place.report_inputs(dataset))
    show_gap(out, gap, dataset)
    repaired = place.plant(dataset, gap.plant_after) if gap.plant_after else plant
    if gap.plant_after:
        show_repair(out, gap, dataset)

    manual = [recording for recording in dataset.with_role("held_out") if recording.name.startswith("manual")]
    errors = {axis.name: stroke_error(manual, (plant, repaired), axis.driven) for axis in dataset.machine.axes}
    rows = [(name, *(f"{1e3 * value:.2f}" for value in pair)) for name, pair in errors.items()]
    out.block("\nLast third of the manual log, free run from the joystick commands: RMSE [mm]")
    out.table(("cylinder", "before", "after"), rows, right=(1, 2))

    strokes = [
        line for r in dataset.with_role("held_out") if r.name.startswith("steps") for line in strokes_of(r, plant, repaired)
    ]
    out.line("Step files, full command: mean of three repeats, simulations in the order before, after")
    table = []
    for axis, way in dict.fromkeys((line.axis, line.command) for line in strokes):
        same = [line for line in strokes if (line.axis, line.command) == (axis, way)]
        speeds, delays = (np.mean([getattr(line, key) for line in same], axis=0) for key in ("speed", "delay"))
        table.append((axis, f"{way:+.0f}", *(fixed(1e3 * v, 1) for v in speeds), *(fixed(1e3 * d, 0) for d in delays)))
    header = ("cylinder", "command", "speed [mm/s]: measured", "before", "after", "delay [ms]: measured", "before", "after")
    out.table(header, table, right=range(1, 8))

    result: dict[str, Any] = {"schema": 1, "dataset": dataset.reference, "gap": gap.to_json(), "manual": errors}
    result |= {"steps": [asdict(line) for line in strokes], "seconds": station.seconds, "files": {"report": page}}
    write_json(folder / "result.json", result)
    out.block(f"Report   {page}\nFigures  {folder / 'result.json'}")
    return folder / "result.json"


@dataclass(frozen=True)
class Stroke:
    """Speed [m/s] and delay [s] of one stroke: measured, simulated before, simulated after."""

    recording: str
    axis: str
    command: float
    speed: tuple[float, ...]
    delay: tuple[float, ...]


def strokes_of(recording: Recording, *plants: Plant) -> Iterator[Stroke]:
    """The strokes of the axis that a step file drives, each with the rest in neutral that came before and was not recorded."""
    axis = recording.name.split("-")[1]
    signal, lead = f"{axis}.cylinder", round(recording.rate_hz)
    for way in (1.0, -1.0):
        stroke = recording.table[way * recording.table[f"{axis}.command"] > FULL]
        neutral = {str(name): 0.0 for name in stroke.columns if str(name).endswith(".command")}
        rest = pd.concat([stroke.iloc[:1]] * lead).assign(**neutral)
        table = pd.concat([rest, stroke], ignore_index=True).assign(time=lambda t: np.arange(len(t)) / recording.rate_hz)
        whole = replace(recording, name=f"{recording.name}{way:+.0f}", table=table)
        runs = [whole.values(signal), *(free_run(plant, whole)[signal].to_numpy() for plant in plants)]
        lines = [_line(whole.values("time")[lead:], run[lead:]) for run in runs]
        yield Stroke(recording.name, axis, way, tuple(speed for speed, _ in lines), tuple(delay for _, delay in lines))


def _line(time: Array, position: Array) -> tuple[float, float]:
    """Slope of the steady part, and when its line leaves the position of the start: dead time and lag together."""
    there = np.isfinite(position)
    time, position = time[there] - time[0], position[there]
    steady = time > STEADY
    speed, at_zero = np.polyfit(time[steady], position[steady], 1)
    return float(speed), float((position[0] - at_zero) / speed)


def stroke_error(recordings: list[Recording], plants: tuple[Plant, ...], signal: str) -> list[float]:
    """RMSE of the free run of each plant over all recordings [m]."""
    errors = []
    for plant in plants:
        residual = np.concatenate([free_run(plant, r)[signal].to_numpy() - r.values(signal) for r in recordings])
        errors.append(float(np.sqrt(np.nanmean(residual**2))))
    return errors


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder with manual_ol_1006_1648.csv and the steps_*.csv")
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
