"""From a recipe to a policy version: environment of the named versions, training that can be interrupted, registration."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.control import AxisTuning
from sysid.networks.forward import ForwardModel
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.policy import PolicyNetwork, policy_to_files
from sysid.plant import Plant
from sysid.progress import Progress, silent
from sysid.registry import ModelVersion, Registry
from sysid.rl.checkpoint import TrainingFiles, training_folder
from sysid.rl.ddpg import SETTLE, Trainer
from sysid.rl.environment import Environment
from sysid.rl.factory import make_environment
from sysid.rl.observers import Observer
from sysid.rl.reach import Reach
from sysid.rl.recipe import TrainingRecipe
from sysid.rl.task import Task
from sysid.rl.versions import load_versions

#: The actor is evaluated on so many copies, with the same starts and targets whatever the seed.
EVALUATION_COPIES, EVALUATION_SEED = 512, 2**31


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy that is done.

    Args:
        version: in the registry.
        figures: of the actor alone, at the end.
        seconds, cpu_seconds: of this process; what was done before an interruption is not in them.
        updates_per_second: over the same time; None where it had been trained before and nothing was left to do.
    """

    version: ModelVersion
    figures: Mapping[str, float]
    seconds: float
    cpu_seconds: float
    updates_per_second: float | None


def train_policy(
    registry: Registry,
    recipe: TrainingRecipe,
    root: Path,
    progress: Progress = silent,
    observers: Sequence[Observer] = (),
    every: float = 20.0,
) -> TrainedPolicy:
    """Train the policy of a recipe and register it as ``recipe.name``; goes on where it was interrupted, even by a kill.

    A policy of the same recipe, seed and versions that is registered already is returned as it is.

    Args:
        root: folder of checkpoints and of the replay buffer's files, one folder a training; removed when it is done.
        observers: told of every episode and evaluation.
        every: seconds between two checkpoints.

    Raises:
        StoreError: no such plant or forward model; a damaged checkpoint.
        SettingsError: plant and forward model do not fit each other; NaN in a network: the last checkpoint stays.
        StorageError: the disk is full: the last checkpoint stays.
    """
    plant, forward = registry.find(recipe.plant), registry.find(recipe.forward)
    lineage = {
        "plant": plant.reference,
        "plant_digest": plant.digest,
        "forward": forward.reference,
        "forward_digest": forward.digest,
        "recipe": recipe.to_json(),
    }
    for version in registry.versions(recipe.name):
        if version.kind == "policy" and version.lineage == _plain(lineage):
            return TrainedPolicy(version, dict(version.metrics), 0.0, 0.0, None)

    files = TrainingFiles(training_folder(root, recipe, {"plant": plant.digest, "forward": forward.digest}), every)
    trainer = Trainer(*environments(recipe, *load_versions(registry, plant.reference, forward.reference)), recipe)
    files.load(trainer)
    before, begin, begin_cpu = trainer.agent.updates, time.perf_counter(), time.process_time()
    with ExitStack() as stack:
        for observer in observers:
            stack.enter_context(observer.watching(recipe, files.folder, trainer))

        def told(kind: str, step: int, figures: Mapping[str, float]) -> None:
            for observer in observers:
                observer.told(kind, step, figures)

        for turn in trainer.train(told):
            if files.is_due:
                files.save(trainer)
            progress(turn / recipe.turns, _how(trainer))
    trainer.check()
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - begin_cpu
    figures = {key: value for key, value in trainer.evaluations[-1].items() if key not in ("step", "updates")}
    curves = {"episodes": trainer.episodes, "evaluations": trainer.evaluations}
    version = registry.register(
        recipe.name, "policy", policy_to_files(policy_of(trainer), curves), lineage, {**figures, "cpu_seconds": cpu_seconds}
    )
    files.remove()
    return TrainedPolicy(version, figures, seconds, cpu_seconds, (trainer.agent.updates - before) / max(seconds, 1e-9))


def environments(
    recipe: TrainingRecipe,
    plant: Plant,
    forward: ForwardModel,
    *,
    reach: Reach | None = None,
    tuning: tuple[AxisTuning, ...] | None = None,
    judged: int = EVALUATION_COPIES,
) -> tuple[Environment, Environment]:
    """What a policy is trained in, and what its actor alone is evaluated in.

    Args:
        reach: limits, starts and targets; else those of plant and forward model.
        tuning: of the cylinder controller, on the full path; else what the plant says.
        evaluated: copies of the evaluation environment, the same for every seed.

    Raises:
        SettingsError: plant and forward model do not fit each other.
    """
    setting = recipe.setting

    def environment(size: int, seed: int, task: Task, repeat: int) -> Environment:
        settings = {"tuning": tuning, "repeat": repeat, "feedback": setting.feedback} if setting.full else {}
        return make_environment(plant, forward, full=setting.full, size=size, seed=seed, task=task, reach=reach, **settings)

    return (
        environment(setting.copies, recipe.seed, setting.task, setting.repeat),
        environment(judged, EVALUATION_SEED, evaluation_task(setting.task), 1),
    )


def evaluation_task(task: Task) -> Task:
    """The same task, with one target and episodes that outlast an evaluation."""
    return replace(task, steps=max(task.steps, 2 * SETTLE + 1), targets=1)


def policy_of(trainer: Trainer) -> PolicyNetwork:
    """The actor as it is now, for use without torch."""
    space, forward = trainer.agent.space, trainer.environment.forward
    weights, biases = trainer.agent.layers()
    acts = len(space.action_low)
    same = Normalisation(np.zeros(acts), np.ones(acts))
    names = (*forward.joints, *(f"{what}.{axis}" for what in ("ee", "target") for axis in "xyz"))
    more = tuple(f"further.{number}" for number in range(len(space.low) - len(names)))
    return PolicyNetwork(
        inputs=(*names, *more),
        outputs=forward.joints,
        mlp=Mlp(weights, biases, Normalisation(space.centre, space.half), same),
        low=space.action_low,
        high=space.action_high,
        full=trainer.recipe.setting.full,
    )


def _how(trainer: Trainer) -> str:
    episode = trainer.episodes[-1]["return"] if trainer.episodes else float("nan")
    if not trainer.evaluations:
        return f"return {episode:.2f}"
    last = trainer.evaluations[-1]
    errors = "/".join(f"{1e3 * last[f'hold_rmse_{axis}']:.1f}" for axis in "xyz")
    return f"return {episode:.2f}, actor alone off by {errors} mm"


def _plain(value: Any) -> Any:
    """Tuples as the lists that JSON makes of them."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
