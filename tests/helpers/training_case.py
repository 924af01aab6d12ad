"""A small training on a crane that is known: what the tests of the trainer share."""

from __future__ import annotations

import itertools
from typing import Any

from crane_model import Perfect, crane_plant

from sysid_rl.train.ddpg import Trainer
from sysid_rl.train.recipe import TrainingRecipe, parse_training
from sysid_rl.train.training import environments

PLANT = crane_plant()


class Seeing(Perfect):
    """A perfect forward model that says which joints are angles."""

    revolute = (True, True, True, False)


FORWARD = Seeing(PLANT)


def recipe(**parts: Any) -> TrainingRecipe:
    """A recipe of some 200 updates in a third of a second; ``parts`` replace keys of its tables, or keys at its top."""
    values: dict[str, Any] = {
        "name": "small",
        "plant": "crane",
        "forward": "crane-forward",
        "evaluations": 4,
        "setting": {"copies": 4, "task": {"steps": 15}},
        "exploration": {"candidates": 3},
        "networks": {"actor": [12, 8], "critic": [10]},
        "learning": {"episodes": 60, "start": 32, "batch": 16, "buffer": 300, "tau": 0.01, "hindsight": 0.5},
    }
    for key, value in parts.items():
        values[key] = {**values[key], **value} if isinstance(value, dict) else value
    return parse_training(values, "small")


def trainer(settings: TrainingRecipe) -> Trainer:
    return Trainer(*environments(settings, PLANT, FORWARD, evaluation_copies=16), settings)


def steps(each: Trainer, count: int) -> None:
    """``count`` steps of a training."""
    for _ in itertools.islice(each.train(), count):
        pass
