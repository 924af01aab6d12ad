"""Repairs the registry of a workspace: migrates old tables, rebuilds lost ones from the model files, restores seals.

The repaired registry is created beside the old one and replaces it by a rename; the old one is kept under another name.
Decisions, and the aliases of a registry whose rows are unreadable, cannot be restored.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from sysid.errors import StoreError
from sysid.files import on_disk, written_whole
from sysid.registry.client import disk_errors, exclusive, locked
from sysid.registry.entries import broken_model, broken_version, changed, sealed, sealed_aliases
from sysid.registry.schema import clear_drafts, empty_registry, migrate, missing, revision
from sysid.registry.stored import (
    DECISION,
    DIGEST,
    MANIFEST,
    METRICS,
    ModelChange,
    StoredModel,
    StoredVersion,
    read_records,
)
from sysid.registry.tables import WorkspaceTables, apply, models_of
from sysid.registry.version import CANDIDATE, CHAMPION, sha256
from sysid.registry.version import MANIFEST as MANIFEST_FILE
from sysid.root import Root

DECISIONS_LOST = "Decisions of restored versions are lost; use `sysid models promote` again."


@dataclass(frozen=True)
class RepairReport:
    """What was repaired, and what could not be restored, one sentence each; both empty if the registry was valid."""

    done: tuple[str, ...]
    left: tuple[str, ...]


def repair(workspace: Path, accept: bool = False, wait_s: float = 30.0) -> RepairReport:
    """Repair the registry of ``workspace``; idempotent, also after it was killed.

    Args:
        accept: accept aliases, figures and decisions that were changed by hand, and seal them.

    Raises:
        StoreError: another process uses the registry.
        StorageError: the disk is full or read-only; the registry is unchanged.
    """
    root = Root(workspace)
    database = root.path("registry.db")
    if not database.exists() and root.kind("models") is None:
        return RepairReport((), ())
    with disk_errors(workspace):
        empty = empty_registry()  # before the lock: it may take seconds
    with exclusive(workspace, wait_s), disk_errors(workspace):
        done, left = _repair_tables(workspace, database, empty)
    tables = WorkspaceTables(workspace, wait_s)
    for model in tables.models():
        _repair_seals(tables, model, _records(workspace), accept, done, left)
    return RepairReport(tuple(done), tuple(left))


def _repair_tables(workspace: Path, database: Path, empty: bytes) -> tuple[list[str], list[str]]:
    """Check the tables; migrate or rebuild them where needed."""
    if not database.exists():
        return _rebuilt(workspace, database, empty, "registry.db was missing")
    try:
        with closing(sqlite3.connect(database)) as connection:
            (state,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            lack, made = missing(connection), revision(connection)
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise locked(workspace) from None
        raise OSError(str(error)) from None
    except sqlite3.DatabaseError as error:
        return _rebuilt(workspace, database, empty, f"registry.db cannot be read ({error})")
    if state != "ok":
        return _rebuilt(workspace, database, empty, f"registry.db is damaged ({state})")
    if not lack and made == _revision_of(empty):
        return [], []
    if "is missing" in lack:
        return _rebuilt(workspace, database, empty, f"registry.db is incomplete ({lack})")
    try:
        kept = _replaced(database, lambda half: _migrated(database, half), "old")
    except StoreError as error:
        if not lack and "locate revision" in error.found:
            return [], [f"registry.db is of a newer MLflow ({made}); it is usable and was not changed."]
        return _rebuilt(workspace, database, empty, f"registry.db is incomplete ({lack or error.found})")
    return [f"registry.db was migrated to the tables of this MLflow. The old one is {kept.name}."], []


def _revision_of(content: bytes) -> str:
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(content)
        return revision(connection)


def _migrated(database: Path, half: Path) -> None:
    with closing(sqlite3.connect(database)) as source, closing(sqlite3.connect(half)) as target:
        source.backup(target)
    migrate(half)
    with closing(sqlite3.connect(half)) as connection:
        lack = missing(connection)
    if lack:
        raise StoreError(database, f"still incomplete after its migration ({lack})", "MLflow's tables", "Restore a copy of it.")


def _rebuilt(workspace: Path, database: Path, empty: bytes, why: str) -> tuple[list[str], list[str]]:
    """Rebuild the registry from readable rows, and from the records beside the files."""
    models = {model.name: model for model in _readable(database)}
    records = _records(workspace)
    restored = []
    for name, entries in records.items():
        model = models.get(name, StoredModel(name))
        have = {version.number for version in model.versions}
        added = [entry for entry in entries if entry.number not in have]
        restored += [f"{name}@{entry.number}" for entry in added]
        versions = tuple(sorted((*model.versions, *added), key=lambda entry: entry.number))
        models[name] = replace(model, versions=versions)

    def fill(half: Path) -> None:
        half.write_bytes(empty)
        with closing(sqlite3.connect(half, isolation_level=None)) as connection:
            connection.execute("BEGIN")
            for model in models.values():
                for change in _changes(model, set(restored)):
                    apply(connection, model.name, change)
            connection.execute("COMMIT")

    kept = _replaced(database, fill, "broken")
    number = sum(len(model.own) for model in models.values())
    old = f" The old one is {kept.name}." if kept.exists() else ""
    done = [f"{why}: rebuilt with {number} versions, {len(restored)} of them from the model files.{old}"]
    left = [f"{DECISIONS_LOST} ({', '.join(restored[:5])}{', …' if len(restored) > 5 else ''})"] if restored else []
    return done, left + _without_record(workspace, models)


def _changes(model: StoredModel, restored: set[str]) -> list[ModelChange]:
    """The changes that create the rows of a model; without aliases, its newest version becomes the candidate."""
    changes = [ModelChange(new=version) for version in model.versions]
    aliases: dict[str, int | None] = dict(model.aliases)
    if not aliases and model.own:
        aliases = {CANDIDATE: model.own[-1].number}
    changes.append(ModelChange(aliases=aliases, tags=model.tags))
    unsealed: dict[int, dict[str, str | None]] = {v.number: {} for v in model.own if f"{model.name}@{v.number}" in restored}
    if unsealed:
        changes.append(sealed(model, ModelChange(version_tags=unsealed, aliases=aliases), aliases=True))
    return changes


def _readable(database: Path) -> Sequence[StoredModel]:
    """The rows of a registry that sqlite can read; empty if it cannot."""
    if not database.exists():
        return ()
    try:
        with closing(sqlite3.connect(database)) as connection:
            return () if missing(connection) else models_of(connection)
    except sqlite3.Error:
        return ()


def _records(workspace: Path) -> Mapping[str, Sequence[StoredVersion]]:
    """Name → versions according to the model files; of two with one number the later: the other was not registered."""
    found: dict[tuple[str, int], StoredVersion] = {}
    root = Root(workspace)
    for digest in root.entries("models"):
        if (text := _manifest(root, digest)) is None:
            continue
        for record in read_records(root, f"models/{digest}"):
            tags = {DIGEST: digest, MANIFEST: text, METRICS: record.metrics}
            source = (workspace / "models" / digest).resolve().as_uri()
            entry = StoredVersion(record.version, record.created_ms, source, tags)
            other = found.get((record.name, record.version))
            if other is None or other.created_ms < entry.created_ms:
                found[record.name, record.version] = entry
    by_name: dict[str, list[StoredVersion]] = {}
    for (name, _), entry in sorted(found.items()):
        by_name.setdefault(name, []).append(entry)
    return by_name


def _manifest(root: Root, digest: str) -> str | None:
    """The manifest of a folder of model files; None if it is missing, changed, or reached by a link."""
    try:
        content = root.read(f"models/{digest}/{MANIFEST_FILE}")
        return content.decode("utf-8") if sha256(content) == digest else None
    except (OSError, ValueError, StoreError):
        return None


def _without_record(workspace: Path, models: Mapping[str, StoredModel]) -> list[str]:
    """Messages about model files without row and record."""
    known = {version.tags[DIGEST] for model in models.values() for version in model.own}
    root = Root(workspace)
    digests = [digest for digest in root.entries("models") if not digest.startswith(".")]
    lost = [digest for digest in digests if digest not in known and not read_records(root, f"models/{digest}")]
    return [
        f"models/{digest[:12]}…: its name and number were only in the registry; repeat the command that created it."
        for digest in sorted(lost)
    ]


def _replaced(database: Path, make: Callable[[Path], None], why: str) -> Path:
    """Replace ``database`` by the file that ``make`` writes; returns the new path of the old one."""
    kept = database.with_name(f"{database.name}.{why}-{time.strftime('%Y%m%d-%H%M%S')}")
    clear_drafts(database)
    with written_whole(database) as half:
        make(half)
        if database.exists():
            try:
                os.link(database, kept)
            except FileExistsError:
                pass
            except OSError:  # a file system without hard links
                shutil.copyfile(database, kept)
            journal = database.with_name(f"{database.name}-journal")
            if journal.exists():  # it must not be applied to the new file
                journal.replace(kept.with_name(f"{kept.name}-journal"))
    on_disk(database.parent)
    return kept


def _repair_seals(
    tables: WorkspaceTables,
    model: StoredModel,
    records: Mapping[str, Sequence[StoredVersion]],
    accept: bool,
    done: list[str],
    left: list[str],
) -> None:
    """Restore what was changed by hand in one model, or accept it."""
    wrong = [version for version in model.own if broken_version(model, version) is not None]
    broken = broken_model(model)
    if not model.own or (not wrong and broken is None):
        return

    def build(now: StoredModel) -> ModelChange:
        if accept:
            everything: dict[int, dict[str, str | None]] = {version.number: {} for version in now.own}
            done.append(f"{now.name}: accepted and sealed ({broken or f'{len(wrong)} changed versions'}).")
            return sealed(now, ModelChange(version_tags=everything), aliases=True)
        return _restored(now, records.get(now.name, ()), done, left)

    tables.change(model.name, build)


def _restored(now: StoredModel, records: Sequence[StoredVersion], done: list[str], left: list[str]) -> ModelChange:
    """Restore the sealed aliases and the registered figures."""
    known = {entry.number: entry for entry in records}
    tags: dict[int, dict[str, str | None]] = {}
    for version in now.own:
        if broken_version(now, version) is None:
            continue
        entry, where = known.get(version.number), f"{now.name}@{version.number}"
        figures = entry.tags[METRICS] if entry is not None and entry.tags[DIGEST] == version.tags[DIGEST] else None
        if figures is not None:
            true = replace(version, tags={**version.tags, METRICS: figures})
            if broken_version(now, true) is None:
                tags[version.number] = {METRICS: figures}
                done.append(f"{where}: its figures were restored to those of its registration.")
                continue
        decisions = [key for key in version.tags if key.startswith(f"{DECISION}.")]
        left.append(
            f"{where}: its {len(decisions)} decisions or its seal were changed, and there is no other copy. "
            "--accept accepts them."
        )
    aliases: dict[str, int | None] = {}
    recorded = sealed_aliases(now)
    if recorded is None:
        left.append(f"{now.name}: the record of its aliases is missing. --accept accepts them.")
        return ModelChange(version_tags=tags)
    if recorded != dict(now.aliases):
        aliases = {**dict.fromkeys(now.aliases), **recorded}
        done.append(f"{now.name}: its aliases were restored to the recorded ones ({_text(recorded)}).")
    change = ModelChange(version_tags=tags, aliases=aliases)
    if broken_model(changed(now, change)) is not None:
        left.append(f"{now.name}: the list of its {len(now.own)} versions is not the recorded one. --accept accepts it.")
    return change


def _text(aliases: Mapping[str, int]) -> str:
    named = sorted(aliases.items(), key=lambda item: (item[0] not in (CHAMPION, CANDIDATE), item[0]))
    return ", ".join(f"{alias} is version {number}" for alias, number in named) or "none"
