"""Register, load, list and alias model versions. Files first, rows last in one transaction: a crash leaves nothing half done.

A version is made of ``files`` (safetensors and JSON), a ``kind`` and a ``lineage``. MLflow's registry holds the number, the
aliases and, as tags, the manifest with the sha256 of every file. Registering the same content with the same lineage again
returns the version that is already there.
"""

from __future__ import annotations

import builtins
import functools
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from sysid.errors import SettingsError, StoreError, nearest
from sysid.names import check_name
from sysid.registry.artifacts import ArtifactStore, FolderArtifacts, RunArtifacts, checked
from sysid.registry.client import SQLITE, written
from sysid.registry.decision import PromotionDecision, now_ms
from sysid.registry.entries import aliases_of, check_model, check_stored_name, decision_key, kind_of, version_of
from sysid.registry.record import Record
from sysid.registry.repair import RepairReport, repair
from sysid.registry.seal import sealed
from sysid.registry.server import ServerTables
from sysid.registry.stored import DIGEST, MANIFEST, METRICS, ModelChange, StoredModel, StoredVersion, Tables
from sysid.registry.tables import WorkspaceTables
from sysid.registry.version import (
    CANDIDATE,
    CHAMPION,
    ModelVersion,
    check_alias,
    check_files,
    check_kind,
    choose,
    manifest,
    sha256,
    split_reference,
)

#: Environment variable with the address of an MLflow server that is used instead of the workspace's own registry.
URI_VARIABLE = "SYSID_REGISTRY_URI"


@dataclass(frozen=True)
class DamagedModel:
    """A row of the registry that cannot be shown as true: of which version or model, and why."""

    reference: str
    error: StoreError


