"""The registry of a workspace: MLflow's tables in one sqlite file, read and changed by SQL, one transaction for each change.

MLflow's client uses a transaction for every tag and alias, and takes seconds to import; its server and pages can still read the
file. Reading opens the file read-only, so that it neither creates nor migrates tables.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

from sysid.errors import StorageError, StoreError
from sysid.registry.client import DISK_MESSAGES, DISK_REMEDY, UNCHANGED, disk_errors, exclusive, locked
from sysid.registry.schema import REMEDY, empty_registry, install, missing
from sysid.registry.stored import ChangeBuilder, ModelChange, StoredModel, StoredVersion
from sysid.root import Root

_Result = TypeVar("_Result")
#: MLflow keeps a deleted version under this stage.
_DELETED = "Deleted_Internal"


class WorkspaceTables:
    """``registry.db`` of a workspace.

    Args:
        workspace: holds ``registry.db`` and ``registry.lock``; created by the first change.
        wait_s: time limit for the lock of another process.
    """

    #: Whether only this toolkit sets aliases, so that other changes are errors.
    seals_aliases = True

    def __init__(self, workspace: Path, wait_s: float) -> None:
        self._workspace, self._wait_s = workspace, wait_s
        self._database = workspace / "registry.db"

    def model(self, name: str) -> StoredModel:
        """One model; without versions if there is none of this name."""
        return self._read(lambda connection: _model(connection, name), StoredModel(name))

    def models(self) -> tuple[StoredModel, ...]:
        """Every model, by name; creates and migrates nothing."""
        return self._read(lambda connection: tuple(models_of(connection)), ())

    def change(self, name: str, build: ChangeBuilder) -> StoredModel:
        """Apply the change that ``build`` returns, atomically; returns the changed model.

        Raises:
            StoreError: the registry is in use, unreachable, or invalid.
            StorageError: the disk is full or read-only; nothing was changed.
        """
        # Creating the tables may take seconds, so it is done before the lock is taken.
        with disk_errors(self._workspace):
            empty = None if self._database.exists() else empty_registry()
        with exclusive(self._workspace, self._wait_s):
            if empty is not None and not self._database.exists():
                with disk_errors(self._workspace):
                    install(self._database, empty)
            with self._opened("rw") as connection:
                connection.execute("BEGIN IMMEDIATE")
                change = build(_model(connection, name))
                if change is not None:
                    apply(connection, name, change)
                connection.execute("COMMIT")
                return _model(connection, name)

    def _read(self, read: Callable[[sqlite3.Connection], _Result], nothing: _Result) -> _Result:
        if not self._database.exists():
            return nothing
        try:
            with self._opened("ro") as connection:
                connection.execute("BEGIN")  # one snapshot for all queries
                return read(connection)
        except _InterruptedError:
            with self._opened("rw") as connection:  # sqlite rolls back the transaction of a killed process
                connection.execute("BEGIN")
                return read(connection)

    @contextmanager
    def _opened(self, mode: str) -> Iterator[sqlite3.Connection]:
        """A connection to a file with all needed tables; uncommitted changes are discarded at the end."""
        Root(self._workspace).path(self._database.name)  # refuses a link
        try:
            uri = f"{self._database.resolve().as_uri()}?mode={mode}"
            with closing(sqlite3.connect(uri, uri=True, timeout=self._wait_s, isolation_level=None)) as connection:
                if mode == "rw":
                    connection.execute("PRAGMA foreign_keys = ON")
                    connection.execute("PRAGMA synchronous = EXTRA")  # a commit survives a power cut
                lack = missing(connection)
                if lack:
                    raise StoreError(self._database, f"not a whole model registry ({lack})", "MLflow's tables", REMEDY)
                yield connection
        except sqlite3.Error as error:
            raise self._explained(error, mode) from None

    def _explained(self, error: sqlite3.Error, mode: str) -> Exception:
        text = str(error)
        if isinstance(error, sqlite3.OperationalError):
            if getattr(error, "sqlite_errorname", "") == "SQLITE_READONLY_ROLLBACK" and mode == "ro":
                return _InterruptedError()
            if "locked" in text or "busy" in text:
                return locked(self._workspace)
            reason = next((message for message in DISK_MESSAGES if message in text), None)
            if reason is not None:
                found = f"cannot be written ({reason}); {UNCHANGED}" if mode == "rw" else f"cannot be read ({reason})"
                return StorageError(f"model registry {self._database}", found, remedy=DISK_REMEDY)
        return StoreError(self._database, f"not a model registry ({text})", "an sqlite file with MLflow's tables", REMEDY)


class _InterruptedError(Exception):
    """A process was killed during a transaction."""


def _model(connection: sqlite3.Connection, name: str) -> StoredModel:
    return next(iter(models_of(connection, name)), StoredModel(name))


def models_of(connection: sqlite3.Connection, name: str | None = None) -> list[StoredModel]:
    """Every model by name, or the one called ``name``; each table is read once."""
    connection.text_factory = _text
    only, chosen = ("", ()) if name is None else (" WHERE name = ?", (name,))
    tags: dict[tuple[str, int], dict[str, str]] = {}
    for model, number, key, value in connection.execute(
        f"SELECT name, version, key, value FROM model_version_tags{only}", chosen
    ):
        tags.setdefault((model, number), {})[str(key)] = str(value)
    versions: dict[str, list[StoredVersion]] = {}
    last: dict[str, int] = {}
    for model, number, created, source, stage in connection.execute(
        f"SELECT name, version, creation_time, source, current_stage FROM model_versions{only} ORDER BY version", chosen
    ):
        last[model] = _number(number)
        if stage != _DELETED:
            row = StoredVersion(_number(number), _number(created), str(source), tags.get((model, number), {}))
            versions.setdefault(model, []).append(row)
    aliases: dict[str, dict[str, int]] = {}
    for model, alias, number in connection.execute(f"SELECT name, alias, version FROM registered_model_aliases{only}", chosen):
        aliases.setdefault(model, {})[str(alias)] = _number(number)
    own: dict[str, dict[str, str]] = {}
    for model, key, value in connection.execute(f"SELECT name, key, value FROM registered_model_tags{only}", chosen):
        own.setdefault(model, {})[str(key)] = str(value)
    names = [str(row[0]) for row in connection.execute(f"SELECT name FROM registered_models{only} ORDER BY name", chosen)]
    return [StoredModel(n, tuple(versions.get(n, ())), aliases.get(n, {}), own.get(n, {}), last.get(n, 0)) for n in names]


def _text(content: bytes) -> str:
    """Text of a row; text that is not UTF-8 matches no digest afterwards."""
    return content.decode("utf-8", "replace")


def _number(value: object) -> int:
    """An integer of a row, or 0, which is not a valid version number, for any other value."""
    return value if isinstance(value, int) else 0


def apply(connection: sqlite3.Connection, name: str, change: ModelChange) -> None:
    """The rows of ``change``, as MLflow would write them."""
    new = change.new
    if new is not None:
        insert_version(connection, name, new, change.run)
    for number, tags in change.version_tags.items():
        for key, value in tags.items():
            _set(connection, "model_version_tags", {"name": name, "version": number, "key": key}, value)
    for alias, target in change.aliases.items():
        place = {"name": name, "alias": alias}
        _delete(connection, "registered_model_aliases", place)
        if target is not None:
            _insert(connection, "registered_model_aliases", {**place, "version": target})
    for key, value in change.tags.items():
        _set(connection, "registered_model_tags", {"name": name, "key": key}, value)


def insert_version(connection: sqlite3.Connection, name: str, new: StoredVersion, run: str | None) -> None:
    """Add the rows of a version, and of its model if it is the first one."""
    made = {"creation_time": new.created_ms, "last_updated_time": new.created_ms}
    if not connection.execute("SELECT 1 FROM registered_models WHERE name = ?", (name,)).fetchone():
        _insert(connection, "registered_models", {"name": name, **made})
    else:
        connection.execute("UPDATE registered_models SET last_updated_time = ? WHERE name = ?", (new.created_ms, name))
    row = {"name": name, "version": new.number, "source": new.source, "storage_location": new.source, "run_id": run, **made}
    _insert(connection, "model_versions", {**row, "current_stage": "None", "status": "READY"})
    for key, value in new.tags.items():
        _insert(connection, "model_version_tags", {"name": name, "version": new.number, "key": key, "value": value})


def _set(connection: sqlite3.Connection, table: str, place: Mapping[str, object], value: str | None) -> None:
    _delete(connection, table, place)
    if value is not None:
        _insert(connection, table, {**place, "value": value})


def _insert(connection: sqlite3.Connection, table: str, row: Mapping[str, object]) -> None:
    columns, places = ", ".join(row), ", ".join("?" * len(row))
    connection.execute(f"INSERT INTO {table} ({columns}) VALUES ({places})", tuple(row.values()))


def _delete(connection: sqlite3.Connection, table: str, place: Mapping[str, object]) -> None:
    where = " AND ".join(f"{column} = ?" for column in place)
    connection.execute(f"DELETE FROM {table} WHERE {where}", tuple(place.values()))
