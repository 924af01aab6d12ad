"""Register, load, list and promote model versions.

A version has ``files`` (safetensors and JSON), a ``kind`` and a ``lineage``. MLflow's registry holds the number, the aliases
and, as tags, the manifest with the sha256 of every file. Files are written first, rows last in one transaction, so that a crash
leaves no partial version. Registering equal content with equal lineage again returns the existing version.
"""

from __future__ import annotations

import builtins
import functools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from sysid.errors import SettingsError, StorageError, StoreError, nearest
from sysid.names import check_name
from sysid.registry.artifacts import FolderArtifacts, RunArtifacts, checked
from sysid.registry.client import SQLITE, disk_errors
from sysid.registry.entries import broken_model, check_stored_name, decision_key, kind_of, sealed, version_of
from sysid.registry.promotion import Check, Promotion, PromotionDecision, now_ms
from sysid.registry.repair import RepairReport, repair
from sysid.registry.server import ServerTables
from sysid.registry.stored import DIGEST, MANIFEST, METRICS, ModelChange, Record, StoredModel, StoredVersion
from sysid.registry.tables import WorkspaceTables
from sysid.registry.version import (
    CANDIDATE,
    CHAMPION,
    ModelVersion,
    check_files,
    check_kind,
    choose,
    manifest,
    sha256,
    split_reference,
)

#: Environment variable with the address of an MLflow server to use in place of the workspace's own registry.
URI_VARIABLE = "SYSID_REGISTRY_URI"


@dataclass(frozen=True)
class DamagedModel:
    """A version or model in the registry that does not match its seal or digest, with the reason."""

    reference: str
    error: StoreError


