"""Files of a tracking run: a table of all steps, pictures as in the paper, a Rerun recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.files import written_whole
from sysid.machine import Machine
from sysid.pictures import PictureCurve, svg
from sysid.signals import point_signals
from sysid_rl.train.tracking import TrackingResult

Array = npt.NDArray[np.float64]

#: Runs in one picture.
DRAWN = 3
_COLOURS = ("#0f766e", "#c2410c", "#4338ca")


def table(machine: Machine, run: TrackingResult) -> pd.DataFrame:
    """One row for each step: time, target, end effector, joints, setpoints; commands and tool if known."""
    columns: dict[str, Array] = {"time": run.time}
    for name, values in (("target", run.target), ("ee", run.ee), ("tool", run.tool)):
        if np.isfinite(values).any():
            columns |= dict(zip(point_signals(name), values.T, strict=True))
    for kind, values in (("joint", run.joints), ("setpoint", run.actions), ("command", run.commands)):
        if np.isfinite(values).any():
            columns |= {f"{axis}.{kind}": column for axis, column in zip(machine.axis_names, values.T, strict=True)}
    return pd.DataFrame(columns)


def pictures(runs: Sequence[TrackingResult]) -> dict[str, str]:
    """File name → SVG: path and the first :data:`DRAWN` runs from above and from the side, and the errors of each over time."""
    first = runs[0]
    found = {}
    for name, (a, b) in {"from-above": (0, 1), "from-the-side": (0, 2)}.items():
        lines = [PictureCurve("target", first.target[:, a], first.target[:, b], "#9ca3af", dashed=True)]
        lines += [
            PictureCurve(run.policy, run.ee[:, a], run.ee[:, b], colour)
            for run, colour in zip(runs[:DRAWN], _COLOURS, strict=False)
        ]
        title, equal = f"{first.path} {name.replace('-', ' ')}", a + b == 1
        found[f"{name}.svg"] = svg(title, f"{'xyz'[a]} [m]", f"{'xyz'[b]} [m]", lines, equal)
    for run in runs:
        error = 1e3 * run.error
        lines = [PictureCurve(axis, run.time, error[:, k], _COLOURS[k]) for k, axis in enumerate("xyz")]
        found[f"error-{_file(run.policy)}.svg"] = svg(f"error of {run.policy}", "time [s]", "error [mm]", lines)
    return found


def write_results(folder: Path, machine: Machine, runs: Sequence[TrackingResult], rerun: bool = True) -> dict[str, Path]:
    """Write tables, pictures and the Rerun recording of the runs of one path.

    Returns:
        What → file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, Path] = {}
    tables = {run.policy: table(machine, run) for run in runs}
    for policy, rows in tables.items():
        files[f"steps of {policy}"] = folder / f"{_file(policy)}.csv"
        with written_whole(files[f"steps of {policy}"]) as half:
            rows.to_csv(half, index=False, float_format="%.7g")
    for name, text in pictures(runs).items():
        files[name.removesuffix(".svg").replace("-", " ")] = folder / name
        with written_whole(folder / name) as half:
            half.write_text(text, "utf-8")
    if rerun:
        from sysid_rl.train.rerun_tracks import write_tracks

        files["rerun"] = write_tracks(folder / "track.rrd", machine, runs[0].target, tables, f"{folder.name}")
    return files


def _file(policy: str) -> str:
    return policy.replace("@", "-").replace("/", "-")
