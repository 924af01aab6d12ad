"""Register, load, list and alias model versions. Files first, registration last: a crash leaves nothing half done.

A version is made of ``files`` (safetensors and JSON), a ``kind`` and a ``lineage``. MLflow's registry holds the number, the
aliases and, as tags, the manifest with the sha256 of every file. Registering the same content with the same lineage again
returns the version that is already there.
"""

from __future__ import annotations

import builtins
import functools
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock, Timeout

from sysid.errors import StoreError, nearest
from sysid.names import check_name
from sysid.registry.artifacts import ArtifactStore, FolderArtifacts, RunArtifacts, checked
from sysid.registry.client import SQLITE, locked, open_client, probe_sqlite, translated, written
from sysid.registry.entries import DIGEST, MANIFEST, METRICS, DamagedVersion, decision_key, entries, model_names
from sysid.registry.promotion import Decision
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
from sysid.root import Root

#: Environment variable with the address of an MLflow server that is used instead of the workspace's own registry.
URI_VARIABLE = "SYSID_REGISTRY_URI"


class Registry:
    """Model versions of one workspace, or of an MLflow server that several people share.

    Args:
        workspace: holds ``registry.db`` (sqlite), ``models/<digest>/`` (files) and ``registry.lock``.
        uri: any MLflow registry instead (``https://…``, ``postgresql://…``); files then become artifacts of MLflow runs
            there. Default: the environment variable ``SYSID_REGISTRY_URI``, else the sqlite file of the workspace.
        wait_s: how long to wait for another process before giving up.
    """

    def __init__(self, workspace: Path, uri: str | None = None, wait_s: float = 30.0) -> None:
        self._workspace = Path(workspace)
        self._database = self._workspace / "registry.db"
        given = uri or os.environ.get(URI_VARIABLE) or None
        self._own = given is None
        self.uri = given or f"{SQLITE}{self._database.resolve()}"
        self._wait_s = wait_s

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
        with self._locked():
            existing = self._versions(name) if self._exists() else []
            if existing and existing[0].kind != kind:
                raise StoreError(
                    place,
                    f"already registered as kind {existing[0].kind!r}",
                    f"kind {kind!r}",
                    "Choose another name for this model.",
                )
            same = [version for version in existing if version.digest == digest]
            if same and not self._own:
                return same[0]
            # For the workspace's own folder the write is repeated: it is free when all is well and repairs damaged files.
            with written(self._workspace):
                source, run = self._artifacts.write(digest, files, text)
            if same:
                return same[0]
            with translated(self.uri):
                self._create_model(name)
                made = self._client.create_model_version(
                    name, source, run_id=run, tags={DIGEST: digest, MANIFEST: text, METRICS: figures}
                )
                self._client.set_registered_model_alias(name, CANDIDATE, str(made.version))
            return next(version for version in self._versions(name) if version.digest == digest)

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
        """Every version that can be read, by name and number, without files; of one ``kind`` if given."""
        if kind is not None:
            check_kind(kind)
        if not self._exists():
            return ()
        self._probe(write=False)
        versions = [version for name in self._names() for version in self._versions(name)]
        return tuple(version for version in versions if kind in (None, version.kind))

    def damaged(self) -> tuple[DamagedVersion, ...]:
        """Every version that cannot be read, with the reason."""
        if not self._exists():
            return ()
        self._probe(write=False)
        with translated(self.uri):
            return tuple(row for name in model_names(self._client) for row in entries(self._client, name)[1])

    def promoted(self, name: str) -> ModelVersion | None:
        """The version that ``name`` alone means because it was promoted; None where none was, or there is no such model."""
        check_name(name)
        if not self._exists():
            return None
        self._probe(write=False)
        self._refuse_damaged(name, CHAMPION)
        return next((version for version in self._versions(name) if CHAMPION in version.aliases), None)

    def promote(self, reference: str, *, instead_of: ModelVersion | None, decision: Decision | None = None) -> ModelVersion:
        """Let the name alone mean this version from now on; the others stay.

        Args:
            instead_of: the promoted version that was looked at when this was decided (None: there was none).
            decision: recorded with the version.

        Raises:
            StoreError: another one was promoted in the meantime, so that the decision is about something that is no more.
        """
        return self.set_alias(reference, CHAMPION, instead_of=instead_of, decision=decision)

    def record(self, reference: str, decision: Decision) -> ModelVersion:
        """Keep a decision with a version; one that says what the last one said is not repeated."""
        with self._locked():
            version = self.find(reference)
            with translated(self.uri):
                self._record(version, decision)
            return self.find(version.reference)

    def set_alias(
        self,
        reference: str,
        alias: str,
        *,
        instead_of: ModelVersion | Literal["any"] | None = "any",
        decision: Decision | None = None,
    ) -> ModelVersion:
        """Let ``name@alias`` mean this version from now on. A champion is a candidate no longer.

        Args:
            instead_of: the version that the alias has to mean until now (None: no version).
            decision: recorded with the version.

        Raises:
            StoreError: no such version, or the alias means another one than ``instead_of``.
        """
        check_alias(alias)
        with self._locked():
            version = self.find(reference)
            if instead_of != "any":
                now = next((entry for entry in self._versions(version.name) if alias in entry.aliases), None)
                if (now and now.version) != (instead_of and instead_of.version):
                    found, expected = (entry.reference if entry else "no version" for entry in (now, instead_of))
                    raise StoreError(
                        f"{version.name}@{alias}",
                        f"means {found}",
                        expected,
                        "It was changed in the meantime; look at it and decide again.",
                    )
            with translated(self.uri):
                if decision is not None:  # before the alias: what is in use has its reason
                    self._record(version, decision)
                self._client.set_registered_model_alias(version.name, alias, str(version.version))
                if alias == CHAMPION and CANDIDATE in version.aliases:
                    self._client.delete_registered_model_alias(version.name, CANDIDATE)
            return self.find(version.reference)

    @functools.cached_property
    def _client(self) -> Any:
        if self._own:
            self._workspace.mkdir(parents=True, exist_ok=True)
        return open_client(self.uri)

    @functools.cached_property
    def _artifacts(self) -> ArtifactStore:
        return FolderArtifacts(self._workspace / "models") if self._own else RunArtifacts(self._client, self.uri)

    def _exists(self) -> bool:
        """False only for a workspace that has no registry yet: looking must not create one."""
        return not self._own or self._database.exists()

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """One writer at a time, also across processes; also keeps two from creating the tables together."""
        try:
            with written(self._workspace):
                lock = FileLock(Root(self._workspace).output("registry.lock"))
                lock.acquire(timeout=self._wait_s)
        except Timeout:
            raise locked(self._workspace) from None
        try:
            self._probe(write=True)
            yield
        finally:
            lock.release()

    def _probe(self, write: bool) -> None:
        if self._own:
            if self._workspace.is_dir():
                Root(self._workspace).path(self._database.name)
            probe_sqlite(self._database, self._wait_s, write)

    def _create_model(self, name: str) -> None:
        from mlflow.exceptions import MlflowException

        try:
            self._client.create_registered_model(name)
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise

    def _find(self, reference: str) -> tuple[ModelVersion, str]:
        name, selector = split_reference(reference)
        self._probe(write=False)
        if self._exists():
            self._refuse_damaged(name, selector)
        found = self._entries(name) if self._exists() else []
        if not found:
            known = [known for known in self._names() if self._versions(known)] if self._exists() else []
            raise StoreError(f"model registry {self.uri}", f"no model {name!r}", nearest(name, known))
        chosen = choose([version for version, _ in found], name, selector)
        return next(entry for entry in found if entry[0] == chosen)

    def _names(self) -> builtins.list[str]:
        with translated(self.uri):
            return model_names(self._client)

    def _versions(self, name: str) -> builtins.list[ModelVersion]:
        return [version for version, _ in self._entries(name)]

    def _entries(self, name: str) -> builtins.list[tuple[ModelVersion, str]]:
        with translated(self.uri):
            return entries(self._client, name)[0]

    def _refuse_damaged(self, name: str, selector: str | None) -> None:
        """Raise where what ``selector`` means is a version that cannot be read, so that no other is taken for it."""
        with translated(self.uri):
            found, damaged = entries(self._client, name)
        for row in damaged:
            meant = selector in (str(row.version), *row.aliases)
            if selector is None:
                newest = all(row.version > version.version for version, _ in found)
                meant = CHAMPION in row.aliases or (newest and not any(CHAMPION in version.aliases for version, _ in found))
            if meant:
                raise StoreError(f"model {name}", f"version {row.version} cannot be read ({row.damage})", "a version as it was")

    def _record(self, version: ModelVersion, decision: Decision) -> None:
        if not (version.decisions and version.decisions[-1].same(decision)):
            key = decision_key(decision)
            self._client.set_model_version_tag(version.name, str(version.version), key, decision.to_text())
