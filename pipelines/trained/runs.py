"""The runs of pipelines/training.py: the policies to train, and the time until an accuracy is reached."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sysid.config import read_toml
from sysid_rl.train.recipe import TrainingRecipe, parse_training

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "rl" / "autolog"
#: Root mean square error of the paper's helix, x/y/z [m].
PAPER = {"feedback": (0.017, 0.008, 0.010), "plain": (0.031, 0.017, 0.020)}
#: The paper's recipe makes 1.5 million updates of 1024 rows, which takes half a day of a core. Here it has all of its episodes,
#: and so all targets, each for fewer steps, and smaller networks and batches.
CUT: dict[str, dict[str, Any]] = {
    "networks": {"actor": [128, 128], "critic": [128, 128]},
    "learning": {"batch": 256},
    "setting": {"task": {"steps": 40}},
}
#: Steps per update of the otherwise complete recipe, and episodes between two evaluations on the helix.
EVERY, APART = 25, 20
#: Single changes of the quick recipe.
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
#: Look-ahead times of inverse kinematics, of which the best is chosen [s].
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

    def recipe(self) -> TrainingRecipe:
        values = read_toml(RECIPES / f"{self.base}.toml")
        for key, value in self.changes.items():
            values[key] = {**values.get(key, {}), **value} if isinstance(value, Mapping) else value
        return replace(parse_training(values, self.name), seed=self.seed)


def runs(share: float, seeds: Mapping[str, int]) -> Iterator[Run]:
    """All runs of the study, each policy once; ``share`` of their episodes, ``seeds`` by part."""

    def shortened(episodes: int, least: int = 3) -> int:
        return max(least, round(share * episodes))

    def cut(base: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        recipe = read_toml(RECIPES / f"{base}.toml")
        own = CUT if base in PAPER else {}
        whole = {key: {**own.get(key, {}), **changes.get(key, {})} for key in ("networks", "learning", *own, *changes)}
        whole["learning"]["episodes"] = shortened(recipe["learning"]["episodes"], max(3, recipe["setting"]["copies"]))
        return whole

    for seed in range(seeds["policies"]):
        for arm, changes in (("feedback", {}), ("plain", {"exploration": {"candidates": 1}})):
            yield Run("quick", arm, seed, "quick", cut("quick", changes))
            yield Run("paper", arm, seed, arm, cut(arm, {}))
    for seed in range(seeds["whole"]):
        episodes = shortened(read_toml(RECIPES / "feedback.toml")["learning"]["episodes"])
        changes = {"evaluations": max(1, episodes // APART), "learning": {"every": EVERY, "episodes": episodes}}
        yield Run("whole", "feedback", seed, "feedback", changes)
    for seed in range(seeds["driven"]):
        for arm in DRIVEN:
            yield Run("driven", arm, seed, "driven", cut("driven", {}))
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


def seconds_to(result: Mapping[str, Any], accuracy: tuple[float, ...]) -> float | None:
    """Processor time until the helix was first followed to ``accuracy`` in every axis."""
    for mark in result["marks"]:
        if all(found <= wanted for found, wanted in zip(mark["rmse"], accuracy, strict=True)):
            return float(mark["cpu_seconds"])
    return None
