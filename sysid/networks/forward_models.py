"""Which model of joints → end effector a recipe asks for, and how far it can be trusted."""

from __future__ import annotations

from dataclasses import replace

from sysid.datasets.recording import Dataset
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.forward import ForwardNetwork, learn_forward, taught_rows
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.structured import StructuredForward, fit_structured
from sysid.networks.uncertainty import NetworkUncertainty
from sysid.progress import Progress

AnyForward = ForwardNetwork | StructuredForward


def fit_forward(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> AnyForward:
    """:func:`learn_forward` or :func:`fit_structured`, as ``recipe.forward.model`` says; they raise the same errors."""
    learn = learn_forward if recipe.forward.model == "network" else fit_structured
    model = learn(dataset, recipe, progress, checkpoints)
    fit, select = taught_rows(dataset, recipe)
    count = len(model.joints)
    q = select.values[:, :count]
    return replace(
        model, trust=NetworkUncertainty.of(fit.values[:, :count], select.values[:, count:] - model.predict(q), model.spread(q))
    )
