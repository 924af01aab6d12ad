"""The runs of pipelines/training.py: which policies are trained, and one of them from its recipe to its figures.

A run is resumed to the same bits where it was interrupted; one that is done has its file and is not repeated.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.config import read_toml
from sysid.control import simple
from sysid.files import json_text, written_whole
from sysid.plant import Plant
from sysid.progress import Progress
from sysid.registry import Registry
from sysid.rl.checkpoint import TrainingFiles
from sysid.rl.course import Course, Shortened, lay_out
from sysid.rl.ddpg import Trainer
from sysid.rl.environment import load_versions
from sysid.rl.inverse import chain_of_plant
from sysid.rl.policy import Searching
from sysid.rl.recipe import Recipe, parse_training
from sysid.rl.tracking import SETTLED_S, InversePolicy, Tracked
from sysid.rl.training import environments, policy_of

Array = npt.NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "rl" / "autolog"
#: Root mean square error of the paper's helix, x/y/z [m].
PAPER = {"feedback": (0.017, 0.008, 0.010), "plain": (0.031, 0.017, 0.020)}
#: The paper's recipe takes 1.5 million updates of 1024 rows: a day of a core and more. Here it is cut to this.
CUT = {"networks": {"actor": [128, 128], "critic": [128, 128]}, "learning": {"batch": 256}, "episodes": 60}
#: One thing at a time that the quick recipe does otherwise.
CHOICES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "without hindsight": {"learning": {"hindsight": 0.0}},
    "critic says Q itself": {"networks": {"critic_head": "value"}},
    "angles as they are": {"networks": {"critic_features": "plain"}},
    "γ = 0.99": {"learning": {"discount": 0.99}},
    "constant rates": {"learning": {"schedule": "constant"}},
    "without feedback": {"exploration": {"candidates": 1}},
    "noise that fades to 0.01": {"exploration": {"sigma_end": 0.01}},
    "targets that move away, half of the time": {"setting": {"curriculum": 0.5}},
    "time step of the noise 0.01": {"exploration": {"time_step": 0.01}},
}
CANDIDATES = (3, 10, 30, 100)
#: Forward models of the ablation: the plant's own geometry, the registered network, and that with all joints misread by this.
FORWARDS = ("exact", "fitted", "misread")
MISREAD = 0.05
#: Arms of an ablation that are arms of the comparison already.
SAME = {
    ("choices", "as it is"): ("quick", "feedback"),
    ("choices", "without feedback"): ("quick", "plain"),
    ("candidates", "1"): ("paper", "plain"),
    ("candidates", "10 fitted"): ("paper", "feedback"),
}
#: Cylinder controllers below a policy that is trained and followed on the full path.
DRIVEN = ("by hand", "from the plant")
#: How far ahead inverse kinematics is shown the path, to find what suits it best [s].
AHEAD = tuple(0.05 * k for k in range(21))
#: Scatter of candidates at run time.
SCATTER, AT_RUN_TIME = 0.01, 10


@dataclass(frozen=True)
class Run:
    """One policy to train.

    Args:
        part, arm: of the study.
        changes: tables of the recipe ``base`` that are replaced.
        forward: of :data:`FORWARDS`.
    """

    part: str
    arm: str
    seed: int
    base: str
    changes: Mapping[str, Any]
    forward: str = "fitted"

    @property
    def name(self) -> str:
        words = "".join(letter if letter.isalnum() else "-" for letter in f"{self.part}-{self.arm}")
        return f"{words}-seed{self.seed}"

    def recipe(self) -> Recipe:
        values = read_toml(RECIPES / f"{self.base}.toml")
        for key, value in self.changes.items():
            values[key] = {**values.get(key, {}), **value} if isinstance(value, Mapping) else value
        return replace(parse_training(values, self.name), seed=self.seed)


def runs(share: float, seeds: Mapping[str, int]) -> Iterator[Run]:
    """All runs of the study, each policy once; ``share`` of their episodes, ``seeds`` by part."""

    def episodes(base: str) -> int:
        recipe = read_toml(RECIPES / f"{base}.toml")
        whole = recipe["learning"]["episodes"] if base in ("quick", "driven") else CUT["episodes"]
        return max(3, round(share * whole), recipe["setting"]["copies"])

    def cut(base: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        whole = {**changes}
        own = CUT if base != "quick" else {"networks": {}, "learning": {}}
        for key in ("networks", "learning"):
            whole[key] = {**own[key], **whole.get(key, {})}
        whole["learning"]["episodes"] = episodes(base)
        return whole

    for seed in range(seeds["policies"]):
        for arm, changes in (("feedback", {}), ("plain", {"exploration": {"candidates": 1}})):
            yield Run("quick", arm, seed, "quick", cut("quick", changes))
            yield Run("paper", arm, seed, arm, cut(arm, {}))
    for seed in range(seeds["driven"]):
        for arm in DRIVEN:
            yield Run("driven", arm, seed, "driven", {"learning": {"episodes": episodes("driven")}})
    for seed in range(seeds["choices"]):
        for arm, changes in CHOICES.items():
            if ("choices", arm) not in SAME:
                yield Run("choices", arm, seed, "quick", cut("quick", changes))
    for seed in range(seeds["candidates"]):
        for forward in FORWARDS:
            for count in CANDIDATES:
                arm, changes = f"{count} {forward}", {"exploration": {"candidates": count}}
                if ("candidates", arm) not in SAME:
                    yield Run("candidates", arm, seed, "feedback", cut("feedback", changes), forward)


@dataclass(frozen=True)
class Misread:
    """A forward model that takes every joint for ``by`` of its range more than it is."""

    model: Any
    by: float

    def __getattr__(self, name: str) -> Any:
        if name == "model":  # while it is being copied into another process
            raise AttributeError(name)
        return getattr(self.model, name)

    def predict(self, q: npt.ArrayLike) -> Array:
        return np.asarray(self.model.predict(np.asarray(q) + self.by * (self.model.high - self.model.low)))


@dataclass(frozen=True)
class Exact:
    """The plant's own geometry in the place of a fitted model."""

    model: Any
    plant: Plant

    def __getattr__(self, name: str) -> Any:
        if name in ("model", "plant"):
            raise AttributeError(name)
        return getattr(self.model, name)

    def predict(self, q: npt.ArrayLike) -> Array:
        return chain_of_plant(self.plant).predict(np.asarray(q, dtype=np.float64))


