"""One run of pipelines/training.py, from its recipe to its figures; and inverse kinematics on the same helix.

A run is resumed to the same bits where it was interrupted; one that is done has its file and is not repeated.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.config import read_toml
from sysid.files import json_text, plain, written_whole
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.progress import Progress
from sysid.registry import Registry
from sysid_rl.control import proportional_tuning
from sysid_rl.train.checkpoint import TrainingFiles
from sysid_rl.train.ddpg import Trainer
from sysid_rl.train.inverse_kinematics import chain_of_plant
from sysid_rl.train.policy import CandidateSearchPolicy
from sysid_rl.train.recipe import parse_training
from sysid_rl.train.tracking import SETTLED_S, InversePolicy, TrackingResult
from sysid_rl.train.tracking_task import TrackingTask, TruncatedObservationPolicy, plan_tracking
from sysid_rl.train.training import environments, policy_of
from sysid_rl.train.versions import load_versions
from trained.runs import AHEAD, AT_RUN_TIME, DRIVEN, MISREAD, RECIPES, SCATTER, Run

Array = npt.NDArray[np.float64]


def kept(done: Path, about: Mapping[str, Any], until: float, made: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
    """Content of the file ``done``; else the result of ``made``, which is written to it.

    Args:
        about: expected entries of the file; with other ones it belongs to another recipe and is made again.
        until: time after which nothing begins and None is returned [s since the epoch].
    """
    if done.exists():
        found: dict[str, Any] = json.loads(done.read_text("utf-8"))
        if {key: found.get(key) for key in about} == plain(about):
            return found
    if time.time() > until:
        return None
    result = made()
    with written_whole(done) as half:
        half.write_text(json_text(result), "utf-8")
    return result


def one(workspace: str, work: str, run: Run, until: float, progress: Progress) -> dict[str, Any] | None:
    """A policy and what it does on the helix, as :func:`kept` in ``work``."""
    done, about = Path(work) / f"{run.name}.json", {"run": asdict(run)}
    return kept(done, about, until, lambda: _trained(workspace, Path(work) / run.name, run, progress))


@dataclass(frozen=True)
class MisreadModel:
    """A forward model with an error of ``by`` of its range in every joint."""

    model: Any
    by: float

    def __getattr__(self, name: str) -> Any:
        if name == "model":  # while it is being copied into another process
            raise AttributeError(name)
        return getattr(self.model, name)

    def predict(self, q: npt.ArrayLike) -> Array:
        return np.asarray(self.model.predict(np.asarray(q) + self.by * (self.model.high - self.model.low)))


@dataclass(frozen=True)
class ExactGeometry:
    """The plant's own geometry in the place of a fitted model."""

    model: Any
    plant: Plant

    def __getattr__(self, name: str) -> Any:
        if name in ("model", "plant"):
            raise AttributeError(name)
        return getattr(self.model, name)

    def predict(self, q: npt.ArrayLike) -> Array:
        return chain_of_plant(self.plant).predict(np.asarray(q, dtype=np.float64))


