"""Tasks beyond inverse kinematics, with classical controllers and trained policies in one table.

.venv/bin/python pipelines/learning_tasks.py [--workspace DIR] [--moves N] [--seeds N] [--parts PART …]

Makes what is not there yet: the versions of `make demo` by pipelines/first_look.py, and the policies of rl/autolog/tool.toml
(two minutes of a core each). Writes result.json and the tables of reports/learning_tasks/; with other
numbers of moves or seeds than the published ones only into the workspace.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).resolve().parent))

import first_look
from committed import provenance, write_result, write_tables
from sysid.networks.policy import PolicyNetwork
from sysid.registry import Registry
from sysid.registry.policy import load_policy
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.train.paths import circle
from sysid_rl.train.recipe import load_training
from sysid_rl.train.tracking_task import TrackingTask, plan_tracking
from sysid_rl.train.training import train_policy
from sysid_rl.train.versions import load_versions
from task_runs import page, peer, pump, redundancy, sway

ROOT = Path(__file__).resolve().parents[1]
REPORT = ROOT / "reports" / "learning_tasks"
PAGE = REPORT / "README.md"
RECIPE = ROOT / "rl" / "autolog" / "tool.toml"
PLANT, FORWARD = "autolog@2", "autolog-forward@1"
#: Seeds of the trained policies.
SEEDS = 3
PARTS = ("paths", "targets", "swing", "pump", "redundancy")
Array = npt.NDArray[np.float64]


def main(workspace: Path, count: int = sway.MOVES, seeds: int = SEEDS, parts: Sequence[str] = PARTS) -> Path:
    """Train what is not there, run the parts and write the result; the other parts stay as they were."""
    registry = with_versions(workspace)
    plant, forward = load_versions(registry, PLANT, FORWARD)
    task = plan_tracking(plant, forward, "helix", full=True)
    published = (count, seeds) == (sway.MOVES, SEEDS)
    report = REPORT if published else workspace / "learning_tasks"
    old = json.loads((report / "result.json").read_text("utf-8")) if (report / "result.json").exists() else {}
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
        **{part: old[part] for part in PARTS if part in old},
    }
    networks: list[PolicyNetwork] = []
    if {"paths", "targets", "swing"} & set(parts):
        networks, cpu_s = policies(registry, workspace, seeds)
        result["trained"] = {"recipe": f"rl/autolog/{RECIPE.name}", "seeds": seeds, "cpu_seconds": cpu_s}
        sac = peer.trained(load_training(RECIPE), plant, forward, networks[0], cpu_s) if published else None
        trained = Trained(networks, sac)
        if sac is not None:
            result["peer"] = {"algorithm": "SAC of Stable-Baselines3", "steps": sac.steps, "cpu_seconds": cpu_s}
    else:
        result |= {key: old[key] for key in ("trained", "peer") if key in old}
    for part in parts:
        print(part, flush=True)
        match part:
            case "paths":
                result[part] = paths(task, trained)
            case "targets":
                result[part] = targets(task, trained, sway.moves(task, count))
            case "swing":
                result[part] = sway.swing_rows(
                    task, [*sway.in_place(task), *trained.measured(task)], sway.moves(task, count, sway.SWING_SEED)
                )
            case "pump":
                result[part] = pump.rows(pump.with_pump(task), sway.moves(task, count))
            case "redundancy":
                result[part] = redundancy.rows(task, redundancy.circles(task, count))
    write_result(report / "result.json", result)
    if published:
        for name, text in page.tables(result).items():
            write_tables(PAGE, text, f"pipelines/learning_tasks.py: {name}")
    return report


def with_versions(workspace: Path) -> Registry:
    """The registry with plant and forward model of the shipped crane; the first-look pipeline makes them."""
    registry = Registry(workspace)
    if not {PLANT, FORWARD} <= {version.reference for version in registry.list()}:
        first_look.main(workspace)
    return registry


@dataclass(frozen=True)
class Trained:
    """Policies of the recipe, one for each seed, and that of the peer, if it was trained."""

    networks: list[PolicyNetwork]
    peer: peer.PeerNetwork | None

    def measured(self, task: TrackingTask) -> list[sway.Controller]:
        """With a measured swing."""
        own = [sway.trained(task, self.networks)]
        return own if self.peer is None else [*own, sway.trained(task, [self.peer], name="SAC")]


def paths(task: TrackingTask, trained: Trained) -> list[dict[str, Any]]:
    """Helix and circle, without and with speed ramps."""
    level = circle(0.5 * (task.path.points.min(axis=0) + task.path.points.max(axis=0)), task.path.rate_hz)
    return [
        row
        for ease_s in sway.EASES
        for path in (task.path, level)
        for controller in [*sway.on_paths(task), *trained.measured(task)[:1]]
        if ease_s or "inverse" not in controller.name  # it needs a path without jumps of the speed
        for row in sway.path_rows(task, controller, path, ease_s)
    ]


def targets(task: TrackingTask, trained: Trained, each: Sequence[tuple[Array, Array]]) -> list[dict[str, Any]]:
    """Random moves; fewer with a pendulum that is not the identified one."""
    estimated = sway.trained(task, trained.networks[:1], measured=False)
    shaped = [each for each in sway.at_targets(task) if "shaper" in each.name and "least" not in each.name]
    rows = sway.move_rows(task, [*sway.at_targets(task), *trained.measured(task)], each)
    for length in sway.LENGTHS:
        rows += sway.move_rows(task, [*shaped, *trained.measured(task)[:1], estimated], each[: sway.FEWER_MOVES], length)
    return rows


def policies(registry: Registry, workspace: Path, seeds: int) -> tuple[list[PolicyNetwork], float]:
    """Policies of the recipe, one for each seed, and the processor time of the first; registered ones are not trained again."""
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
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="the others stay as they were")
    given = parser.parse_args()
    print(main(given.workspace, given.moves, given.seeds, given.parts))
