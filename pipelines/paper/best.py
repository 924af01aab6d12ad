"""The toolkit's best for every figure that the paper states, each with its command and processor time.

The forward model calibrates the URDF on the same 500 poses, the policies have the recipe rl/autolog/quick.toml, and the machine
is controlled by inverse kinematics from the plant that `sysid gap` has repaired with the logs of manual operation.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from loop.deployment import Deployment
from loop.flight import fly
from loop.rounds import path_task
from paper.policies import track_helix
from simulated_bench.recipe_file import load_recipe
from sysid.datasets import Dataset
from sysid.gap import find_gap
from sysid.networks import ForwardRecipe, NetworkRecipe, fit_forward
from sysid.signals import point_signals
from sysid.validate import validate_model
from sysid.workspace import Workspace
from sysid_rl.train.recipe import load_training
from sysid_rl.train.training import train_policy

RECIPE = Path(__file__).resolve().parents[2] / "rl" / "autolog" / "quick.toml"
T = TypeVar("T")


@dataclass(frozen=True)
class Best:
    """Values of a row, the command that makes them, and its processor time [s]."""

    values: tuple[float, ...]
    command: str
    seconds: float


def best_of(place: Workspace, dataset: Dataset, site: Path, plant: str, work: Path, seed: int) -> dict[str, Best]:
    """Quantity of the table → the toolkit's best; ``site``: the machine's description and bench; ``plant``: the nominal one."""
    recipe = NetworkRecipe(forward=ForwardRecipe(model="structured"))
    model, fitting = timed(lambda: fit_forward(dataset, recipe))
    report = validate_model(model, dataset, recipe=recipe)
    forward = place.add_network(dataset, model, recipe, report).reference
    largest = tuple(1e3 * report.output(signal, "poses").metrics.max for signal in point_signals("ee"))
    command = 'sysid fit forward autolog, model = "structured"'
    found = {"forward network, max x / y / z": Best(largest, command, fitting)}
    for number, feedback in ((1, True), (2, False)):
        training = load_training(RECIPE)
        training = replace(training, name=f"best-{number}", plant=plant, forward=forward, seed=seed)
        if not feedback:
            training = replace(training, exploration=replace(training.exploration, candidates=1))
        trained, taken = timed(lambda training=training: train_policy(place.models, training, work / "training"))  # type: ignore[misc]
        helix = track_helix(place, plant, forward, trained.version.reference, f"best-{number}")
        command = "sysid train rl/autolog/quick.toml" + ("" if feedback else ", candidates = 1")
        for what, values in (("RMSE", helix.rmse), ("max", helix.worst)):
            row = f"policy {number} on the helix, {what} x / y / z"
            found[row] = Best(tuple(float(1e3 * value) for value in values), command, taken)
    gap, searching = timed(lambda: find_gap(dataset, place.plant(dataset), place.models, add=True))
    deployment, task = Deployment(gap.plant_after, forward), path_task("helix")
    flight = fly(load_recipe(site / "bench.toml"), site, work / "flights", place.models, deployment, task, 100 * seed)
    values = tuple(float(value) for value in flight.figures()["max_mm"])
    command = 'sysid gap autolog --add; policy = "ik-lookahead"'
    found["policy 1 on the helix, max x / y / z at the tool"] = Best(values, command, searching)
    return found


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """A result and the processor time that it took [s]."""
    begin = time.process_time()
    return work(), time.process_time() - begin
