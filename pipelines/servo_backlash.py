"""Servo backlash stand: what a pull moves, what the servo's own duty says of it, and what the gap says.

    .venv/bin/python pipelines/servo_backlash.py FOLDER_WITH_THE_LOGS          (source: datasets/servo_backlash/README.md)

A servo holds one setpoint while rubber bands pull its lever to either side. The stand calls the distance between the places to
which the lever returns backlash. The servo's duty grows with its error: where it stands still under a duty, friction holds it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import ingest
from sysid.gap import GapResult, find_gap
from sysid.reports import write_report
from sysid.workspace import open_workspace

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

CONTENT = Path(__file__).resolve().parents[1] / "datasets" / "servo_backlash"
#: Setpoint between the pulls, and one count [degrees].
HOME, COUNT = 2047.0, 360.0 / 4096.0
#: A pulling servo stretches its band within this distance of its far end, and leaves it slack this near to its rest [counts].
STRETCHED, SLACK = 100.0, 4.0
#: Rows of 0.1 s for which nothing moves where a servo stands, and after which it has reached a new setpoint.
STILL, REACHED = 3, 10
#: Of a duty [‰] the bit of its sign.
SIGN = 1024


@dataclass(frozen=True)
class Log:
    """Tested servo and the two that pull it; published deviations between both pulls, bands stretched and slack [counts]."""

    servo: int
    pulling: tuple[int, int]
    published: tuple[float | None, float | None]


LOGS = {
    "single": Log(5, (3, 4), (14.78, 7.03)),
    "single_3250": Log(4, (1, 2), (4.0, 1.26)),
    "nocomp2": Log(1, (3, 4), (7.0, 5.33)),
    "comp2": Log(1, (3, 4), (0.0, 0.0)),
    "pgain_zero_db": Log(1, (3, 4), (None, None)),
}


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the logs in ``raw`` and return the path of ``<workspace>/servo_backlash/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "servo_backlash"
    station = PipelineProgress(out)
    gaps: dict[str, GapResult] = {}
    pages: dict[str, Path] = {}
    for name in LOGS:
        with station(f"gap, {name}") as progress:
            path, recipe = raw / f"{name}.csv", CONTENT / "recipe.toml"
            dataset = ingest(path, workspace, recipe=recipe, name=f"backlash-{name.replace('_', '-')}", progress=progress)
            gaps[name] = find_gap(dataset, place.plant(dataset), place.models, progress=progress)
            place.keep_gap(dataset, gaps[name])
        pages[name] = write_report(folder / f"report-{name}.html", place.report_inputs(dataset))
        show_gap(out, gaps[name], dataset)

    found, rows = dict[str, dict[str, float]](), []
    for name, log in LOGS.items():
        table = pd.read_csv(raw / f"{name}.csv")
        f = found[name] = deviations(table, log) | duties(table, log)
        stated = ["–" if counts is None else f"{counts:.2f}" for counts in log.published]
        values = (f"{f['stretched']:.2f}", stated[0], f"{f['slack']:.2f}", stated[1], f"{COUNT * f['slack']:.2f}°")
        rows.append((name, *values, f"{f['slope']:.1f} ‰", f"{f['duty']:.0f} ‰", f"{f['held']:.0f} ‰"))
    out.line("Between the places after pulls to either side [counts]; duty under which the servo stands still with slack bands")
    header = ("log", "stretched", "published", "slack", "published", "", "duty a count", "mean", "largest")
    out.table(header, rows, right=range(1, len(header)))
    result: dict[str, Any] = {"schema": 1, "runs": {name: gap.to_json() for name, gap in gaps.items()}, "found": found}
    result |= {"published": {name: log.published for name, log in LOGS.items()}, "seconds": station.seconds, "files": pages}
    write_json(folder / "result.json", result)
    out.block("".join(f"Report   {page}\n" for page in pages.values()) + f"Figures  {folder / 'result.json'}")
    return folder / "result.json"


def bands(log: pd.DataFrame, of: Log) -> tuple[dict[int, Bools], Bools]:
    """Rows in which each servo stretches its band while the tested one is to hold its setpoint, and in which both are slack."""
    at_home = (log[f"target pos ({of.servo})"] == HOME).to_numpy()
    pulls, slack = dict[int, Bools](), at_home.copy()
    for k in of.pulling:
        goal, place = (log[f"{key} ({k})"].to_numpy(float) for key in ("target pos", "pos"))
        rest = float(pd.Series(goal).mode()[0])
        far = goal[goal != rest][0]
        pulls[k] = at_home & (goal == far) & (np.abs(place - far) <= STRETCHED)
        slack &= (goal == rest) & (np.abs(place - rest) <= SLACK)
    return pulls, slack


def deviations(log: pd.DataFrame, of: Log) -> dict[str, float]:
    """Mean angle with a band stretched, and slack after it, of one pull minus the other [counts]; mean duty of that [‰]."""
    pulls, slack = bands(log, of)
    angle, duty = log[f"pos ({of.servo})"].to_numpy(float), duty_of(log, of)
    means, resting = dict[str, list[float]](), list[Array]()
    for stretched in pulls.values():
        after, rows = np.zeros(len(angle), dtype=bool), np.flatnonzero(stretched)
        for last in rows[np.append(np.diff(rows) > 1, True)]:
            begin = next((row for row in range(last + 1, len(angle)) if slack[row]), len(angle))
            end = next((row for row in range(begin, len(angle)) if not slack[row]), len(angle))
            after[begin:end] = True
        means.setdefault("stretched", []).append(float(np.nanmean(angle[stretched])))
        means.setdefault("slack", []).append(float(np.nanmean(angle[after])))
        resting.append(np.abs(duty[after]))
    return {key: abs(one - other) for key, (one, other) in means.items()} | {"duty": float(np.nanmean(np.concatenate(resting)))}


def duty_of(log: pd.DataFrame, of: Log) -> Array:
    """Duty of the tested servo with its sign [‰]."""
    load = log[f"load ({of.servo})"].to_numpy(float)
    return np.where(load >= SIGN, SIGN - load, load)


def duties(log: pd.DataFrame, of: Log) -> dict[str, float]:
    """Duty a count of error, and the largest duty under which the servo stands at its setpoint with both bands slack [‰]."""
    duty, error = np.abs(duty_of(log, of)), log[f"pos ({of.servo})"].to_numpy(float) - HOME
    at_home = (log[f"target pos ({of.servo})"] == HOME).to_numpy()
    stands = np.array(
        [
            k >= REACHED and bool(at_home[k - REACHED : k + 1].all()) and np.ptp(error[k - STILL : k + 1]) == 0.0
            for k in range(len(error))
        ]
    )
    _, slack = bands(log, of)
    pushing = stands & (duty > 0.0)
    slope, _ = np.polyfit(np.abs(error[pushing]), duty[pushing], 1)
    return {"slope": float(slope), "held": float(duty[stands & slack].max())}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
