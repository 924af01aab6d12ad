"""Effect of each part of the cylinder controller: `python pipelines/control.py` after `make demo`.

Inverse kinematics follows the default helix through controllers with more and more parts: proportional, tuned by hand, then
with the inverse of the valve, speed feed-forward, backlash compensation, an integral, and a look-ahead; and tuned from the
plant before its repair. Writes `reports/control/result.json`, the table and the pictures of `reports/training/README.md`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from committed import markdown, provenance, write_result, write_tables
from sysid.pictures import PictureCurve, svg
from sysid.plant import plant_from_files
from sysid.registry import Registry
from sysid_rl.control import AxisTuning, proportional_tuning, tune
from sysid_rl.train.tracking import InversePolicy, TrackingResult, track, track_environment
from sysid_rl.train.tracking_task import TrackingTask, plan_tracking
from sysid_rl.train.versions import load_versions

ROOT = Path(__file__).resolve().parents[1]
COMMAND = "python pipelines/control.py"
Tuning = tuple[AxisTuning, ...]


def stages(task: TrackingTask, before: Tuning) -> list[tuple[str, Tuning, float]]:
    """Name, tuning and look-ahead of each row, each with one thing more than the one above it."""
    full, plain = task.tuning, proportional_tuning(task.plant)
    inverse = tuple(
        replace(item, proportional=poor.proportional, integral=0.0, feed=0.0, backlash=0.0)
        for item, poor in zip(full, plain, strict=True)
    )
    gains = tuple(replace(item, proportional=good.proportional) for item, good in zip(inverse, full, strict=True))
    fed = tuple(replace(item, feed=1.0) for item in gains)
    compensated = tuple(replace(item, backlash=good.backlash) for item, good in zip(fed, full, strict=True))
    return [
        ("proportional, 2/s, on the bare valve", plain, 0.0),
        ("+ inverse of the valve", inverse, 0.0),
        ("+ gain from the dead time", gains, 0.0),
        ("+ speed fed forward", fed, 0.0),
        ("+ backlash compensation", compensated, 0.0),
        ("+ integral: the tuned controller", full, 0.0),
        ("+ look-ahead by the dead time", full, task.dead_time),
        ("tuned controller of the simulation before the gap was named", before, 0.0),
    ]


def follow(task: TrackingTask, name: str, tuning: Tuning, lookahead: float, noise: bool) -> TrackingResult:
    settings = {"tuning": tuning, "preview": lookahead, "noise": noise}
    place = track_environment(task.plant, task.forward, task.path, full=True, reach=task.reach, settings=settings)
    return track(place, InversePolicy(task.inverse), task.path, task.start, lookahead=lookahead, name=name)


def main(workspace: Path, plant: str, before: str, forward: str) -> None:
    registry = Registry(workspace)
    machine, model = load_versions(registry, plant, forward)
    task = plan_tracking(machine, model, "helix", full=True)
    old = registry.load(before)
    rows, runs = [], {}
    for name, tuning, lookahead in stages(task, tune(plant_from_files(old.files, old.reference))):
        run = follow(task, name, tuning, lookahead, noise=True)
        runs[name] = run
        rows.append({**run.to_json(), "quiet": follow(task, name, tuning, lookahead, noise=False).to_json()})
        print(f"{name:<62} {shown(rows[-1]['settled']['rmse_mm'])}")
    names = list(runs)
    pictures(task, runs[names[0]], runs[names[5]], runs[names[6]])
    result = {
        **provenance(COMMAND, 0),
        "plant": machine.reference,
        "before": old.reference,
        "forward": registry.find(forward).reference,
        "path": {"name": "helix", "begin": task.path.points[0].tolist(), "speed": task.path.speed},
        "tuning": {
            axis: {
                "lead_s": t.dead_time,
                "proportional": t.proportional,
                "integral": t.integral,
                "deadband": [t.positive, t.negative],
            }
            for axis, t in zip(machine.machine.axis_names, task.tuning, strict=True)
        },
        "rows": rows,
    }
    write_result(ROOT / "reports" / "control" / "result.json", result)
    write_tables(ROOT / "reports" / "training" / "README.md", page(rows), "pipelines/control.py")


def page(rows: Sequence[dict[str, Any]]) -> str:
    head = ("controller", "RMSE x / y / z, mm", "max x / y / z, mm", "RMSE with perfect sensors")
    lines = [
        (
            row["policy"],
            *(shown(row["settled"][key]) for key in ("rmse_mm", "max_mm")),
            shown(row["quiet"]["settled"]["rmse_mm"]),
        )
        for row in rows
    ]
    return markdown(head, lines, "llll")


def shown(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}" if value < 10.0 else f"{value:.0f}" for value in values)


def pictures(task: TrackingTask, poor: TrackingResult, tuned: TrackingResult, ahead: TrackingResult) -> None:
    folder = ROOT / "docs" / "images"
    colours = {"by hand": "#c2410c", "tuned": "#0f766e", "look-ahead": "#4338ca"}
    runs = dict(zip(colours, (poor, tuned, ahead), strict=True))
    target = PictureCurve("target", poor.target[:, 0], poor.target[:, 1], "#9ca3af", dashed=True)
    lines = [target, *(PictureCurve(name, run.ee[:, 0], run.ee[:, 1], colours[name]) for name, run in list(runs.items())[:2])]
    text = svg("helix from above, with a controller tuned by hand and from the plant", "x [m]", "y [m]", lines, equal=True)
    (folder / "control-path.svg").write_text(text, "utf-8")
    curves = [
        PictureCurve(n, run.time, 1e3 * np.linalg.norm(run.error, axis=1), colours[n]) for n, run in list(runs.items())[1:]
    ]
    text = svg("distance from the target over time", "time [s]", "distance [mm]", curves)
    (folder / "control-error.svg").write_text(text, "utf-8")
    boom = task.plant.machine.axis_names.index("boom") if "boom" in task.plant.machine.axis_names else 0
    degrees = [PictureCurve("setpoint", tuned.time, np.degrees(tuned.actions[:, boom]), "#9ca3af", dashed=True)]
    degrees += [PictureCurve(n, run.time, np.degrees(run.joints[:, boom]), colours[n]) for n, run in list(runs.items())[:2]]
    text = svg("boom on the helix", "time [s]", "boom [°]", degrees)
    (folder / "control-boom.svg").write_text(text, "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    parser.add_argument("--plant", default="autolog@2", help="the machine: the repaired plant that `make demo` registers")
    parser.add_argument("--before", default="autolog@1", help="what the simulation was before its gap was named")
    parser.add_argument("--forward", default="autolog-forward")
    chosen = parser.parse_args()
    main(chosen.workspace, chosen.plant, chosen.before, chosen.forward)
