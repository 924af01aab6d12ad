"""Mends the registry of a workspace: migrates old tables, makes lost ones anew from the files of the models, restores seals.

The mended registry is made beside the old one and takes its place by a rename; the old one stays under another name.
What only the registry held cannot come back: decisions, and the aliases of a registry whose rows cannot be read.
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
from sysid.registry.client import exclusive, locked, written
from sysid.registry.record import Record, read_records
from sysid.registry.schema import clear_drafts, empty_registry, migrate, missing, revision
from sysid.registry.seal import broken_model, broken_version, changed, is_sealed, sealed, sealed_aliases
from sysid.registry.stored import DECISION, DIGEST, MANIFEST, METRICS, ModelChange, StoredModel, StoredVersion
from sysid.registry.tables import WorkspaceTables, apply, models_of
from sysid.registry.version import CANDIDATE, CHAMPION, sha256
from sysid.registry.version import MANIFEST as MANIFEST_FILE
from sysid.root import Root

LOST = "Decisions of restored versions are lost: `sysid models promote` decides anew."


@dataclass(frozen=True)
class RepairReport:
    """What was done, and what could not be restored, one sentence each; both empty where the registry is whole."""

    done: tuple[str, ...]
    left: tuple[str, ...]


def repair(workspace: Path, accept: bool = False, wait_s: float = 30.0) -> RepairReport:
    """Mend the registry of ``workspace``; may be repeated without harm, also after it was killed.

    Args:
        accept: take aliases, figures and decisions that were changed by hand as they stand, and seal them.

    Raises:
        StoreError: somebody is at work on the registry.
        StorageError: the disk is full, or may not be written; the registry is as it was.
    """
    root = Root(workspace)
    database = root.path("registry.db")
    if not database.exists() and root.kind("models") is None:
        return RepairReport((), ())
    with written(workspace):
        empty = empty_registry()  # before the lock: it may take seconds
    with exclusive(workspace, wait_s), written(workspace):
        done, left = _mend_tables(workspace, database, empty)
    tables = WorkspaceTables(workspace, wait_s)
    for model in tables.models():
        _mend_seals(tables, model, _records(workspace), accept, done, left)
    return RepairReport(tuple(done), tuple(left))


def _mend_tables(workspace: Path, database: Path, empty: bytes) -> tuple[list[str], list[str]]:
    """Make the tables whole: as they are, migrated, or anew."""
    if not database.exists():
        return _anew(workspace, database, empty, "there was no registry.db")
    try:
        with closing(sqlite3.connect(database)) as connection:
            (state,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            lack, made = missing(connection), revision(connection)
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise locked(workspace) from None
        raise OSError(str(error)) from None
    except sqlite3.DatabaseError as error:
        return _anew(workspace, database, empty, f"registry.db cannot be read ({error})")
    if state != "ok":
        return _anew(workspace, database, empty, f"registry.db is damaged ({state})")
    if not lack and made == _revision_of(empty):
        return [], []
    if "is missing" in lack:
        return _anew(workspace, database, empty, f"registry.db is not whole ({lack})")
    try:
        kept = _replaced(database, lambda half: _migrated(database, half), "old")
    except StoreError as error:
        if not lack and "locate revision" in error.found:
            return [], [f"registry.db is of a newer MLflow ({made}), and works as it is."]
        return _anew(workspace, database, empty, f"registry.db is half made ({lack or error.found})")
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
        raise StoreError(database, f"still not whole after its migration ({lack})", "MLflow's tables", "Restore a copy of it.")


def _anew(workspace: Path, database: Path, empty: bytes, why: str) -> tuple[list[str], list[str]]:
    """A registry from what can be read of the old rows, and from the records beside the files."""
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
    done = [f"{why}: made anew with {number} versions, {len(restored)} of them from the files of the models.{old}"]
    left = [f"{LOST} ({', '.join(restored[:5])}{', …' if len(restored) > 5 else ''})"] if restored else []
    return done, left + _unnamed(workspace, models)


def _changes(model: StoredModel, restored: set[str]) -> list[ModelChange]:
    """The rows of a model; one without aliases has its newest version as the candidate, as when that was registered."""
    changes = [ModelChange(new=version) for version in model.versions]
    aliases: dict[str, int | None] = dict(model.aliases)
    if not aliases and model.own:
        aliases = {CANDIDATE: model.own[-1].number}
    changes.append(ModelChange(aliases=aliases, tags=model.tags))
    anew: dict[int, dict[str, str | None]] = {v.number: {} for v in model.own if f"{model.name}@{v.number}" in restored}
    if anew:
        changes.append(sealed(model, ModelChange(version_tags=anew, aliases=aliases), aliases=True))
    return changes


def _readable(database: Path) -> Sequence[StoredModel]:
    """What sqlite can still read of a registry: all, or nothing."""
    if not database.exists():
        return ()
    try:
        with closing(sqlite3.connect(database)) as connection:
            return () if missing(connection) else models_of(connection)
    except sqlite3.Error:
        return ()


def _records(workspace: Path) -> Mapping[str, Sequence[StoredVersion]]:
    """Name → versions that the model files tell of; of two with one number the later: the other was never registered."""
    found: dict[tuple[str, int], StoredVersion] = {}
    root = Root(workspace)
    for digest in root.entries("models"):
        text = _manifest(root, digest)
        for record in read_records(root, f"models/{digest}") if text is not None else ():
            entry = _entry(workspace / "models" / digest, text or "", record)
            other = found.get((record.name, record.version))
            if other is None or other.created_ms < entry.created_ms:
                found[record.name, record.version] = entry
    by_name: dict[str, list[StoredVersion]] = {}
    for (name, _), entry in sorted(found.items()):
        by_name.setdefault(name, []).append(entry)
    return by_name


def _entry(folder: Path, text: str, record: Record) -> StoredVersion:
    tags = {DIGEST: folder.name, MANIFEST: text, METRICS: record.metrics}
    return StoredVersion(record.version, record.created_ms, folder.resolve().as_uri(), tags)


def _manifest(root: Root, digest: str) -> str | None:
    """The manifest of a folder of model files; None where it is none, was changed, or is reached by a link."""
    try:
        content = root.read(f"models/{digest}/{MANIFEST_FILE}")
        return content.decode("utf-8") if sha256(content) == digest else None
    except (OSError, ValueError, StoreError):
        return None


def _unnamed(workspace: Path, models: Mapping[str, StoredModel]) -> list[str]:
    """Model files that no row and no record names: from before there were records."""
    known = {version.tags[DIGEST] for model in models.values() for version in model.own}
    root = Root(workspace)
    digests = [digest for digest in root.entries("models") if not digest.startswith(".")]
    lost = [digest for digest in digests if digest not in known and not read_records(root, f"models/{digest}")]
    return [
        f"models/{digest[:12]}…: its name and number were in the registry alone; repeat the command that made it."
        for digest in sorted(lost)
    ]


def _replaced(database: Path, make: Callable[[Path], None], why: str) -> Path:
    """Let what ``make`` writes take the place of ``database``; returns the path that the old one has now."""
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
            if journal.exists():  # of the old one: it must not be applied to the new one
                journal.replace(kept.with_name(f"{kept.name}-journal"))
    on_disk(database.parent)
    return kept


def _mend_seals(
    tables: WorkspaceTables,
    model: StoredModel,
    records: Mapping[str, Sequence[StoredVersion]],
    accept: bool,
    done: list[str],
    left: list[str],
) -> None:
    """Restore what was changed by hand in one model, or take it as it stands."""
    wrong = [version for version in model.own if broken_version(model, version) is not None]
    broken = broken_model(model)
    if not model.own or (is_sealed(model) and not wrong and broken is None):
        return

    def build(now: StoredModel) -> ModelChange:
        everything: dict[int, dict[str, str | None]] = {version.number: {} for version in now.own}
        if not is_sealed(now):
            done.append(f"{now.name}: sealed; it was registered before there were seals.")
            return sealed(now, ModelChange(version_tags=everything), aliases=True)
        if accept:
            done.append(f"{now.name}: accepted as it stands, and sealed ({broken or f'{len(wrong)} changed versions'}).")
            return sealed(now, ModelChange(version_tags=everything), aliases=True)
        return _restored(now, records.get(now.name, ()), done, left)

    tables.change(model.name, build)


def _restored(now: StoredModel, records: Sequence[StoredVersion], done: list[str], left: list[str]) -> ModelChange:
    """Aliases as they were last sealed, figures as they were registered."""
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
                done.append(f"{where}: its figures are those of its registration again.")
                continue
        decisions = [key for key in version.tags if key.startswith(f"{DECISION}.")]
        left.append(
            f"{where}: its {len(decisions)} decisions or its seal are not those that were recorded, and are kept nowhere else. "
            "--accept takes them as they stand."
        )
    aliases: dict[str, int | None] = {}
    meant = sealed_aliases(now)
    if meant is None:
        left.append(f"{now.name}: the record of its aliases is gone. --accept takes them as they stand.")
        return ModelChange(version_tags=tags)
    if meant != dict(now.aliases):
        aliases = {**dict.fromkeys(now.aliases), **meant}
        done.append(f"{now.name}: its aliases are those that were recorded again ({_text(meant)}).")
    change = ModelChange(version_tags=tags, aliases=aliases)
    if broken_model(changed(now, change)) is not None:
        left.append(
            f"{now.name}: the list of its {len(now.own)} versions is not the one recorded. --accept takes it as it stands."
        )
    return change


def _text(aliases: Mapping[str, int]) -> str:
    named = sorted(aliases.items(), key=lambda item: (item[0] not in (CHAMPION, CANDIDATE), item[0]))
    return ", ".join(f"{alias} is version {number}" for alias, number in named) or "none"