def one(workspace: str, work: str, run: Run, until: float, progress: Progress) -> dict[str, Any] | None:
    """Train, follow the helix, and keep the figures in ``work``; what is there already is read.

    Args:
        until: clock after which nothing is begun [s since the epoch]; None is what comes of it then.
    """
    done, folder = Path(work) / f"{run.name}.json", Path(work) / run.name
    if done.exists():
        return dict(json.loads(done.read_text("utf-8")))
    if time.time() > until:
        return None
    recipe = run.recipe()
    plant, fitted = load_versions(Registry(Path(workspace)), recipe.plant, recipe.forward)
    forward: Any = {"fitted": fitted, "exact": Exact(fitted, plant), "misread": Misread(fitted, MISREAD)}[run.forward]
    tuning = simple(plant) if run.arm == DRIVEN[0] else None
    course = lay_out(plant, fitted, "helix", full=recipe.setting.full, tuning=tuning)
    trainer = Trainer(*environments(recipe, plant, forward, reach=course.reach, tuning=tuning), recipe)
    files = TrainingFiles(folder)
    files.load(trainer)
    marks = _Marks(folder / "marks.json", trainer, course)
    for turn in trainer.train(lambda kind, step, figures: marks.take(step) if kind == "evaluation" else None):
        if files.is_due:
            marks.save()
            files.save(trainer)
        progress(turn / recipe.turns, run.name)
    last, policy = marks.found[-1], policy_of(trainer)
    if course.full:
        ahead = recipe.setting.repeat / plant.machine.rate_hz
        more = {"rmse_ahead": _late(course.run("ahead", Shortened(policy), ahead)).rmse.tolist(), "ahead_s": ahead}
    else:
        more = {"rmse_searched": course.run("searched", Searching(policy, fitted, AT_RUN_TIME, SCATTER)).rmse.tolist()}
    result = {
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
    with written_whole(done) as half:
        half.write_text(json_text(result), "utf-8")
    files.remove()
    return result


class _Marks:
    """What the actor alone does on the helix at each evaluation, and the processor time of training until then."""

    def __init__(self, path: Path, trainer: Trainer, course: Course) -> None:
        self.path, self.trainer, self.course = path, trainer, course
        self.found: list[dict[str, Any]] = []
        now = trainer.turn * trainer.environment.size
        if now and path.exists():
            self.found = [mark for mark in json.loads(path.read_text("utf-8"))["marks"] if mark["step"] <= now]
        self._spent = self.found[-1]["cpu_seconds"] if self.found else 0.0
        self._begin = time.process_time()

    def take(self, step: int) -> None:
        self._spent += time.process_time() - self._begin
        tracked = _late(self.course.run("actor", Shortened(policy_of(self.trainer))))
        figures = {"rmse": tracked.rmse.tolist(), "max": tracked.worst.tolist()}
        self.found.append({"step": step, "cpu_seconds": self._spent, **figures})
        self._begin = time.process_time()

    def save(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(self.path) as half:
            half.write_text(json_text({"marks": self.found}), "utf-8")


def _late(tracked: Tracked) -> Tracked:
    """What counts: on the full path a machine at rest catches up with a path that moves at once."""
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


def seconds_to(result: Mapping[str, Any], accuracy: tuple[float, ...]) -> float | None:
    """Processor time until the helix was first followed to ``accuracy`` in every axis."""
    for mark in result["marks"]:
        if all(found <= wanted for found, wanted in zip(mark["rmse"], accuracy, strict=True)):
            return float(mark["cpu_seconds"])
    return None


def baselines(workspace: str) -> dict[str, list[dict[str, Any]]]:
    """Inverse kinematics on the same helix: where joints follow at once, and above each of :data:`DRIVEN`."""
    recipe = parse_training(read_toml(RECIPES / "quick.toml"), "quick")
    plant, forward = load_versions(Registry(Path(workspace)), recipe.plant, recipe.forward)
    found = {"at once": [lay_out(plant, forward, "helix").baseline("ik").to_json()]}
    for name in DRIVEN:
        course = lay_out(plant, forward, "helix", full=True, tuning=simple(plant) if name == DRIVEN[0] else None)
        ahead = [course.run("ik", InversePolicy(course.inverse), lookahead).to_json() for lookahead in AHEAD]
        found[name] = [ahead[0], min(ahead, key=lambda row: float(row["settled"]["distance_mm"]["rms"]))]
    return found
