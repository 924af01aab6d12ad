"""Tasks beyond inverse kinematics, with classical controllers and trained policies in one table.

.venv/bin/python pipelines/learning_tasks.py [--workspace DIR] [--moves N]

Needs the versions of `make demo`. Writes reports/learning_tasks/result.json and the tables of docs/learning-tasks.md; with
another number of moves than the published one only into the workspace.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from committed import markdown, provenance, write_result, write_tables
from sysid.control.pendulum import pendulum_of
from sysid.registry import Registry
from sysid.rl.paths import circle
from sysid.rl.tracking_task import plan_tracking
from sysid.rl.versions import load_versions
from task_runs import sway

ROOT = Path(__file__).resolve().parents[1]
REPORT, PAGE = ROOT / "reports" / "learning_tasks", ROOT / "docs" / "learning-tasks.md"
PLANT, FORWARD = "autolog@2", "autolog-forward@1"


def main(workspace: Path, count: int = sway.MOVES) -> Path:
    """Run all tasks and write the result."""
    plant, forward = load_versions(Registry(workspace), PLANT, FORWARD)
    task = plan_tracking(plant, forward, "helix", full=True)
    pendulum = pendulum_of(plant)
    level = circle(0.5 * (task.path.points.min(axis=0) + task.path.points.max(axis=0)), task.path.rate_hz)
    paths = [
        sway.path_row(task, controller, path, ease_s)
        for ease_s in sway.EASES
        for path in (task.path, level)
        for controller in sway.on_paths(task)
        if ease_s or "inverse" not in controller.name  # it needs a path without jumps of the speed
    ]
    each = sway.moves(task, count)
    targets = [row for length in sway.LENGTHS for row in sway.move_rows(task, sway.at_targets(task), each, length)]
    result = {
        **provenance("python pipelines/learning_tasks.py", sway.SEED),
        "plant": plant.reference,
        "forward": FORWARD,
        "pendulum": {
            "length_m": pendulum.length,
            "damping_ratio": pendulum.damping_ratio,
            "frequency_rad_s": pendulum.frequency,
            "period_s": pendulum.period,
        },
        "paths": paths,
        "targets": targets,
    }
    report = REPORT if count == sway.MOVES else workspace / "learning_tasks"
    write_result(report / "result.json", result)
    if report == REPORT:
        write_tables(PAGE, page(result), "pipelines/learning_tasks.py")
    return report


def page(result: dict[str, Any]) -> str:
    return f"{paths_table(result['paths'])}\n\n{targets_table(result['targets'])}"


def paths_table(rows: Sequence[dict[str, Any]]) -> str:
    errors = "RMSE x / y / z, mm", "max x / y / z, mm"
    head = ("path, speed ramps", "controller", *errors, "residual swing, mm", "tool settles, s")
    lines = [
        (
            f"{row['path']}, " + (f"{row['ease_s']:g} s" if row["ease_s"] else "none"),
            row["controller"],
            shown(row["rmse_mm"]),
            shown(row["max_mm"]),
            number(row["swing_mm"], 1),
            number(row["settling_s"]),
        )
        for row in rows
    ]
    return markdown(head, lines, "llll")


def targets_table(rows: Sequence[dict[str, Any]]) -> str:
    head = ("pendulum of the machine", "controller", "tip arrives, s", "tool settles, s", "residual swing, mm", "not settled")
    lines = []
    for row in rows:
        moves = row["moves"]
        never = sum(move["settling_s"] is None for move in moves)
        lines.append(
            (
                "as identified" if row["length"] == 1.0 else f"{100.0 * (row['length'] - 1.0):+.0f} % in length",
                row["controller"],
                spread([move["arrival_s"] for move in moves]),
                spread([move["settling_s"] for move in moves]),
                spread([move["swing_mm"] for move in moves], 1),
                f"{never} of {len(moves)}",
            )
        )
    return markdown(head, lines, "ll")


def spread(values: Sequence[float | None], digits: int = 2) -> str:
    """Median and greatest; what never happened counts as infinite."""
    known = sorted(math.inf if value is None else value for value in values)
    return "; ".join(number(value if value < math.inf else None, digits) for value in (statistics.median(known), known[-1]))


def number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def shown(values: Sequence[float]) -> str:
    return " / ".join(number(value, 1) for value in values)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workspace", type=Path, default=ROOT / "workspace")
    parser.add_argument("--moves", type=int, default=sway.MOVES, help="random moves to a target")
    given = parser.parse_args()
    print(main(given.workspace, given.moves))
