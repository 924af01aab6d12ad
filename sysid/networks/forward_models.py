"""Which model of joints → end effector a recipe asks for."""

from __future__ import annotations

from sysid.datasets.recording import Dataset
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.forward import ForwardNetwork, learn_forward
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.structured import StructuredForward, fit_structured
from sysid.progress import Progress

AnyForward = ForwardNetwork | StructuredForward


def fit_forward(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> AnyForward:
    """:func:`learn_forward` or :func:`fit_structured`, as ``recipe.forward.model`` says; they raise the same errors."""
    learn = learn_forward if recipe.forward.model == "network" else fit_structured
    return learn(dataset, recipe, progress, checkpoints)
