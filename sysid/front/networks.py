"""Networks of a stored dataset: fitted, registered, evaluated."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sysid.datasets import Dataset
from sysid.errors import ExcitationError, SettingsError, StoreError, nearest
from sysid.front.place import Place, dataset_in, shown
from sysid.front.place import open as opened
from sysid.model_versions import ModelVersions
from sysid.networks import (
    Calibration,
    Checkpoints,
    Model,
    NetworkRecipe,
    StructuredForward,
    fit_actuator,
    fit_forward,
    fit_history,
    fit_motion,
    load_recipe,
)
from sysid.validate import ValidationReport, validate_model
from sysid.versions import DriftReport

if TYPE_CHECKING:
    from sysid.progress import Progress

Kind = Literal["actuator", "motion", "forward"]


@dataclass(frozen=True)
class FittedNetwork:
    """A registered network with its evaluation.

    Args:
        version: ``name@version``.
        report: None where no held-out recording measures its signals; ``not_evaluated`` is the reason then.
        seconds: of the fit [s].
    """

    version: str
    dataset: str
    model: Model
    report: ValidationReport | None
    not_evaluated: str
    seconds: float

    @property
    def calibration(self) -> Calibration | None:
        """The kinematics of a forward network that are fitted to the recordings."""
        structure = self.model.structure if isinstance(self.model, StructuredForward) else None
        return structure if isinstance(structure, Calibration) else None

    def to_json(self) -> dict[str, Any]:
        result: dict[str, Any] = {"model": self.version, "dataset": self.dataset, "seconds": self.seconds}
        if self.calibration is not None:
            result["calibration"] = self.calibration.to_json()
        return {**result, "validation": self.report.to_json() if self.report is not None else None}

    def __repr__(self) -> str:
        return f"FittedNetwork({self.version}, {self.seconds:.1f} s)"


def fit(
    kind: Kind,
    dataset: Dataset | str | None = None,
    workspace: Place = None,
    *,
    recipe: NetworkRecipe | str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> FittedNetwork:
    """Fit, evaluate and register a network: actuator (cylinder ↔ joint), motion (commands → motion), forward (joints → tip).

    An interrupted fit resumes when it is repeated.

    Args:
        dataset: of the workspace, or its reference; None: the only one.
        workspace: see :func:`sysid.open`.
        recipe: settings, or their TOML file; default: the paper's. Its ``model = "history"`` under ``[actuator]`` makes
            actuator networks depend on past motion.
        progress: called with the share done and a text; by default a bar is shown.

    Raises:
        SettingsError: no such kind, or a mistake in the recipe.
        ExcitationError: the recordings do not contain what the network is fitted to.
    """
    kinds = ("actuator", "motion", "forward")
    if kind not in kinds:
        raise SettingsError("fit", f"no kind {kind!r}", nearest(kind, kinds))
    settings = recipe if isinstance(recipe, NetworkRecipe) else load_recipe(Path(recipe) if recipe is not None else None)
    place = opened(workspace)
    data = dataset_in(place, dataset)
    actuator = fit_history if settings.actuator.model == "history" else fit_actuator
    function = {"actuator": actuator, "motion": fit_motion, "forward": fit_forward}[kind]
    begin = time.perf_counter()
    with shown(progress, f"fit {kind}") as report:
        model = function(data, settings, report, Checkpoints(place.root.path("training")))
        seconds = time.perf_counter() - begin
        evaluation, reason = None, ""
        try:
            evaluation = validate_model(model, data, recipe=settings)
        except ExcitationError as error:
            reason = str(error)
        version = place.add_network(data, model, settings, evaluation)
    return FittedNetwork(version.reference, data.reference, model, evaluation, reason, seconds)


@dataclass(frozen=True)
class Validation:
    """Evaluation of a network on a dataset.

    Args:
        report: None where no held-out recording measures its signals; ``not_evaluated`` is the reason then.
        drift: against the dataset of the fit; None for that dataset, and where ``not_tested`` is the reason.
    """

    model: str
    dataset: str
    report: ValidationReport | None
    drift: DriftReport | None
    not_evaluated: str = ""
    not_tested: str = ""

    def to_json(self) -> dict[str, Any]:
        values = self.report.to_json() if self.report is not None else {"model": self.model, "dataset": self.dataset}
        return {"schema": 1, **values, "drift": self.drift.to_json() if self.drift is not None else None}


def validate(model: str, dataset: Dataset | str | None = None, workspace: Place = None) -> Validation:
    """Evaluate a registered network on held-out recordings; on another dataset than that of its fit, also test for drift.

    Args:
        model: ``name`` or ``name@version``.
        dataset: of the workspace, or its reference; None: the only one.
        workspace: see :func:`sysid.open`.

    Raises:
        StoreError: no such model or dataset.
        ExcitationError: neither is possible with these recordings.
    """
    place = opened(workspace)
    data = dataset_in(place, dataset)
    version = place.models.find(model)
    own = version.lineage.get("dataset_digest") == data.digest
    report, drift, not_evaluated, not_tested = None, None, "", ""
    try:
        report = place.validation(model, data)
    except ExcitationError as error:
        if own:
            raise
        not_evaluated = str(error)
    if not own:
        try:
            drift = ModelVersions(place).drift(model, data)
        except (ExcitationError, StoreError) as error:
            if report is None:
                raise
            not_tested = str(error)
    return Validation(version.reference, data.reference, report, drift, not_evaluated, not_tested)
