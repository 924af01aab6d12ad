"""Actuator networks on the shipped logs: both axes and directions, by number of rows, compared with simpler models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from learned.forward import longer
from learned.poses import crane
from simulated_bench.cylinder import drive_of, joint_of, position_of
from sysid.datasets import Dataset
from sysid.networks import Checkpoints, EnsembleMember, NetworkRecipe, train
from sysid.networks.actuator import actuator_rows
from sysid.networks.mlp import Rectifier
from sysid.networks.recipe import PAPER_ACTUATOR_TRAINING, parse_recipe
from sysid.networks.split import gather, segments, thin
from sysid.validate.baselines import Predict, baseline_models, linkage_geometry

Array = npt.NDArray[np.float64]

AXES, DIRECTIONS = ("boom", "stick"), ("to_joint", "to_cylinder")
RECTIFIERS: tuple[Rectifier, ...] = ("relu", "smooth")
SEEDS, SIZES = (0, 1), (25, 50, 100, 200, 400, 1500)
#: Points over the true stroke.
POINTS = 2001


@dataclass(frozen=True)
class Task:
    """One direction of one axis, for a seed: rows to learn from and to stop by, (n, 1) each."""

    axis: str
    direction: str
    seed: int
    x: Array
    y: Array
    x_stop: Array
    y_stop: Array

    @property
    def name(self) -> str:
        return f"{self.axis} {self.direction} {self.seed}"


def tasks(dataset: Dataset, size: int) -> list[Task]:
    found = []
    for seed in SEEDS:
        recipe = parse_recipe({"seed": seed, "actuator": {"samples": size}}, "study")
        for axis in AXES:
            fit, stop = actuator_rows(dataset, axis, recipe)
            stop = thin(stop, max(10, size // 5))
            for direction in DIRECTIONS:
                source = DIRECTIONS.index(direction)
                columns = [rows.values[:, [column]] for rows in (fit, stop) for column in (source, 1 - source)]
                found.append(Task(axis, direction, seed, *columns))
    return found


def curve(dataset: Dataset, checkpoints: Checkpoints | None = None) -> list[dict[str, Any]]:
    """Errors over the number of rows: in held-out motion against what was measured, and over the stroke against the linkage."""
    rows: list[dict[str, Any]] = []
    for size in SIZES:
        every = tasks(dataset, size)
        models = networks(every, size, checkpoints)
        for task in every:
            models[task.name] |= baseline_models(task.x, task.y[:, 0])
            to_joint = task.direction == "to_joint"
            cylinder, joint = (task.x, task.y) if to_joint else (task.y, task.x)
            models[task.name]["linkage geometry"] = linkage_geometry(cylinder[:, 0], joint[:, 0], to_joint)
        for axis in AXES:
            for direction in DIRECTIONS:
                own = [task.name for task in every if (task.axis, task.direction) == (axis, direction)]
                for model in models[own[0]]:
                    errors = figures(dataset, axis, direction, [models[name][model] for name in own])
                    rows.append({"axis": axis, "direction": direction, "rows": size, "model": model, **errors})
    return rows


def networks(every: list[Task], size: int, checkpoints: Checkpoints | None = None) -> dict[str, dict[str, Predict]]:
    """The paper's layers, with both rectifiers, all in one training."""
    recipe = NetworkRecipe().actuator
    members = [
        EnsembleMember(
            f"{task.name} {rectifier}", task.x, task.y, task.x_stop, task.y_stop, ("input",), ("output",),
            recipe.layers(task.axis), rectifier=rectifier,
        )
        for task in every
        for rectifier in RECTIFIERS
    ]  # fmt: skip
    trained = iter(train(members, recipe.hidden, longer(PAPER_ACTUATOR_TRAINING, SIZES[-1] / size), 0, checkpoints=checkpoints))
    found: dict[str, dict[str, Predict]] = {}
    for task in every:
        found[task.name] = {f"network, {rectifier}": _column(next(trained).mlp.predict) for rectifier in RECTIFIERS}
    return found


def _column(predict: Predict) -> Predict:
    return lambda x: predict(x)[:, 0]


def figures(dataset: Dataset, axis: str, direction: str, models: list[Predict]) -> dict[str, Any]:
    """Errors [rad or m], mean over the seeds: ``motion`` against measured values, ``stroke`` against the true linkage."""
    source = DIRECTIONS.index(direction)
    signals = (f"{axis}.cylinder", f"{axis}.joint")
    held = gather(segments(dataset, "held_out", signals), signals)
    measured, truth = held.values, true_linkage(axis)
    x, y = truth[:, source], truth[:, 1 - source]
    found: dict[str, Any] = {}
    for name, inputs, outputs in (("motion", measured[:, source], measured[:, 1 - source]), ("stroke", x, y)):
        errors = np.abs([predict(inputs[:, None]) - outputs for predict in models])
        found[f"{name}_rmse"] = float(np.sqrt(np.mean(errors**2, axis=1)).mean())
        found[f"{name}_p95"] = float(np.percentile(errors, 95, axis=1).mean())
        found[f"{name}_max"] = float(errors.max(axis=1).mean())
    slope = np.interp(measured[:, source], *_sorted(x, np.gradient(y, x)))
    noise = [dataset.machine.noise[signal] for signal in (signals[source], signals[1 - source])]
    found["sensors"] = float(np.sqrt(np.mean((slope * noise[0]) ** 2) + noise[1] ** 2))
    return found


def true_linkage(axis: str) -> Array:
    """Cylinder and joint over the stroke, (m, 2), from the bench crane's own geometry; evenly over the joint's range."""
    settings = crane().axis(axis)
    drive = drive_of(settings)
    ends = sorted(joint_of(position, drive) for position in (drive.low, drive.high))
    joints = np.linspace(*ends, POINTS)
    return np.column_stack([[position_of(joint, drive) for joint in joints], joints])


def _sorted(x: Array, y: Array) -> tuple[Array, Array]:
    order = np.argsort(x)
    return x[order], y[order]
