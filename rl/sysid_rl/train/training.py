"""From a recipe to a policy version: environments of the named versions, resumable training, registration."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.files import plain
from sysid.networks.forward import ForwardModel
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.policy import PolicyNetwork, policy_to_files
from sysid.plant import Plant
from sysid.progress import Progress, silent
from sysid.registry import ModelVersion, Registry
from sysid_rl.control import AxisTuning
from sysid_rl.train.checkpoint import TrainingFiles, training_folder
from sysid_rl.train.ddpg import SETTLE_STEPS, Trainer
from sysid_rl.train.environment import Environment
from sysid_rl.train.factory import make_environment
from sysid_rl.train.observers import Observer
from sysid_rl.train.reach import Reach
from sysid_rl.train.recipe import TrainingRecipe
from sysid_rl.train.task import Task
from sysid_rl.train.versions import load_versions

#: Copies and seed of the evaluation: starts and targets are the same for every seed of the training.
EVALUATION_COPIES, EVALUATION_SEED = 512, 2**31


@dataclass(frozen=True)
class TrainedPolicy:
    """A trained policy.

    Args:
        version: in the registry.
        figures: of the actor alone, at the end.
        seconds, cpu_seconds: of this process, without the time before an interruption.
        updates_per_second: over the same time; None if the policy was registered already.
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
    """Train the policy of a recipe and register it as ``recipe.name``; an interrupted training continues, even after a kill.

    If a policy of the same recipe, seed and versions is registered already, it is returned.

    Args:
        root: folder of checkpoints, one subfolder for each training, removed when it is done.
        observers: record every episode and evaluation.
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
        if version.kind == "policy" and version.lineage == plain(lineage):
            return TrainedPolicy(version, dict(version.metrics), 0.0, 0.0, None)

    files = TrainingFiles(training_folder(root, recipe, {"plant": plant.digest, "forward": forward.digest}), every)
    trainer = Trainer(*environments(recipe, *load_versions(registry, plant.reference, forward.reference)), recipe)
    files.load(trainer)
    before, begin, begin_cpu = trainer.agent.updates, time.perf_counter(), time.process_time()
    with ExitStack() as stack:
        for observer in observers:
            stack.enter_context(observer.opened(files.folder, trainer))

        def record(kind: str, step: int, figures: Mapping[str, float]) -> None:
            for observer in observers:
                observer.record(kind, step, figures)

        for step in trainer.train(record):
            if files.is_due:
                files.save(trainer)
            progress(step / recipe.total_steps, _progress_text(trainer))
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
    evaluation_copies: int = EVALUATION_COPIES,
) -> tuple[Environment, Environment]:
    """The environments of training and of evaluation (the actor alone).

    Args:
        reach: limits, starts and targets; by default those of plant and forward model.
        tuning: of the cylinder controller, on the full path; by default from the plant.
        evaluation_copies: size of the evaluation environment.

    Raises:
        SettingsError: plant and forward model do not fit each other.
    """
    setting = recipe.setting

    def environment(size: int, seed: int, task: Task, repeat: int) -> Environment:
        settings: dict[str, Any] = {}
        if setting.full:
            settings = {"tuning": tuning, "repeat": repeat, "feedback": setting.feedback, "residual": setting.residual}
            settings["start_swing"] = setting.start_swing
        return make_environment(plant, forward, full=setting.full, size=size, seed=seed, task=task, reach=reach, **settings)

    held = setting.repeat if setting.residual is not None else 1
    return (
        environment(setting.copies, recipe.seed, setting.task, setting.repeat),
        environment(evaluation_copies, EVALUATION_SEED, evaluation_task(setting.task), held),
    )


def evaluation_task(task: Task) -> Task:
    """The same task with one target and episodes longer than an evaluation."""
    return replace(task, steps=max(task.steps, 2 * SETTLE_STEPS + 1), targets=1)


def policy_of(trainer: Trainer) -> PolicyNetwork:
    """The current actor, for use without torch."""
    space, forward = trainer.agent.space, trainer.environment.forward
    weights, biases = trainer.agent.layers()
    acts = len(space.action_low)
    same = Normalisation(np.zeros(acts), np.ones(acts))
    setting, residual = trainer.recipe.setting, None
    if setting.residual is not None:
        residual = {**asdict(setting.residual), "repeat": float(setting.repeat)}
    return PolicyNetwork(
        inputs=trainer.environment.names,
        outputs=forward.joints,
        mlp=Mlp(weights, biases, Normalisation(space.centre, space.half), same),
        low=space.action_low,
        high=space.action_high,
        full=setting.full,
        residual=residual,
    )


def _progress_text(trainer: Trainer) -> str:
    episode = trainer.episodes[-1]["return"] if trainer.episodes else float("nan")
    if not trainer.evaluations:
        return f"return {episode:.2f}"
    last = trainer.evaluations[-1]
    errors = "/".join(f"{1e3 * last[f'hold_rmse_{axis}']:.1f}" for axis in "xyz")
    return f"return {episode:.2f}, error of the actor alone {errors} mm"
