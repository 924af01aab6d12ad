"""A workspace: stores and finds the dataset versions, model versions and results of one location.

The processing steps (``ingest``, ``fit_actuator``, ``find_gap``, …) are functions of values; the workspace stores their
results and loads them for the next step.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from sysid.datasets import Dataset, Store, VacuumResult, vacuum
from sysid.datasets.clocks.residual import clock_residuals, with_residuals
from sysid.errors import ExcitationError, SettingsError, StoreError
from sysid.extras import versions_of
from sysid.gap import GapResult
from sysid.gap.experiment.excitation_verdict import excitation_report
from sysid.gap.stored_result import load_gap, save_gap
from sysid.location import LOCAL, checked_location, local_folder
from sysid.names import check_dataset_name, model_name
from sysid.networks import (
    ActuatorNetwork,
    Model,
    NetworkRecipe,
    from_files,
    parse_recipe,
    static_networks,
    to_files,
)
from sysid.networks.policy import PolicyNetwork
from sysid.plant import Plant, free_run, nominal_plant, plant_from_files
from sysid.registry import CHAMPION, NETWORKS, DamagedModel, ModelVersion, Registry, dataset_descendants
from sysid.registry.policy import load_policy
from sysid.registry.version import sha256
from sysid.release import __version__
from sysid.reports import ReportInputs
from sysid.root import Root
from sysid.validate import ValidationReport, validate_model

#: Packages whose versions a report states.
SOFTWARE = ("numpy", "scipy", "numba", "torch", "pandas", "deltalake", "mlflow-skinny")


@dataclass(frozen=True)
class Workspace:
    """Datasets, models and results under one location.

    Args:
        location: a folder, or the URL of an object store for the datasets; models and results then stay in ``local``.
        local: folder for models and results where ``location`` is a URL.
    """

    location: str | Path = "./workspace"
    local: Path = LOCAL

    @property
    def folder(self) -> Path:
        """The folder of models, results and reports."""
        return local_folder(self.location, self.local)

    @property
    def root(self) -> Root:
        """Opens what is below :attr:`folder`; a link there is refused."""
        return Root(self.folder)

    @cached_property
    def datasets(self) -> Store:
        return Store(self.location)

    @cached_property
    def models(self) -> Registry:
        return Registry(self.folder)

    def dataset(self, reference: str | None = None, recordings: Collection[str] | None = None) -> Dataset:
        """The dataset ``name`` or ``name@3``; without a reference the only one of the workspace.

        Args:
            recordings: names of the only ones to load; by default all.

        Raises:
            StoreError: no such dataset or recording, or no reference and not exactly one dataset.
        """
        if reference is None:
            names = sorted({entry.name for entry in self.datasets.list()})
            if len(names) != 1:
                listed = ", ".join(names) or "none"
                raise StoreError(f"workspace {self.location}", f"{len(names)} datasets ({listed})", "the name of one")
            reference = names[0]
        return self.datasets.load(reference, recordings)

    def made_from(self, reference: str, digest: str) -> tuple[ModelVersion, ...]:
        """The model versions that were made from a dataset version, directly or through another model."""
        return dataset_descendants(self.models.list(), reference, digest)

    def vacuum(self, references: Sequence[str] = (), keep: int | None = None, dry_run: bool = False) -> VacuumResult:
        """Remove left-overs and dataset versions, but none that a registered model was made from.

        Args:
            references, keep, dry_run: see :func:`sysid.datasets.versions.vacuum.vacuum`.

        Raises:
            StoreError: no such version, or the registry cannot be read; nothing is removed then.
        """
        versions: list[ModelVersion] = []
        for entry in self.models.survey():
            if isinstance(entry, DamagedModel):
                expected = "a registry with the sources of every model"
                raise StoreError(entry.error.where, entry.error.found, expected, "Nothing was removed: repair it first.")
            versions.append(entry)

        def users(reference: str, digest: str) -> list[str]:
            return [f"{version.kind} {version.reference}" for version in dataset_descendants(versions, reference, digest)]

        return vacuum(self.datasets, users, references, keep, dry_run)

    def add_network(
        self, dataset: Dataset, model: Model, recipe: NetworkRecipe, report: ValidationReport | None = None
    ) -> ModelVersion:
        """Register a fitted network as ``<dataset>-<kind>``, with its figures."""
        kind, files = to_files(model)
        lineage = {"dataset": dataset.reference, "dataset_digest": dataset.digest, "recipe": recipe.to_json()}
        metrics = report.metrics() if report is not None else {}
        return self.models.register(model_name(dataset.name, f"-{kind}"), kind, files, lineage, metrics)

    def network_version(self, dataset: Dataset, kind: str) -> ModelVersion | None:
        """The network of ``kind`` fitted on this dataset version, else on any version of the dataset.

        Of several, the champion, else the newest.
        """
        versions = [version for version in self.models.versions(model_name(dataset.name, f"-{kind}")) if version.kind == kind]
        exact = [version for version in versions if version.lineage.get("dataset_digest") == dataset.digest]
        return max(exact or versions, key=lambda version: (CHAMPION in version.aliases, version.version), default=None)

    def network(self, reference: str) -> Model:
        """The network ``name@version``, of any kind.

        Raises:
            StoreError: no such version, or a plant or policy.
        """
        version = self.models.load(reference)
        if version.kind not in NETWORKS:
            raise StoreError(f"model {reference}", f"is of kind {version.kind!r}", "a network")
        return from_files(version.files, version.reference)

    def policy(self, reference: str) -> PolicyNetwork:
        """The policy ``name@version``.

        Raises:
            StoreError: no such version, or of another kind.
        """
        return load_policy(self.models.load(reference))

    def linkages(self, dataset: Dataset) -> dict[str, ActuatorNetwork]:
        """The fitted cylinder ↔ joint maps by axis; empty if none were fitted.

        If only networks with history were fitted, their static parts.
        """
        version = self.linkage_version(dataset)
        return static_networks(self.network(version.reference)) if version is not None else {}

    def linkage_version(self, dataset: Dataset) -> ModelVersion | None:
        """The version of :meth:`linkages`."""
        return self.network_version(dataset, "actuator") or self.network_version(dataset, "history")

    def validation(self, reference: str, dataset: Dataset) -> ValidationReport:
        """Evaluate a registered network on a dataset, with the recipe of its fit."""
        version = self.models.find(reference)
        values = version.lineage.get("recipe")
        recipe = parse_recipe(dict(values), reference) if isinstance(values, Mapping) else None
        return validate_model(self.network(reference), dataset, recipe=recipe, name=version.reference)

    def plant(self, dataset: Dataset, reference: str | None = None) -> Plant:
        """A registered plant, or the nominal one of the dataset's ``machine.toml``.

        Raises:
            StoreError: no such plant.
            SettingsError: the plant is of another machine.
        """
        if reference is None:
            version = self.linkage_version(dataset)
            origin: dict[str, Any] = {"networks": version.reference} if version is not None else {}
            return nominal_plant(dataset.machine, self.linkages(dataset), dataset.streams, **origin)
        version = self.models.load(reference)
        if version.kind != "plant":
            raise StoreError(f"model {reference}", f"is of kind {version.kind!r}", "a plant")
        plant = plant_from_files(version.files, version.reference)
        if plant.machine.axis_names != dataset.machine.axis_names:
            found = ", ".join(plant.machine.axis_names)
            raise SettingsError(f"plant {reference}", f"axes {found}", f"those of {dataset.machine.name}")
        return plant

    def simulation(self, dataset: Dataset, reference: str | None = None) -> Plant:
        """The plant that simulates the machine: a named one, else the promoted one, else the nominal one.

        In contrast, :meth:`plant` without a name returns the nominal one, which the gap workflow tests.

        Raises:
            StoreError: no such plant.
            SettingsError: the plant is of another machine.
        """
        promoted = self.models.promoted(model_name(dataset.machine.name)) if reference is None else None
        return self.plant(dataset, promoted.reference if promoted is not None else reference)

    def output(self, path: str, dataset: Dataset | None = None) -> Path:
        """Path of a file to be written, relative to the workspace or the results of a dataset version; its folder is created.

        Raises:
            StoreError: it is a link, or a folder on the way is one.
        """
        return self.root.output(f"{_results(dataset)}/{path}" if dataset is not None else path)

    def gap_folder(self, dataset: Dataset) -> Path:
        """Folder of the gap result of this dataset version."""
        return self.root.path(f"{_results(dataset)}/gap")

    def keep_gap(self, dataset: Dataset, result: GapResult) -> Path:
        """Store a gap result; it replaces the earlier one of the dataset version."""
        return save_gap(self.gap_folder(dataset), result)

    def gap(self, dataset: Dataset) -> GapResult | None:
        """The stored gap result of this dataset version."""
        return load_gap(self.gap_folder(dataset))

    def tests(self, result: GapResult, plant: Plant) -> bool:
        """Whether ``plant`` is the one that a gap result tests: the same version, or one of the same files."""
        if plant.reference or "@" not in result.plant_before:
            return plant.reference == result.plant_before != ""
        own = {file: sha256(content) for file, content in plant.to_files().items()}
        listed = self.models.list("plant")
        return any(version.reference == result.plant_before and version.sha256 == own for version in listed)

    def predictions(self, dataset: Dataset, recording: str, plant: str | None = None) -> dict[str, pd.DataFrame]:
        """Free runs of one recording: of a named plant, else those of the stored gap result, else of :meth:`simulation`.

        Returns:
            Name (``before``, ``after`` or the plant's) → table of predicted signals, for :func:`sysid.view.write_rerun`.
        """
        source = dataset.recording(recording)
        if plant is not None:
            named = self.plant(dataset, plant)
            return {named.reference: free_run(named, source)}
        result = self.gap(dataset)
        for trace in result.traces if result is not None else ():
            if trace.recording == recording:
                return (
                    {"before": trace.before, "after": trace.after} if result and result.repaired else {"before": trace.before}
                )
        simulation = self.simulation(dataset)
        return {simulation.reference or "before": free_run(simulation, source)}

    def report_inputs(self, dataset: Dataset, result: GapResult | None = None) -> ReportInputs:
        """The content of the report on a dataset version, for :func:`sysid.reports.build_report`.

        Args:
            result: a gap result that is not stored; default: the stored one.
        """
        result = result if result is not None else self.gap(dataset)
        networks = [version for kind in NETWORKS if (version := self.network_version(dataset, kind)) is not None]
        plants = dict.fromkeys((result.plant_before, result.plant_after) if result is not None else ())
        validations, aligned = [], with_residuals(dataset.clocks)
        for version in networks:
            with suppress(ExcitationError):  # no held-out recording measures its signals: listed without figures
                validations.append(self.validation(version.reference, dataset))
        return ReportInputs(
            dataset=dataset,
            gap=result,
            validations=tuple(validations),
            versions=(*networks, *(self.models.find(reference) for reference in plants if "@" in reference)),
            created=f"{datetime.now().astimezone():%d %B %Y, %H:%M}".lstrip("0"),
            excitation=excitation_report(dataset, self._tested_plant(dataset, result)),
            clocks=clock_residuals(self.datasets.channels(dataset.reference, aligned), dataset.clocks) if aligned else (),
            software={"sysid": __version__, **versions_of(SOFTWARE)},
        )

    def _tested_plant(self, dataset: Dataset, result: GapResult | None) -> Plant:
        """The plant that a gap result tests; the nominal one without a result, or for a user's simulator."""
        reference = result.plant_before if result is not None else ""
        known = "@" in reference and any(version.reference == reference for version in self.models.list("plant"))
        return self.plant(dataset, reference if known else None)


def _results(dataset: Dataset) -> str:
    return f"results/{check_dataset_name(dataset.name)}@{dataset.version}"


def open_workspace(location: str | os.PathLike[str]) -> Workspace:
    """The workspace at ``location``, which is created by the first write.

    Raises:
        SettingsError: ``location`` is a file.
    """
    return Workspace(checked_location(location))
