"""What can be asked and decided about the model versions of a workspace: promote, follow, compare, hand on.

:mod:`sysid.versions` does the work on values; this finds the datasets, models and results that it is about.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from sysid.datasets import Dataset
from sysid.errors import ExcitationError, SettingsError, StoreError
from sysid.parse import parse_json
from sysid.registry import NETWORKS, Check, ModelVersion, Promotion, decide
from sysid.reports.archive import RESULT
from sysid.validate import ValidationReport
from sysid.versions import (
    Card,
    DriftReport,
    Exported,
    ModelDiff,
    ModelLineage,
    PromotionPolicy,
    card_of,
    diff_versions,
    drift_of,
    export_onnx,
    lineage_of,
    policy_checks,
)
from sysid.versions.lineage import Use
from sysid.versions.onnx_export import Precision
from sysid.versions.policy import evaluated_by
from sysid.workspace import Workspace


@dataclass(frozen=True)
class ModelVersions:
    """The model versions of one workspace.

    >>> versions = ModelVersions(open_workspace("./workspace"))
    >>> versions.promote("autolog-forward@3", load_policy(Path("policy.toml"))).promoted
    """

    place: Workspace

    def promote(
        self,
        reference: str,
        policy: PromotionPolicy | None = None,
        path: Path | None = None,
        word: str = "",
        dataset: str | None = None,
    ) -> Promotion:
        """Let the name alone mean this version, if it passes; recorded with it either way.

        A network is evaluated by the policy, on the held-out rows of one dataset version; a plant by the proof that is recorded
        with it, and one that was in use before may be set back; a policy by how far off it stays from targets.

        Args:
            policy: for networks; default: no worse than the champion.
            path: the policy's file, for the record and for messages.
            word: promotes it whatever the checks say.
            dataset: to evaluate networks on; default: the one that this version was fitted on.

        Raises:
            StoreError: no such version, or a dataset that is gone.
            SettingsError: a policy that does not fit the version.
            ExcitationError: the dataset has nothing to evaluate it on, and there is no word.
        """
        version = self.place.models.find(reference)
        until_now = self.place.models.promoted(version.name)
        if version.kind not in NETWORKS:
            if path is not None:
                raise SettingsError(f"--policy {path}", f"{version.reference} is a {version.kind}", "a network", _PLANTS)
            checks = _trained(version, until_now) if version.kind == "policy" else _proven(version)
            return decide(self.place.models, version.reference, until_now, checks, {"by": "sysid models promote"}, word)
        rules = policy or PromotionPolicy()
        try:
            data = self._dataset(version, dataset)
            checks = self._evaluated(version, until_now, rules, data, path or "policy")
            judged = evaluated_by(rules, version.kind, path, data.reference)
        except (ExcitationError, StoreError) as reason:
            if not word:
                raise
            checks, judged = (Check("figures", "failed", f"not evaluated: {reason}"),), {"by": "nothing"}
        return decide(self.place.models, version.reference, until_now, checks, judged, word)

    def lineage(self, reference: str) -> ModelLineage:
        """Where a version comes from, to the raw files, and what came of it."""
        version = self.place.models.find(reference)
        return lineage_of(version, self.place.models.list(), self.place.datasets, self._uses(version))

    def diff(self, before: str, after: str) -> ModelDiff:
        """How two versions differ."""
        return diff_versions(self.place.models.load(before), self.place.models.load(after))

    def drift(self, reference: str, dataset: Dataset) -> DriftReport:
        """Whether a network still fits the machine, by the recordings of ``dataset`` that are new to it.

        Raises:
            StoreError: the dataset that it was fitted on is gone.
            ExcitationError: nothing in ``dataset`` is new to it and measures what it predicts.
        """
        version = self.place.models.find(reference)
        return drift_of(self.place.network(version.reference), self._dataset(version), dataset, version.reference)

    def export(
        self, reference: str, folder: Path | None = None, precision: Precision = "float32"
    ) -> tuple[Path, tuple[Exported, ...]]:
        """Write a network as ONNX; default folder: ``exports/NAME@V`` of the workspace."""
        version = self.place.models.find(reference)
        target = folder or self.place.output(f"exports/{version.reference}")
        about = {"reference": version.reference, "digest": version.digest}
        policy = version.kind == "policy"
        network = self.place.policy(version.reference) if policy else self.place.network(version.reference)
        return target, export_onnx(network, target, about, precision)

    def card(self, reference: str) -> Card:
        """What there is to know of a version, on one page."""
        version = self.place.models.find(reference)
        network = self.place.network(version.reference) if version.kind in NETWORKS else None
        policy = self.place.policy(version.reference) if version.kind == "policy" else None
        return card_of(version, self.lineage(version.reference), network, self._report(version), policy)

    def _report(self, version: ModelVersion) -> ValidationReport | None:
        """On the dataset that it was fitted on; None where that cannot be had."""
        if version.kind not in NETWORKS:
            return None
        try:
            return self.place.validation(version.reference, self._dataset(version))
        except (StoreError, ExcitationError):
            return None

    def _evaluated(
        self, version: ModelVersion, until_now: ModelVersion | None, policy: PromotionPolicy, data: Dataset, where: object
    ) -> tuple[Check, ...]:
        rival = None
        if until_now is not None and until_now.reference != version.reference:
            rival = self.place.validation(until_now.reference, data)
        return policy_checks(policy, self.place.validation(version.reference, data), rival, where)

    def _dataset(self, version: ModelVersion, reference: str | None = None) -> Dataset:
        """The dataset version that a network was fitted on, by digest, or a named one.

        Raises:
            StoreError: it is gone, or its name means another one here.
        """
        if reference is not None:
            return self.place.dataset(reference)
        named, digest = version.lineage.get("dataset"), version.lineage.get("dataset_digest")
        if not isinstance(named, str):
            raise StoreError(f"model {version.reference}", "its lineage names no dataset version", "one to evaluate it on")
        dataset = self.place.dataset(named)
        if digest not in (None, dataset.digest):
            found = f"{named} has digest {dataset.digest[:12]}… here"
            raise StoreError(f"model {version.reference}", found, f"{str(digest)[:12]}…, which it was fitted on")
        return dataset

    def _uses(self, version: ModelVersion) -> tuple[Use, ...]:
        """Answers of the gap workflow that questioned or made this version, or whose plant rests on it."""
        found = []
        for dataset in self.place.root.entries("results"):
            try:
                values = parse_json(self.place.root.read(f"results/{dataset}/gap/{RESULT}"))
                roles = (("questioned it", values["plant"]["before"]), ("made it", values["plant"]["after"]))
            except (OSError, ValueError, KeyError, TypeError, StoreError):
                continue  # damaged, or a link: `sysid gap` says so where it is read for what is in it
            found += [Use("gap result", dataset, how) for how, plant in roles if plant == version.reference]
        return tuple(found)


def _trained(version: ModelVersion, until_now: ModelVersion | None) -> tuple[Check, ...]:
    """Of a policy: staying at a target, it may not be farther off than the one in use."""
    own = _off(version)
    if own is None:
        return (Check("staying at a target", "failed", "no figures are recorded with it"),)
    rival = _off(until_now) if until_now is not None and until_now.reference != version.reference else None
    if until_now is None or rival is None:
        return (Check("staying at a target", "passed", f"{1e3 * own:.2f} mm off, and nothing to compare it with"),)
    told = f"{1e3 * own:.2f} mm off, {until_now.reference} {1e3 * rival:.2f} mm"
    return (Check("staying at a target", "passed" if own <= rival else "failed", told),)


def _off(version: ModelVersion) -> float | None:
    """Root mean square distance from a target at which a policy stays [m]; None where it is not recorded."""
    figures = [version.metrics.get(f"hold_rmse_{axis}") for axis in "xyz"]
    return math.sqrt(sum(value**2 for value in figures if value is not None)) if None not in figures else None


_PLANTS = "Plants are evaluated by the proof of `sysid gap --add`."


def _proven(version: ModelVersion) -> tuple[Check, ...]:
    """What is recorded of a plant or policy: it was in use before, or its proof failed, or nothing was ever asked of it."""
    if any(decision.promoted for decision in version.decisions):
        return (Check("in use before", "passed", f"{version.reference} was promoted before"),)
    if version.decisions:
        return version.decisions[-1].checks
    return (Check("proof", "failed", f"nothing is recorded that speaks for {version.reference}; {_PLANTS}"),)