class Registry:
    """Model versions of one workspace, or of a shared MLflow server.

    Args:
        workspace: holds ``registry.db`` (sqlite), ``models/<digest>/`` (files) and ``registry.lock``.
        uri: an MLflow registry (``https://…``, ``postgresql://…``), where files are artifacts of MLflow runs. Default: the
            environment variable ``SYSID_REGISTRY_URI``, else the sqlite file of the workspace.
        wait_s: time limit for the lock of another process.
    """

    def __init__(self, workspace: Path, uri: str | None = None, wait_s: float = 30.0) -> None:
        self._workspace, self._wait_s = Path(workspace), wait_s
        given = uri or os.environ.get(URI_VARIABLE) or None
        self.uri = given or f"{SQLITE}{(self._workspace / 'registry.db').resolve()}"
        self.server = ServerTables(self._workspace, given, wait_s) if given is not None else None
        self._tables = self.server or WorkspaceTables(self._workspace, wait_s)

    def register(
        self,
        name: str,
        kind: str,
        files: Mapping[str, bytes],
        lineage: Mapping[str, Any],
        metrics: Mapping[str, float] | None = None,
    ) -> ModelVersion:
        """Add a version of ``name``, or return the existing one with the same files, kind and lineage.

        Args:
            files: file name → content, ``.safetensors`` or ``.json``.
            lineage: its sources, as plain JSON values.
            metrics: its figures; kept from the first registration of equal content.

        Raises:
            SettingsError: a name, kind, file or lineage that cannot be stored.
            StoreError: the registry is locked or unreachable; the name belongs to another kind.
            StorageError: the disk is full or read-only; nothing is registered.
        """
        place = f"model {check_name(name)}"
        check_kind(kind)
        check_files(files, place)
        text = manifest(kind, {file: sha256(files[file]) for file in sorted(files)}, lineage, place)
        figures = json.dumps({key: float(value) for key, value in (metrics or {}).items()})
        digest = sha256(text.encode("utf-8"))

        def build(model: StoredModel) -> ModelChange | None:
            known = kind_of(self._checked(model))
            if known not in (None, kind):
                raise StoreError(
                    place,
                    f"already registered as kind {known!r}",
                    f"kind {kind!r}",
                    "Choose another name for this model.",
                )
            same = next((entry for entry in model.own if entry.tags[DIGEST] == digest), None)
            if same is not None and self.server is not None:
                return None
            tags = {DIGEST: digest, MANIFEST: text, METRICS: figures}
            new = same or StoredVersion(model.last + 1, now_ms(), "", tags)
            # In the workspace, equal content is written again: this repairs damaged files, and else changes nothing.
            with disk_errors(self._workspace):
                source, run = self._artifacts.write(digest, files, text, Record.of(name, new))
            if same is not None:
                return None
            return self._sealed(model, ModelChange(replace(new, source=source), run, aliases={CANDIDATE: new.number}))

        model = self._tables.change(name, build)
        return version_of(model, next(entry for entry in model.own if entry.tags[DIGEST] == digest))

    def load(self, reference: str) -> ModelVersion:
        """The version with its files, each checked against its registered sha256.

        Args:
            reference: ``name`` (the champion, or the newest if there is none), ``name@3`` or ``name@champion``.

        Raises:
            StoreError: no such version, or a file that is missing or was changed.
        """
        version, source = self._find(reference)
        files = {}
        for file, expected in version.sha256.items():
            content = self._artifacts.read(version.digest, source, file)
            files[file] = checked(content, expected, f"{version.reference}: {file}")
        return replace(version, files=files)

    def find(self, reference: str) -> ModelVersion:
        """The version without its files."""
        return self._find(reference)[0]

    def list(self, kind: str | None = None) -> tuple[ModelVersion, ...]:
        """Every version, by name and number, without files; of one ``kind`` if given.

        Raises:
            StoreError: one of them was changed by hand; :meth:`survey` lists the others.
        """
        found = self.survey(kind)
        for entry in found:
            if isinstance(entry, DamagedModel):
                raise entry.error
        return tuple(entry for entry in found if isinstance(entry, ModelVersion))

    def survey(self, kind: str | None = None) -> tuple[ModelVersion | DamagedModel, ...]:
        """As :meth:`list`, with damaged entries, whose kind is unknown, in their places."""
        if kind is not None:
            check_kind(kind)
        found: builtins.list[ModelVersion | DamagedModel] = []
        for model in self._tables.models():
            found += _surveyed(model, self._tables.seals_aliases)
        return tuple(entry for entry in found if isinstance(entry, DamagedModel) or kind in (None, entry.kind))

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """Every version of one model, oldest first; empty if there is no such model.

        Raises:
            StoreError: one of them was changed by hand.
        """
        model = self._model(check_name(name))
        return tuple(version_of(model, entry) for entry in model.own)

    def promoted(self, name: str) -> ModelVersion | None:
        """The champion of ``name``; None if none was promoted, or there is no such model."""
        model = self._model(check_name(name))
        number = model.aliases.get(CHAMPION)
        return next((version_of(model, entry) for entry in model.own if entry.number == number), None)

    def promote(
        self,
        reference: str,
        *,
        instead_of: ModelVersion | Literal["any"] | None = "any",
        decision: PromotionDecision | None = None,
    ) -> ModelVersion:
        """Make this version the champion: the name alone then refers to it. It is no longer a candidate.

        Args:
            instead_of: the champion that the decision was compared with (None: there was none).
            decision: recorded with the version.

        Raises:
            StoreError: no such version, or the champion is another one than ``instead_of``.
        """
        name, _ = split_reference(reference)

        def build(model: StoredModel, version: ModelVersion) -> ModelChange:
            number, champion = version.version, model.aliases.get(CHAMPION)
            if instead_of != "any" and champion != (instead_of and instead_of.version):
                now, expected = (f"{name}@{n}" if n else "no version" for n in (champion, instead_of and instead_of.version))
                remedy = "It was changed in the meantime; check it and decide again."
                raise StoreError(f"{name}@{CHAMPION}", f"means {now}", expected, remedy)
            aliases: dict[str, int | None] = {CHAMPION: number}
            if model.aliases.get(CANDIDATE) == number:
                aliases[CANDIDATE] = None
            tags = _decision_tag(version, decision) if decision is not None else {}
            return ModelChange(version_tags=tags, aliases=aliases)

        return self._changed(reference, build)

    def record(self, reference: str, decision: PromotionDecision) -> ModelVersion:
        """Store a decision with a version, unless it equals the last one."""

        def build(model: StoredModel, version: ModelVersion) -> ModelChange | None:
            tags = _decision_tag(version, decision)
            return ModelChange(version_tags=tags) if tags else None

        return self._changed(reference, build)

    def _changed(self, reference: str, build: Callable[[StoredModel, ModelVersion], ModelChange | None]) -> ModelVersion:
        """A version after the change of its model that ``build`` returns."""
        number = 0

        def sealed_change(model: StoredModel) -> ModelChange | None:
            nonlocal number
            version = self._chosen(model, reference)[0]
            number = version.version
            change = build(model, version)
            return None if change is None else self._sealed(model, change)

        name, _ = split_reference(reference)
        model = self._tables.change(name, sealed_change)
        return self._chosen(model, f"{name}@{number}")[0]

    def repair(self, accept: bool = False) -> RepairReport:
        """Repair the registry of the workspace: see :func:`sysid.registry.repair.repair`.

        Raises:
            SettingsError: the registry is on a server.
        """
        if self.server is not None:
            raise SettingsError(f"model registry {self.uri}", "on a server", "one of a workspace", "The server maintains it.")
        return repair(self._workspace, accept, self._wait_s)

    @functools.cached_property
    def _artifacts(self) -> FolderArtifacts | RunArtifacts:
        if self.server is not None:
            return RunArtifacts(self.server.client, self.uri)
        return FolderArtifacts(self._workspace / "models")

    def _sealed(self, model: StoredModel, change: ModelChange) -> ModelChange:
        return sealed(model, change, self._tables.seals_aliases)

    def _model(self, name: str) -> StoredModel:
        return self._checked(self._tables.model(name))

    def _checked(self, model: StoredModel) -> StoredModel:
        """Raise where aliases or the list of versions were changed by hand."""
        broken = broken_model(model) if self._tables.seals_aliases else None
        if broken is not None:
            raise broken
        return model

    def _find(self, reference: str) -> tuple[ModelVersion, str]:
        name, _ = split_reference(reference)
        return self._chosen(self._tables.model(name), reference)

    def _chosen(self, model: StoredModel, reference: str) -> tuple[ModelVersion, str]:
        """The version of ``model`` that ``reference`` selects, and the location of its files."""
        name, selector = split_reference(reference)
        if not model.own:
            known = [other.name for other in self._tables.models() if other.own]
            raise StoreError(f"model registry {self.uri}", f"no model {name!r}", nearest(name, known))
        self._checked(model)
        number = choose([entry.number for entry in model.own], model.aliases, name, selector)
        entry = next(entry for entry in model.own if entry.number == number)
        return version_of(model, entry), entry.source


