"""Tasks beyond inverse kinematics, with classical controllers and trained policies in one table.

.venv/bin/python pipelines/learning_tasks.py [--workspace DIR] [--moves N] [--seeds N]

Needs the versions of `make demo`, and trains the policies of rl/autolog/tool.toml that are not there yet (two minutes of a
core each). Writes reports/learning_tasks/result.json and the tables of docs/learning-tasks.md; with other numbers of moves or
seeds than the published ones only into the workspace.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from committed import provenance, write_result, write_tables
from sysid.control.pendulum import pendulum_of
from sysid.networks.policy import PolicyNetwork
from sysid.registry import Registry
from sysid.rl.paths import circle
from sysid.rl.policy import load_policy
from sysid.rl.recipe import load_training
from sysid.rl.tracking_task import plan_tracking
from sysid.rl.training import train_policy
from sysid.rl.versions import load_versions
from task_runs import page, peer, pump, sway

ROOT = Path(__file__).resolve().parents[1]
REPORT, PAGE = ROOT / "reports" / "learning_tasks", ROOT / "docs" / "learning-tasks.md"
RECIPE = ROOT / "rl" / "autolog" / "tool.toml"
PLANT, FORWARD = "autolog@2", "autolog-forward@1"
#: Seeds of the trained policies.
SEEDS = 3


def main(workspace: Path, count: int = sway.MOVES, seeds: int = SEEDS) -> Path:
    """Train what is not there, run all tasks and write the result."""
    registry = Registry(workspace)
    plant, forward = load_versions(registry, PLANT, FORWARD)
    task = plan_tracking(plant, forward, "helix", full=True)
    networks, cpu_s = policies(registry, workspace, seeds)
    measured, estimated = sway.trained(task, networks), sway.trained(task, networks[:1], measured=False)
    sac = sway.trained(task, [peer.trained(load_training(RECIPE), plant, forward, networks[0], cpu_s)], name="SAC")
    level = circle(0.5 * (task.path.points.min(axis=0) + task.path.points.max(axis=0)), task.path.rate_hz)
    paths = [
        row
        for ease_s in sway.EASES
        for path in (task.path, level)
        for controller in [*sway.on_paths(task), measured]
        if ease_s or "inverse" not in controller.name  # it needs a path without jumps of the speed
        for row in sway.path_rows(task, controller, path, ease_s)
    ]
    each = sway.moves(task, count)
    off = [controller for controller in sway.at_targets(task) if "shaper" in controller.name and "least" not in controller.name]
    targets = sway.move_rows(task, [*sway.at_targets(task), measured, sac], each)
    for length in sway.LENGTHS:
        targets += sway.move_rows(task, [*off, measured, estimated], each[: sway.FEWER_MOVES], length)
    pendulum = pendulum_of(plant)
    result = {
        **provenance("python pipelines/learning_tasks.py", sway.SEED, ("torch", "stable-baselines3")),
        "plant": plant.reference,
        "forward": FORWARD,
        "pendulum": {
            "length_m": pendulum.length,
            "damping_ratio": pendulum.damping_ratio,
            "frequency_rad_s": pendulum.frequency,
            "period_s": pendulum.period,
        },
        "trained": {"recipe": f"rl/autolog/{RECIPE.name}", "seeds": len(networks), "cpu_seconds": cpu_s},
        "paths": paths,
        "targets": targets,
        "swing": sway.swing_rows(task, [*sway.in_place(task), measured, sac], sway.moves(task, count, sway.SWING_SEED)),
        "pump": pump.rows(pump.with_pump(task), each),
    }
    report = REPORT if (count, seeds) == (sway.MOVES, SEEDS) else workspace / "learning_tasks"
    write_result(report / "result.json", result)
    if report == REPORT:
        for name, text in page.tables(result).items():
            write_tables(PAGE, text, f"pipelines/learning_tasks.py: {name}")
    return report


def policies(registry: Registry, workspace: Path, seeds: int) -> tuple[list[PolicyNetwork], float]:
    """The policies of the recipe, one for each seed, and the processor time of the first; registered ones are not trained again."""
    recipe = load_training(RECIPE)
    found, seconds = [], []
    for seed in range(seeds):
        trained = train_policy(registry, replace(recipe, seed=seed), workspace / "training")
        found.append(load_policy(registry.load(trained.version.reference)))
        seconds.append(float(trained.version.metrics["cpu_seconds"]))
    return found, seconds[0]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workspace", type=Path, default=ROOT / "workspace")
    parser.add_argument("--moves", type=int, default=sway.MOVES, help="random moves to a target")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="trained policies")
    given = parser.parse_args()
    print(main(given.workspace, given.moves, given.seeds))
