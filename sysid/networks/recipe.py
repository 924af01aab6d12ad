"""Fitting recipe: frozen settings, after the paper, whose keys a TOML file overrides.

Architectures, optimiser and numbers of samples are the paper's, whose batch sizes, numbers of epochs, schedules and forward
learning rate are not published; those were chosen here (``docs/networks.md``), and with them a learning rate of the actuator
networks that reaches the same errors in a fifth of the paper's updates (:data:`PAPER_ACTUATOR_TRAINING`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from sysid.config import Strict, parse_settings, read_toml
from sysid.errors import SettingsError, nearest
from sysid.networks.member import TrainingSettings, require_positive
from sysid.networks.mlp import Rectifier

Features = Literal["joints", "sincos", "products"]

#: Largest error of the paper's forward network with 500 training poses, by output [m]. The paper does not state the test rows.
PAPER_MAX = {"ee.x": 15.9e-3, "ee.y": 20.5e-3, "ee.z": 13.6e-3}

#: The paper's learning rate, with as many epochs as it needs.
PAPER_ACTUATOR_TRAINING = TrainingSettings(1e-4, batch=64, epochs=800, patience=100, check_every=5, schedule="cosine")
_ACTUATOR_TRAINING = TrainingSettings(learning_rate=3e-3, batch=64, epochs=150, patience=100, check_every=5, schedule="cosine")
_MOTION_TRAINING = TrainingSettings(learning_rate=2e-3, batch=128, epochs=60, patience=20, check_every=2, schedule="cosine")
_FORWARD_TRAINING = TrainingSettings(learning_rate=3e-3, batch=16, epochs=500, patience=150, check_every=5, schedule="cosine")


@dataclass(frozen=True)
class HistoryRecipe(Strict):
    """The correction of each static map (``[actuator] model = "history"``).

    Args:
        interval: seconds between two updates.
        units: of the LSTM.
        plays: widths of the play operators, as shares of the fitted range; none: inputs are position and speed.
        epochs, check_every, patience: as in :class:`TrainingSettings`; one parameter update per epoch.
    """

    interval: float = 0.05
    units: int = 16
    plays: tuple[float, ...] = (0.003, 0.01, 0.03)
    learning_rate: float = 0.02
    epochs: int = 150
    check_every: int = 10
    patience: int = 60

    def check(self, where: object) -> None:
        """Raises SettingsError for a value that cannot be used."""
        require_positive(where, self, "interval", "units", "learning_rate", "epochs", "check_every", "patience")
        if not all(0.0 < share < 1.0 for share in self.plays):
            raise SettingsError(where, f"plays = {list(self.plays)}", "shares of the range between 0 and 1, as in [0.01]")


@dataclass(frozen=True)
class ActuatorRecipe(Strict):
    """Both directions of every cylinder-joint map.

    Args:
        model: ``static`` (the paper), or ``history``: with a correction for backlash and hysteresis.
        samples: fit rows, stratified over the stroke.
        rows: kinds of recordings. Poses reach the ends of the stroke, which an operator avoids.
        hidden: hidden layers of an axis that ``hidden_of`` does not name.
        hidden_of: axis → hidden layers.
        rectifier: ``relu`` (the paper), or ``smooth``: squareplus.
        training: settings.
        history: settings of the correction.
    """

    model: Literal["static", "history"] = "static"
    samples: int = 1500
    rows: tuple[Literal["motion", "poses"], ...] = ("motion", "poses")
    hidden: tuple[int, ...] = (128, 128)
    hidden_of: dict[str, tuple[int, ...]] = field(default_factory=lambda: {"boom": (256, 128, 128), "stick": (128, 128)})
    rectifier: Rectifier = "relu"
    training: TrainingSettings = _ACTUATOR_TRAINING
    history: HistoryRecipe = HistoryRecipe()

    def layers(self, axis: str) -> tuple[int, ...]:
        return self.hidden_of.get(axis, self.hidden)


@dataclass(frozen=True)
class ForwardRecipe(Strict):
    """Joint values → end effector.

    Args:
        poses: largest number of static poses, fit and early-stopping poses together.
        hidden: hidden layers.
        features: ``joints`` (the paper); ``sincos``: sine and cosine of every revolute joint instead of its angle;
            ``products``: their products as well, one factor a joint, in which the tip of any open chain is linear.
        rectifier: ``relu`` (the paper), or ``smooth``: squareplus.
        members: networks with different initial weights whose predictions are averaged (the paper: one).
        training: settings.
        model: ``network`` (the paper), or ``structured``: the URDF with its geometry calibrated on the poses, or ``chain``: any
            open chain, linear in products of sines and cosines, without a URDF.
        residual: whether a small network may correct the residual of the geometry; ``residual_hidden``: its layers.
    """

    poses: int = 500
    hidden: tuple[int, ...] = (256, 128)
    features: Features = "joints"
    rectifier: Rectifier = "relu"
    members: int = 1
    training: TrainingSettings = _FORWARD_TRAINING
    model: Literal["network", "structured", "chain"] = "network"
    residual: bool = True
    residual_hidden: tuple[int, ...] = (32, 32)


@dataclass(frozen=True)
class MotionRecipe(Strict):
    """Command → motion of every axis, after Hwangbo et al., Science Robotics 4 (2019).

    Args:
        step: seconds from one prediction to the next, rounded to whole samples; long enough that sensor noise is small against
            the motion.
        history: lags of the commands, seconds before the predicted step; 0 is the command of that step.
        speeds: edges of the past speeds, seconds before now. All times are rounded to whole steps.
        position: whether the position is an input.
        samples: largest numbers of fit and of early-stopping rows, evenly spaced.
        hidden: hidden layers.
        members: networks with different initial weights whose speeds are averaged, with and without past speeds; the candidate
            with the better free runs is selected.
        horizons: seconds after which free runs are evaluated, besides whole recordings.
        training: settings.
    """

    step: float = 0.05
    history: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
    speeds: tuple[float, ...] = (0.05, 0.1, 0.2)
    position: bool = True
    samples: int = 8000
    hidden: tuple[int, ...] = (32, 32)
    members: int = 3
    horizons: tuple[float, ...] = (0.5, 1.0, 2.0, 5.0)
    training: TrainingSettings = _MOTION_TRAINING

    def check(self, where: object) -> None:
        """Raises SettingsError for a value that cannot be used."""
        self.training.check(f"{where}.training")
        for key, values in (
            ("step", (self.step,)),
            ("samples", (self.samples,)),
            ("members", (self.members,)),
            ("horizons", self.horizons or (0.0,)),
            ("hidden", self.hidden or (0,)),
        ):
            if not all(math.isfinite(value) and value > 0 for value in values):
                raise SettingsError(f"{where}.{key}", str(getattr(self, key)), "positive numbers")


@dataclass(frozen=True)
class NetworkRecipe(Strict):
    """The whole recipe; ``seed`` determines samples, initial weights and shuffle order."""

    schema: Literal[1] = 1
    seed: int = 0
    actuator: ActuatorRecipe = ActuatorRecipe()
    forward: ForwardRecipe = ForwardRecipe()
    motion: MotionRecipe = MotionRecipe()

    def to_json(self) -> dict[str, Any]:
        """For lineage records; :func:`parse_recipe` is its inverse."""
        return asdict(self)

    def check_axes(self, axes: Iterable[str]) -> None:
        """Raises SettingsError where ``hidden_of`` names an axis that neither the machine nor the paper has."""
        known = {*axes, *ActuatorRecipe().hidden_of}
        for axis in self.actuator.hidden_of:
            if axis not in known:
                raise SettingsError("recipe: actuator.hidden_of", f"unknown axis {axis!r}", nearest(axis, axes))


def load_recipe(path: Path | None = None) -> NetworkRecipe:
    """The recipe in ``path``, over the default; None: the default.

    Raises:
        SettingsError: unknown keys, wrong types, invalid values.
    """
    return NetworkRecipe() if path is None else parse_recipe(read_toml(path), path)


def parse_recipe(values: dict[str, Any], where: object) -> NetworkRecipe:
    """``values`` over the default recipe, checked; ``where`` names their source in messages."""
    recipe = parse_settings(_merged(asdict(NetworkRecipe()), values), NetworkRecipe, where)
    for part, settings in (("actuator", recipe.actuator.training), ("forward", recipe.forward.training)):
        settings.check(f"{where}: {part}.training")
    recipe.actuator.history.check(f"{where}: actuator.history")
    recipe.motion.check(f"{where}: motion")
    for key, value in (
        ("actuator.samples", recipe.actuator.samples),
        ("forward.poses", recipe.forward.poses),
        ("forward.members", recipe.forward.members),
    ):
        if value < 1:
            raise SettingsError(f"{where}: {key}", str(value), "a positive number")
    if "motion" not in recipe.actuator.rows:
        raise SettingsError(f"{where}: actuator.rows", str(list(recipe.actuator.rows)), "motion, with or without poses")
    if recipe.seed < 0:
        raise SettingsError(f"{where}: seed", str(recipe.seed), "a number from 0 on")
    return recipe


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both_tables = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merged(merged[key], value) if both_tables else value
    return merged