def _surveyed(model: StoredModel, aliases: bool) -> builtins.list[ModelVersion | DamagedModel]:
    """All versions of a model, preceded by damage of the model as a whole."""
    found: builtins.list[ModelVersion | DamagedModel] = []
    if not model.own and not aliases:
        return found  # of another program, on a shared server
    try:
        check_stored_name(model)
    except StoreError as error:
        return [DamagedModel(model.name, error)]
    broken = broken_model(model) if aliases else None
    if broken is not None:
        found.append(DamagedModel(model.name, broken))
        model = replace(model, aliases={})  # they are not reliable
    for entry in model.own:
        try:
            found.append(version_of(model, entry))
        except StoreError as error:
            found.append(DamagedModel(f"{model.name}@{entry.number}", error))
    return found


def _decision_tag(version: ModelVersion, decision: PromotionDecision) -> dict[int, dict[str, str | None]]:
    """The tag of a decision; empty if it equals the last one."""
    if version.decisions and version.decisions[-1].same(decision):
        return {}
    return {version.version: {decision_key(decision): decision.to_text()}}


def decide(
    registry: Registry,
    version: str,
    champion: ModelVersion | None,
    checks: Sequence[Check],
    judged: Mapping[str, Any] | None = None,
    word: str = "",
) -> Promotion:
    """Promote a stored version if all checks pass, and record the decision with it.

    Args:
        version: ``name@version``.
        champion: the champion when the checks were made.
        judged: basis of the decision, for the record.
        word: the user's reason to promote it regardless of the checks; recorded.

    Raises:
        StorageError: the disk is full or read-only.
    """
    previous = champion.reference if champion is not None else ""
    reason = "; ".join(check.text for check in checks if check.status == "failed")
    promoted = bool(word) or not reason
    decision = PromotionDecision(promoted, previous, tuple(checks), reason, word, dict(judged or {}), now_ms())
    if not promoted:
        registry.record(version, decision)
        return Promotion(version, previous, previous, tuple(checks), reason)
    if version != previous:
        try:
            registry.promote(version, instead_of=champion, decision=decision)
        except StorageError:
            raise
        except StoreError as error:  # another champion was set in the meantime
            now = registry.promoted(version.partition("@")[0])
            return Promotion(version, now.reference if now else "", previous, tuple(checks), str(error))
    return Promotion(version, version, previous, tuple(checks))
