"""Operations on the model versions of a workspace: promote, lineage, diff, drift, export, card.

It loads the datasets, models and results for the functions of :mod:`sysid.versions`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from sysid.datasets import Dataset
from sysid.datasets.versions.index import VersionIndex
from sysid.display import quantity
from sysid.errors import ExcitationError, SettingsError, StoreError
from sysid.gap.stored_result import RESULT
from sysid.parse import parse_json
from sysid.registry import NETWORKS, Check, ModelVersion, Promotion, decide
from sysid.reports.card import Card, CardBlock, card_of, changes
from sysid.validate import ValidationReport
from sysid.versions import (
    DriftReport,
    ExportedFile,
    ModelDiff,
    ModelLineage,
    PromotionPolicy,
    diff_versions,
    drift_of,
    export_onnx,
    lineage_of,
    policy_checks,
)
from sysid.versions.lineage import ResultUse
from sysid.versions.onnx_export import Precision
from sysid.versions.policy import evaluated_by
from sysid.workspace import Workspace


@dataclass(frozen=True)
class ModelVersions:
    """The model versions of one workspace.

    >>> versions = ModelVersions(open_workspace("./workspace"))
    >>> versions.promote("autolog-forward@3", load_policy(Path("policy.toml"))).promoted
    """

    workspace: Workspace

    def promote(
        self,
        reference: str,
        policy: PromotionPolicy | None = None,
        path: Path | None = None,
        word: str = "",
        dataset: str | None = None,
    ) -> Promotion:
        """Make this version the champion if it passes, and record the decision with it.

        A network is evaluated by ``policy`` on the held-out rows of one dataset version. A plant is evaluated by its recorded
        proof; an earlier champion passes. A trained policy is evaluated by its recorded error while it stays at a target.

        Args:
            policy: for networks; default: no worse than the champion.
            path: the policy's file, for the record and for messages.
            word: the user's reason to promote it regardless of the checks.
            dataset: to evaluate networks on; default: the one that this version was fitted on.

        Raises:
            StoreError: no such version, or its dataset is missing.
            SettingsError: a policy that does not fit the version.
            ExcitationError: the dataset has no rows to evaluate it on, and no ``word`` is given.
        """
        version = self.workspace.models.find(reference)
        champion = self.workspace.models.promoted(version.name)
        if version.kind not in NETWORKS:
            if path is not None:
                raise SettingsError(f"--policy {path}", f"{version.reference} is a {version.kind}", "a network", _PLANTS)
            checks = _policy_check(version, champion) if version.kind == "policy" else _plant_check(version)
            return decide(self.workspace.models, version.reference, champion, checks, {"by": "sysid models promote"}, word)
        rules = policy or PromotionPolicy()
        try:
            data = self._dataset(version, dataset)
            other = None
            if champion is not None and champion.reference != version.reference:
                other = self.workspace.validation(champion.reference, data)
            checks = policy_checks(rules, self.workspace.validation(version.reference, data), other, path or "policy")
            judged = evaluated_by(rules, version.kind, path, data.reference)
        except (ExcitationError, StoreError) as reason:
            if not word:
                raise
            checks, judged = (Check("figures", "failed", f"not evaluated: {reason}"),), {"by": "nothing"}
        return decide(self.workspace.models, version.reference, champion, checks, judged, word)

    def lineage(self, reference: str) -> ModelLineage:
        """The sources of a version, to the raw files, and what was made from it."""
        version = self.workspace.models.find(reference)
        return lineage_of(version, self.workspace.models.list(), self.workspace.datasets, self._uses(version))

    def diff(self, before: str, after: str) -> ModelDiff:
        """The differences of two versions."""
        return diff_versions(self.workspace.models.load(before), self.workspace.models.load(after))

    def drift(self, reference: str, dataset: Dataset) -> DriftReport:
        """Test for drift on the recordings of ``dataset`` that are not in the network's own dataset.

        Raises:
            StoreError: the dataset that it was fitted on is missing.
            ExcitationError: no such recording measures what it predicts.
        """
        version = self.workspace.models.find(reference)
        return drift_of(self.workspace.network(version.reference), self._dataset(version), dataset, version.reference)

    def export(
        self, reference: str, folder: Path | None = None, precision: Precision = "float32"
    ) -> tuple[Path, tuple[ExportedFile, ...]]:
        """Write a network as ONNX; default folder: ``exports/NAME@V`` of the workspace."""
        version = self.workspace.models.find(reference)
        target = folder or self.workspace.output(f"exports/{version.reference}")
        about = {"reference": version.reference, "digest": version.digest}
        policy = version.kind == "policy"
        network = self.workspace.policy(version.reference) if policy else self.workspace.network(version.reference)
        return target, export_onnx(network, target, about, precision)

    def card(self, reference: str) -> Card:
        """The card of a version, with what it changes against the version before."""
        version = self.workspace.models.find(reference)
        network = self.workspace.network(version.reference) if version.kind in NETWORKS else None
        policy = self.workspace.policy(version.reference) if version.kind == "policy" else None
        units = self._units(str(version.lineage.get("dataset", ""))) if version.kind == "plant" else {}
        card = card_of(version, self.lineage(version.reference), network, self._report(version), policy, units)
        changed = self._changed(version)
        return card if changed is None else replace(card, blocks=(card.blocks[0], changed, *card.blocks[1:]))

    def _units(self, dataset: str) -> Mapping[str, str]:
        """Signal → SI unit; none where the dataset version is not stored any more."""
        name, _, number = dataset.rpartition("@")
        try:
            units: Mapping[str, str] = VersionIndex(self.workspace.location).read_manifest(name, int(number))["units"]
        except (StoreError, ValueError):
            return {}
        return units

    def _changed(self, version: ModelVersion) -> CardBlock | None:
        """What it changes against the version before; None without one that can be read."""
        found = self.workspace.models.survey(version.kind)
        same = [entry for entry in found if isinstance(entry, ModelVersion) and entry.name == version.name]
        earlier = [entry for entry in same if entry.version < version.version]
        if not earlier:
            return None
        try:
            return changes(self.diff(max(earlier, key=lambda entry: entry.version).reference, version.reference))
        except StoreError:  # its files were changed
            return None

    def _report(self, version: ModelVersion) -> ValidationReport | None:
        """The evaluation on the dataset that it was fitted on; None if that is not available."""
        if version.kind not in NETWORKS:
            return None
        try:
            return self.workspace.validation(version.reference, self._dataset(version))
        except (StoreError, ExcitationError):
            return None

    def _dataset(self, version: ModelVersion, reference: str | None = None) -> Dataset:
        """The dataset version that a network was fitted on, by digest, or a named one.

        Raises:
            StoreError: it is missing, or another dataset has its name.
        """
        if reference is not None:
            return self.workspace.dataset(reference)
        named, digest = version.lineage.get("dataset"), version.lineage.get("dataset_digest")
        if not isinstance(named, str):
            raise StoreError(f"model {version.reference}", "its lineage names no dataset version", "one to evaluate it on")
        dataset = self.workspace.dataset(named)
        if digest not in (None, dataset.digest):
            found = f"{named} has digest {dataset.digest[:12]}…"
            raise StoreError(f"model {version.reference}", found, f"{str(digest)[:12]}…, which it was fitted on")
        return dataset

    def _uses(self, version: ModelVersion) -> tuple[ResultUse, ...]:
        """Gap results that tested or created this version."""
        found = []
        for dataset in self.workspace.root.entries("results"):
            try:
                values = parse_json(self.workspace.root.read(f"results/{dataset}/gap/{RESULT}"))
                roles = (("tested it", values["plant"]["before"]), ("created it", values["plant"]["after"]))
            except (OSError, ValueError, KeyError, TypeError, StoreError):
                continue  # damaged, or a link: reported by the commands that use the result
            found += [ResultUse("gap result", dataset, how) for how, plant in roles if plant == version.reference]
        return tuple(found)


def _policy_check(version: ModelVersion, champion: ModelVersion | None) -> tuple[Check, ...]:
    """The check of a trained policy: its error while it stays at a target may not exceed the champion's."""
    own = _hold_error(version)
    if own is None:
        return (Check("staying at a target", "failed", "no figures are recorded with it"),)
    other = _hold_error(champion) if champion is not None and champion.reference != version.reference else None
    if champion is None or other is None:
        return (Check("staying at a target", "passed", f"error {quantity(own, 'm', 4)}; there is no champion to compare with"),)
    text = f"error {quantity(own, 'm', 4)}, {champion.reference} {quantity(other, 'm', 4)}"
    return (Check("staying at a target", "passed" if own <= other else "failed", text),)


def _hold_error(version: ModelVersion) -> float | None:
    """RMS distance of a policy from a target at which it stays [m]; None if it is not recorded."""
    figures = [version.metrics.get(f"hold_rmse_{axis}") for axis in "xyz"]
    return math.sqrt(sum(value**2 for value in figures if value is not None)) if None not in figures else None


_PLANTS = "Plants are evaluated by the proof of `sysid gap --add`."


def _plant_check(version: ModelVersion) -> tuple[Check, ...]:
    """The recorded checks of a plant: an earlier champion passes, a plant without a proof fails."""
    if any(decision.promoted for decision in version.decisions):
        return (Check("promoted before", "passed", f"{version.reference} was promoted before"),)
    if version.decisions:
        return version.decisions[-1].checks
    return (Check("proof", "failed", f"no proof of {version.reference} is recorded; {_PLANTS}"),)