def _trained(workspace: str, folder: Path, run: Run, progress: Progress) -> dict[str, Any]:
    recipe = run.recipe()
    plant, fitted = load_versions(Registry(Path(workspace)), recipe.plant, recipe.forward)
    forward: Any = {"fitted": fitted, "exact": ExactGeometry(fitted, plant), "misread": MisreadModel(fitted, MISREAD)}[
        run.forward
    ]
    task = _task(plant, fitted, run.arm if recipe.setting.full else None)
    trainer = Trainer(*environments(recipe, plant, forward, reach=task.reach, tuning=task.tuning), recipe)
    files = TrainingFiles(folder)
    files.load(trainer)
    marks = _Progress(folder / "marks.json", trainer, task)
    for turn in trainer.train(lambda kind, step, figures: marks.take(step) if kind == "evaluation" else None):
        if files.is_due:
            marks.save()
            files.save(trainer)
        progress(turn / recipe.total_steps, run.name)
    last, policy = marks.found[-1], policy_of(trainer)
    if task.full:
        ahead = recipe.setting.repeat / plant.machine.rate_hz
        more = {
            "rmse_ahead": _late(task.run("ahead", TruncatedObservationPolicy(policy), ahead)).rmse.tolist(),
            "ahead_s": ahead,
        }
    else:
        more = {
            "rmse_searched": task.run("searched", CandidateSearchPolicy(policy, fitted, AT_RUN_TIME, SCATTER)).rmse.tolist()
        }
    files.remove()
    return {
        "run": asdict(run),
        "updates": trainer.agent.updates,
        "cpu_seconds": last["cpu_seconds"],
        "rmse": last["rmse"],
        "max": last["max"],
        **more,
        "marks": marks.found,
        "episodes": _thinned(trainer.episodes),
        "evaluations": trainer.evaluations,
    }


def _task(plant: Plant, forward: ForwardModel, driven: str | None = None) -> TrackingTask:
    """The helix where joints follow at once, or above a controller of :data:`DRIVEN`."""
    tuning = proportional_tuning(plant) if driven == DRIVEN[0] else None
    return plan_tracking(plant, forward, "helix", full=driven is not None, tuning=tuning)


class _Progress:
    """Errors of the actor on the helix at each evaluation, and the processor time of training until then."""

    def __init__(self, path: Path, trainer: Trainer, task: TrackingTask) -> None:
        self.path, self.trainer, self.task = path, trainer, task
        self.found: list[dict[str, Any]] = []
        now = trainer.step_count * trainer.environment.size
        if now and path.exists():
            self.found = [mark for mark in json.loads(path.read_text("utf-8"))["marks"] if mark["step"] <= now]
        self._spent = self.found[-1]["cpu_seconds"] if self.found else 0.0
        self._begin = time.process_time()

    def take(self, step: int) -> None:
        self._spent += time.process_time() - self._begin
        tracked = _late(self.task.run("actor", TruncatedObservationPolicy(policy_of(self.trainer))))
        figures = {"rmse": tracked.rmse.tolist(), "max": tracked.worst.tolist()}
        self.found.append({"step": step, "cpu_seconds": self._spent, **figures})
        self._begin = time.process_time()

    def save(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(self.path) as half:
            half.write_text(json_text({"marks": self.found}), "utf-8")


def _late(tracked: TrackingResult) -> TrackingResult:
    """The settled part: on the full path a machine at rest first has to reach the moving path."""
    return tracked.after(SETTLED_S) if np.isfinite(tracked.commands).all() else tracked


def _thinned(episodes: list[dict[str, float]], points: int = 60) -> list[dict[str, float]]:
    """Means of stretches of episodes."""
    parts = np.array_split(np.arange(len(episodes)), min(points, len(episodes)))
    return [
        {
            "step": episodes[int(part[-1])]["step"],
            **{key: float(np.mean([episodes[int(k)][key] for k in part])) for key in ("return", "distance")},
        }
        for part in parts
    ]


def baselines(workspace: str) -> dict[str, list[dict[str, Any]]]:
    """Inverse kinematics on the same helix: where joints follow at once, and above each of :data:`DRIVEN`."""
    recipe = parse_training(read_toml(RECIPES / "quick.toml"), "quick")
    plant, forward = load_versions(Registry(Path(workspace)), recipe.plant, recipe.forward)
    found = {"at once": [_task(plant, forward).baseline("ik").to_json()]}
    for name in DRIVEN:
        task = _task(plant, forward, name)
        ahead = [task.run("ik", InversePolicy(task.inverse), lookahead).to_json() for lookahead in AHEAD]
        found[name] = [ahead[0], min(ahead, key=lambda row: float(row["settled"]["distance_mm"]["rms"]))]
    return found
