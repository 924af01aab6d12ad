"""Forward models on the bench crane: errors by choices of the recipe, and learning curves over the number of poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from learned.poses import ANGLES, HELD_OUT, JOINT_NOISE, JOINTS, RANGES, TIP_NOISE, Poses, drawing, poses
from sysid.networks import (
    Checkpoints,
    EnsembleMember,
    ForwardNetwork,
    NetworkRecipe,
    TrainingSettings,
    calibrate,
    fit_chain,
    train,
)
from sysid.networks.chain import SPARE_POSES, products
from sysid.networks.forward import feature_names, to_features
from sysid.networks.mlp import Rectifier
from sysid.networks.recipe import Features
from sysid.signals import point_signals
from sysid.validate.baselines import baseline_models

Array = npt.NDArray[np.float64]
Predict = Callable[[Array], Array]

SEEDS = (0, 1, 2, 3, 4)
POSES, SIZES = 500, (25, 50, 100, 200, 350, 500)
#: Share of the poses that decides when training stops.
STOP = 0.1
#: A pass over few poses is few updates: up to so many times the epochs of the recipe.
LONGER = 2.0
#: Seeds of the poses, other than those of the development of the variants.
STUDY, TEST = 9100, 9200


@dataclass(frozen=True)
class Variant:
    """A network of the paper's layers."""

    features: Features
    rectifier: Rectifier
    members: int = 1

    @property
    def label(self) -> str:
        several = f", mean of {self.members}" if self.members > 1 else ""
        return f"{self.features}, {self.rectifier}{several}"


#: Those trained; the mean of several is that of the same networks.
TRAINED = tuple(
    Variant(features, rectifier, 4 if (features, rectifier) in (("joints", "relu"), ("products", "smooth")) else 1)
    for rectifier in ("relu", "smooth")
    for features in ("joints", "sincos", "products")
)
#: Inputs of the evaluation: true joint values, those of motion capture, and those of the machine's sensors.
ASKED = ("joints", "captured", "own")
NO_NETWORKS = ("structured", "chain", "drawing as it is")
PAPER, BEST = Variant("joints", "relu"), Variant("products", "smooth")


def variants(checkpoints: Checkpoints | None = None) -> list[dict[str, Any]]:
    """Every model at 500 poses over both ranges, evaluated at true joint values, some also at measured ones."""
    rows = []
    for reach in RANGES:
        found = networks(reach, POSES, TRAINED, checkpoints)
        models: dict[str, list[Predict]] = {}
        for variant in TRAINED:
            for several in dict.fromkeys((1, variant.members)):
                one = replace(variant, members=several)
                models[one.label] = [replace(each, members=each.members[:several]).predict for each in found[variant]]
        models |= structures(reach, POSES)
        models["drawing as it is"] = [as_drawn(seed) for seed in SEEDS]
        for name, each in models.items():
            asked = ASKED if name in (PAPER.label, BEST.label, *NO_NETWORKS) else ASKED[:1]
            rows += [{"range": reach, "model": name, "asked": where, **figures(reach, each, where)} for where in asked]
    return rows


def curve(known: Sequence[Mapping[str, Any]], checkpoints: Checkpoints | None = None) -> list[dict[str, Any]]:
    """Errors over the number of poses; ``known`` are the rows of :func:`variants`, which have those of the most."""
    rows = []
    for reach in RANGES:
        for size in SIZES:
            models = structures(reach, size)
            simple = [baseline_models(each.captured, each.seen_tip) for each in taught(reach, size)]
            models |= {name: [each[name] for each in simple] for name in simple[0]}
            found = {name: figures(reach, each) for name, each in models.items()}
            if size < POSES:
                for variant, trained in networks(reach, size, (PAPER, BEST), checkpoints).items():
                    found[variant.label] = figures(reach, [each.predict for each in trained])
            else:
                names = [variant.label for variant in (PAPER, BEST)]
                found |= {
                    row["model"]: row
                    for row in known
                    if (row["range"], row["asked"]) == (reach, "joints") and row["model"] in names
                }
            rows += [{**each, "range": reach, "poses": size, "model": name} for name, each in found.items()]
    return rows


