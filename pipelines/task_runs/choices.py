"""Ablation of the trainer on the hanging tool: each choice alone beside the recipe, over several seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sysid.config import read_toml
from sysid.cores import cores
from sysid.execution import LocalExecutor
from sysid.progress import Progress
from sysid.registry import Registry
from sysid.rl.policy import load_policy
from sysid.rl.recipe import TrainingRecipe, parse_training
from sysid.rl.tracking_task import plan_tracking
from sysid.rl.training import train_policy
from sysid.rl.versions import load_versions
from task_runs import sway

#: Name → what differs from the recipe, by table.
CHOICES: dict[str, Mapping[str, Mapping[str, Any]]] = {
    "as it is": {},
    "rewards of 3 steps before the bootstrap": {"learning": {"steps": 3}},
    "rewards of 5 steps before the bootstrap": {"learning": {"steps": 5}},
    "two critics, the lower target value": {"networks": {"critics": 2}},
    "critic with layer normalisation": {"networks": {"critic_normalised": True}},
    "targets that move away, half of the time": {"setting": {"curriculum": 0.5}},
}


def variant(recipe: Path, name: str, seed: int, plant: str, forward: str) -> TrainingRecipe:
    """The recipe with a choice, for versions of a plant and a forward model."""
    values = read_toml(recipe)
    for table, changed in CHOICES[name].items():
        values[table] = {**values[table], **changed}
    number = list(CHOICES).index(name)
    made = parse_training({**values, "name": f"{values['name']}-choice-{number}", "seed": seed}, name)
    return replace(made, plant=plant, forward=forward)


def one(
    workspace: str, run: tuple[str, int], recipe: str, plant: str, forward: str, count: int, progress: Progress
) -> dict[str, Any]:
    """Train one policy; figures of the random moves, and of a tool that swings."""
    registry, made = Registry(Path(workspace)), variant(Path(recipe), *run, plant, forward)
    trained = train_policy(registry, made, Path(workspace) / "training", progress)
    task = plan_tracking(*load_versions(registry, plant, forward), "helix", full=True)
    controller = sway.trained(task, [load_policy(registry.load(trained.version.reference))])
    (moved,) = sway.move_rows(task, [controller], sway.moves(task, count))
    (swung,) = sway.swing_rows(task, [controller], sway.moves(task, count, sway.SWING_SEED))
    cpu_s = float(trained.version.metrics["cpu_seconds"])
    return {"choice": run[0], "seed": run[1], "cpu_seconds": cpu_s, "moves": moved["moves"], "swing": swung["moves"]}


def rows(workspace: Path, recipe: Path, versions: tuple[str, str], seeds: int, count: int) -> list[dict[str, Any]]:
    """A row for each choice and seed, one process for each core; registered policies are not trained again."""
    calls = [(str(workspace), (name, seed), str(recipe), *versions, count) for seed in range(seeds) for name in CHOICES]
    found: list[dict[str, Any]] = LocalExecutor(cores()).run(one, calls, reports=True)
    return found
