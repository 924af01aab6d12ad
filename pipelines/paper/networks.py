"""Actuator and forward networks of the paper on the logs of the shipped crane."""

from __future__ import annotations

from dataclasses import dataclass, replace

from paper.rows import FORWARD_MAX, PaperRow
from sysid.datasets import Dataset
from sysid.networks import NetworkRecipe, fit_actuator, fit_forward
from sysid.networks.recipe import PAPER_ACTUATOR_TRAINING
from sysid.registry import ModelVersion
from sysid.signals import point_signals
from sysid.validate import ValidationReport, validate_model
from sysid.workspace import Workspace

#: Signal in the error report of the actuator networks → its panel in the paper.
PANELS = {"boom": "validation of actuator network 2", "stick": "validation of actuator network 3"}


@dataclass(frozen=True)
class PaperNetworks:
    """Registered networks with their error reports; ``seed`` of their training."""

    actuator: ModelVersion
    forward: ModelVersion
    actuator_report: ValidationReport
    forward_report: ValidationReport
    seed: int


def fit_networks(place: Workspace, dataset: Dataset) -> PaperNetworks:
    """Fit, validate and register the paper's networks; those of an earlier run are not fitted again."""
    default = NetworkRecipe()
    recipe = replace(default, actuator=replace(default.actuator, training=PAPER_ACTUATOR_TRAINING))
    known = [place.network_version(dataset, kind) for kind in ("actuator", "forward")]
    models = [
        fit(dataset, recipe) if version is None else place.network(version.reference)
        for fit, version in zip((fit_actuator, fit_forward), known, strict=True)
    ]
    reports = [validate_model(model, dataset, recipe=recipe) for model in models]
    versions = [place.add_network(dataset, model, recipe, report) for model, report in zip(models, reports, strict=True)]
    return PaperNetworks(*versions, *reports, seed=recipe.seed)


def fit_linkages(place: Workspace, dataset: Dataset) -> None:
    """Register actuator networks by the default schedule, for the linkages of the plant."""
    if place.network_version(dataset, "actuator") is None:
        place.add_network(dataset, fit_actuator(dataset, NetworkRecipe()), NetworkRecipe())


def rows(networks: PaperNetworks) -> list[PaperRow]:
    """Errors on held-out recordings and poses."""
    found = []
    for axis, panel in PANELS.items():
        for signal, unit in ((f"{axis}.joint", "mrad"), (f"{axis}.cylinder", "mm")):
            metrics = networks.actuator_report.output(signal, "motion").metrics
            values = 1e3 * metrics.rmse, 1e3 * metrics.max
            what = f"{signal}: RMSE / max"
            found.append(PaperRow(panel, what, "held-out recording of manual operation", None, values, unit, networks.seed))
    tips = [networks.forward_report.output(signal, "poses").metrics for signal in point_signals("ee")]
    largest = tuple(1e3 * metrics.max for metrics in tips)
    what = "forward network, max x / y / z"
    found.append(
        PaperRow("evaluation of the forward network", what, "held-out poses of 500", FORWARD_MAX, largest, "mm", networks.seed)
    )
    return found