class Registry:
    """Model versions of one workspace, or of an MLflow server that several people share.

    Args:
        workspace: holds ``registry.db`` (sqlite), ``models/<digest>/`` (files) and ``registry.lock``.
        uri: any MLflow registry instead (``https://…``, ``postgresql://…``); files then become artifacts of MLflow runs
            there. Default: the environment variable ``SYSID_REGISTRY_URI``, else the sqlite file of the workspace.
        wait_s: how long to wait for another process before giving up.
    """

    def __init__(self, workspace: Path, uri: str | None = None, wait_s: float = 30.0) -> None:
        self._workspace, self._wait_s = Path(workspace), wait_s
        given = uri or os.environ.get(URI_VARIABLE) or None
        self.uri = given or f"{SQLITE}{(self._workspace / 'registry.db').resolve()}"
        self._server = ServerTables(self._workspace, given, wait_s) if given is not None else None
        self._tables: Tables = self._server or WorkspaceTables(self._workspace, wait_s)

    def register(
        self,
        name: str,
        kind: str,
        files: Mapping[str, bytes],
        lineage: Mapping[str, Any],
        metrics: Mapping[str, float] | None = None,
    ) -> ModelVersion:
        """A new version of ``name``, or the existing one with the same files, kind and lineage.

        Args:
            files: file name → content, ``.safetensors`` or ``.json``.
            lineage: what it was made from, as plain JSON values.
            metrics: figures to show beside it; kept from the first registration of equal content.

        Raises:
            SettingsError: a name, kind, file or lineage that cannot be stored.
            StoreError: the registry is locked or cannot be reached; the name belongs to another kind.
            StorageError: the disk is full, or may not be written; nothing is registered then.
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
            if same is not None and self._server is not None:
                return None
            tags = {DIGEST: digest, MANIFEST: text, METRICS: figures}
            new = same or StoredVersion(model.last + 1, now_ms(), "", tags)
            # For the workspace's own folder the write is repeated: it is free when all is well and repairs damaged files.
            with written(self._workspace):
                source, run = self._artifacts.write(digest, files, text, Record.of(name, new))
            if same is not None:
                return None
            return self._sealed(model, ModelChange(replace(new, source=source), run, aliases={CANDIDATE: new.number}))

        model = self._tables.change(name, build)
        return version_of(model, next(entry for entry in model.own if entry.tags[DIGEST] == digest))

    def load(self, reference: str) -> ModelVersion:
        """The version with its files, each checked against its registered sha256 before anything reads it.

        Args:
            reference: ``name`` (the promoted version, or the newest where none is), ``name@3`` or ``name@champion``.

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

    def lineage(self, reference: str) -> Mapping[str, Any]:
        """What the version was made from."""
        return self.find(reference).lineage

    def list(self, kind: str | None = None) -> tuple[ModelVersion, ...]:
        """Every version, by name and number, without files; of one ``kind`` if given.

        Raises:
            StoreError: one of them was changed after it was recorded; :meth:`survey` shows the others.
        """
        found = self.survey(kind)
        for entry in found:
            if isinstance(entry, DamagedModel):
                raise entry.error
        return tuple(entry for entry in found if isinstance(entry, ModelVersion))

    def survey(self, kind: str | None = None) -> tuple[ModelVersion | DamagedModel, ...]:
        """As :meth:`list`, with what cannot be shown as true in its place: the kind of that is not known."""
        if kind is not None:
            check_kind(kind)
        found: builtins.list[ModelVersion | DamagedModel] = []
        for model in self._tables.models():
            found += _surveyed(model, self._tables.seals_aliases)
        return tuple(entry for entry in found if isinstance(entry, DamagedModel) or kind in (None, entry.kind))

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """Every version of one model, oldest first; none where there is no such model.

        Raises:
            StoreError: one of them was changed after it was recorded.
        """
        model = self._model(check_name(name))
        return tuple(version_of(model, entry) for entry in model.own)

    def promoted(self, name: str) -> ModelVersion | None:
        """The version that ``name`` alone means because it was promoted; None where none was, or there is no such model."""
        model = self._model(check_name(name))
        number = aliases_of(model).get(CHAMPION)
        return next((version_of(model, entry) for entry in model.own if entry.number == number), None)

    def promote(
        self, reference: str, *, instead_of: ModelVersion | None, decision: PromotionDecision | None = None
    ) -> ModelVersion:
        """Let the name alone mean this version from now on; the others stay.

        Args:
            instead_of: the promoted version that was looked at when this was decided (None: there was none).
            decision: recorded with the version.

        Raises:
            StoreError: another one was promoted in the meantime, so that the decision is about something that is no more.
        """
        return self.set_alias(reference, CHAMPION, instead_of=instead_of, decision=decision)

    def record(self, reference: str, decision: PromotionDecision) -> ModelVersion:
        """Keep a decision with a version; one that says what the last one said is not repeated."""
        name, _ = split_reference(reference)
        number = 0

        def build(model: StoredModel) -> ModelChange | None:
            nonlocal number
            version = self._chosen(model, reference)[0]
            number = version.version
            tags = _decided(version, decision)
            return self._sealed(model, ModelChange(version_tags=tags)) if tags else None

        model = self._tables.change(name, build)
        return self._chosen(model, f"{name}@{number}")[0]

    def set_alias(
        self,
        reference: str,
        alias: str,
        *,
        instead_of: ModelVersion | Literal["any"] | None = "any",
        decision: PromotionDecision | None = None,
    ) -> ModelVersion:
        """Let ``name@alias`` mean this version from now on. A champion is a candidate no longer.

        Args:
            instead_of: the version that the alias has to mean until now (None: no version).
            decision: recorded with the version.

        Raises:
            StoreError: no such version, or the alias means another one than ``instead_of``.
        """
        check_alias(alias)
        name, _ = split_reference(reference)
        number = 0

        def build(model: StoredModel) -> ModelChange:
            nonlocal number
            version = self._chosen(model, reference)[0]
            number = version.version
            meant = aliases_of(model)
            if instead_of != "any" and meant.get(alias) != (instead_of and instead_of.version):
                now, expected = (
                    f"{name}@{n}" if n else "no version" for n in (meant.get(alias), instead_of and instead_of.version)
                )
                raise StoreError(
                    f"{name}@{alias}",
                    f"means {now}",
                    expected,
                    "It was changed in the meantime; look at it and decide again.",
                )
            aliases: dict[str, int | None] = {alias: number}
            if alias == CHAMPION and meant.get(CANDIDATE) == number:
                aliases[CANDIDATE] = None
            tags = _decided(version, decision) if decision is not None else {}
            return self._sealed(model, ModelChange(version_tags=tags, aliases=aliases))

        model = self._tables.change(name, build)
        return self._chosen(model, f"{name}@{number}")[0]

    def repair(self, accept: bool = False) -> RepairReport:
        """Mend the registry of the workspace: see :func:`sysid.registry.repair.repair`.

        Raises:
            SettingsError: the registry is on a server.
        """
        if self._server is not None:
            raise SettingsError(f"model registry {self.uri}", "on a server", "one of a workspace", "Its server looks after it.")
        return repair(self._workspace, accept, self._wait_s)

    @functools.cached_property
    def _artifacts(self) -> ArtifactStore:
        if self._server is not None:
            return RunArtifacts(self._server.client, self.uri)
        return FolderArtifacts(self._workspace / "models")

    def _sealed(self, model: StoredModel, change: ModelChange) -> ModelChange:
        return sealed(model, change, self._tables.seals_aliases)

    def _model(self, name: str) -> StoredModel:
        return self._checked(self._tables.model(name))

    def _checked(self, model: StoredModel) -> StoredModel:
        if self._tables.seals_aliases:
            check_model(model)
        return model

    def _find(self, reference: str) -> tuple[ModelVersion, str]:
        name, _ = split_reference(reference)
        return self._chosen(self._tables.model(name), reference)

    def _chosen(self, model: StoredModel, reference: str) -> tuple[ModelVersion, str]:
        """The version of ``model`` that ``reference`` means, and where its files lie."""
        name, selector = split_reference(reference)
        if not model.own:
            known = [other.name for other in self._tables.models() if other.own]
            raise StoreError(f"model registry {self.uri}", f"no model {name!r}", nearest(name, known))
        self._checked(model)
        number = choose([entry.number for entry in model.own], aliases_of(model), name, selector)
        entry = next(entry for entry in model.own if entry.number == number)
        return version_of(model, entry), entry.source


def _surveyed(model: StoredModel, aliases: bool) -> builtins.list[ModelVersion | DamagedModel]:
    """All versions of a model, and before them what is wrong with the model as a whole."""
    found: builtins.list[ModelVersion | DamagedModel] = []
    if not model.own and not aliases:
        return found  # another program's, on a server that is shared
    try:
        check_stored_name(model)
    except StoreError as error:
        return [DamagedModel(model.name, error)]
    if aliases:
        try:
            check_model(model)
        except StoreError as error:
            found.append(DamagedModel(model.name, error))
            model = replace(model, aliases={})  # none of them is to be believed
    for entry in model.own:
        try:
            found.append(version_of(model, entry))
        except StoreError as error:
            found.append(DamagedModel(f"{model.name}@{entry.number}", error))
    return found


def _decided(version: ModelVersion, decision: PromotionDecision) -> dict[int, dict[str, str | None]]:
    """The tag of a decision; nothing where the last one said the same."""
    if version.decisions and version.decisions[-1].same(decision):
        return {}
    return {version.version: {decision_key(decision): decision.to_text()}}