# ---- Models --------------------------------------------------------------------------------------------------------------


def taught(reach: str, count: int) -> list[Poses]:
    """Poses to learn from, one set a seed; fewer are the first of more."""
    whole = [poses(reach, POSES, STUDY, seed) for seed in SEEDS]
    return [Poses(*(getattr(each, key)[:count] for key in vars(each))) for each in whole]


def networks(
    reach: str, count: int, which: Sequence[Variant], checkpoints: Checkpoints | None = None
) -> dict[Variant, list[ForwardNetwork]]:
    """All variants, seeds and members in one training."""
    recipe, keys, members = NetworkRecipe().forward, [], []
    sets = taught(reach, count)
    for variant in which:
        for seed, rows in zip(SEEDS, sets, strict=True):
            names = feature_names(JOINTS, ANGLES, variant.features)
            inputs = to_features(rows.captured, ANGLES, variant.features)
            fit = slice(0, count - max(2, round(STOP * count)))
            stop = slice(fit.stop, count)
            for number in range(variant.members):
                keys.append((variant, seed))
                name = f"{reach} {variant.features} {variant.rectifier} {seed} {number}"
                parts = (inputs[fit], rows.seen_tip[fit], inputs[stop], rows.seen_tip[stop])
                members.append(EnsembleMember(name, *parts, names, point_signals("ee"), rectifier=variant.rectifier))
    trained = train(members, recipe.hidden, longer(recipe.training, POSES / count), 0, checkpoints=checkpoints)
    found: dict[Variant, list[ForwardNetwork]] = {variant: [] for variant in which}
    for variant in which:
        for seed, rows in zip(SEEDS, sets, strict=True):
            own = tuple(one.mlp for key, one in zip(keys, trained, strict=True) if key == (variant, seed))
            low, high = rows.captured.min(axis=0), rows.captured.max(axis=0)
            network = ForwardNetwork(joints=JOINTS, revolute=ANGLES, features=variant.features, members=own, low=low, high=high)
            found[variant].append(network)
    return found


def longer(training: TrainingSettings, times: float) -> TrainingSettings:
    """About as many updates for few rows as for many, up to :data:`LONGER` times the epochs."""
    times = min(max(times, 1.0), LONGER)
    return replace(training, epochs=math.ceil(times * training.epochs), patience=math.ceil(times * training.patience))


def structures(reach: str, count: int) -> dict[str, list[Predict]]:
    """The calibrated drawing, and the chain where there are poses enough for it."""
    sets = taught(reach, count)
    found: dict[str, list[Predict]] = {
        "structured": [
            calibrate(drawing(seed), each.captured, each.seen_tip, JOINT_NOISE, TIP_NOISE).predict
            for seed, each in zip(SEEDS, sets, strict=True)
        ]
    }
    if count >= products(np.zeros((1, len(ANGLES))), ANGLES).shape[1] + SPARE_POSES:
        found["chain"] = [fit_chain(each.captured, each.seen_tip, ANGLES).predict for each in sets]
    return found


def as_drawn(seed: int) -> Predict:
    geometry = drawing(seed)
    return lambda q: geometry.tip(q, np.zeros(len(geometry.parameters)))


def figures(reach: str, models: Sequence[Predict], asked: str = "joints") -> dict[str, Any]:
    """Errors of x, y, z over poses that nothing has seen, against the true tip [m]: mean over the seeds, and the worst."""
    errors = []
    for seed, predict in zip(SEEDS, models, strict=True):
        held = poses(reach, HELD_OUT, TEST, seed)
        errors.append(np.abs(predict(getattr(held, asked)) - held.tip))
    every = np.array(errors)  # (seeds, poses, 3)
    largest = every.max(axis=1)
    return {
        "max": largest.mean(axis=0).tolist(),
        "max_worst": largest.max(axis=0).tolist(),
        "p95": np.percentile(every, 95, axis=1).mean(axis=0).tolist(),
        "mean": every.mean(axis=(0, 1)).tolist(),
        "rmse": np.sqrt(np.mean(every**2, axis=1)).mean(axis=0).tolist(),
    }
