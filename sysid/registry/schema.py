"""The empty tables of a registry: created by MLflow's own migrations once for each of its versions, then copied from a cache.

The file name in the user's cache contains the versions of MLflow, SQLAlchemy and alembic, a digest of the list of migrations,
and its own sha256, so that a copy of another MLflow or a damaged copy is not used.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import sqlite3
import tempfile
from contextlib import closing, suppress
from pathlib import Path

from sysid.errors import StoreError
from sysid.files import on_disk, written_whole
from sysid.location import cache_home
from sysid.registry.client import SQLITE, open_client, quieten

#: Columns that :mod:`sysid.registry.tables` uses; MLflow has had them since the end of 2023.
NEEDED = {
    "registered_models": {"name", "creation_time", "last_updated_time"},
    "registered_model_tags": {"name", "key", "value"},
    "registered_model_aliases": {"name", "alias", "version"},
    "model_versions": {
        "name",
        "version",
        "creation_time",
        "last_updated_time",
        "source",
        "storage_location",
        "run_id",
        "current_stage",
        "status",
    },
    "model_version_tags": {"name", "version", "key", "value"},
}
REMEDY = "Run `sysid models repair`: it migrates the registry, or rebuilds it from the model files."


def empty_registry() -> bytes:
    """An sqlite file with the tables of the installed MLflow, without models."""
    folder, stem = cache_home() / "registry", f"registry-{_origin()}"
    for path in sorted(folder.glob(f"{stem}-*.db")):
        content = path.read_bytes()
        if path.stem == f"{stem}-{_digest(content)}":
            return content
    content = migrated_tables()
    with suppress(OSError):  # without a writable cache the tables are created each time
        folder.mkdir(parents=True, exist_ok=True)
        with written_whole(folder / f"{stem}-{_digest(content)}.db") as half:
            half.write_bytes(content)
    return content


def install(database: Path, content: bytes) -> None:
    """Write a new registry atomically; requires the registry's lock."""
    clear_drafts(database)
    with written_whole(database) as half:
        half.write_bytes(content)
    on_disk(database.parent)


def clear_drafts(database: Path) -> None:
    """Remove partial registries of killed processes; requires the registry's lock."""
    for dead in database.parent.glob(f".{database.name}.*.part*"):
        dead.unlink()


def migrate(database: Path) -> None:
    """Migrate the tables of an older MLflow in place; to be called on a copy.

    Raises:
        StoreError: the migration failed.
    """
    quieten()
    import sqlalchemy
    from mlflow.store.db.utils import _upgrade_db

    engine = sqlalchemy.create_engine(f"{SQLITE}{database.resolve()}")
    # No syncs: the copy is synced once, when it is complete.
    sqlalchemy.event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA synchronous = OFF"))
    try:
        _upgrade_db(engine)  # type: ignore[no-untyped-call]
    except Exception as error:  # alembic, SQLAlchemy and the migrations themselves raise anything
        message = str(error).splitlines()[0]
        raise StoreError(database, f"cannot be migrated ({message})", "tables of MLflow") from None
    finally:
        engine.dispose()


def missing(connection: sqlite3.Connection) -> str:
    """What the tables lack, as text; empty if nothing is missing.

    Raises:
        sqlite3.Error: not a database, or unreadable.
    """
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    absent = sorted(NEEDED.keys() - tables)
    if absent:
        return f"the table {absent[0]} is missing: its creation was interrupted, or it is not a registry"
    for table, columns in NEEDED.items():
        found = {row[1] for row in connection.execute(f"PRAGMA table_info({table})")}
        if columns - found:
            return f"{table} has no column {sorted(columns - found)[0]}: it is of an older MLflow"
    return ""


def revision(connection: sqlite3.Connection) -> str:
    """The last migration that was applied to the tables; empty if unknown."""
    try:
        row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    except sqlite3.OperationalError:
        return ""
    return str(row[0]) if row else ""


def migrated_tables() -> bytes:
    """The tables as MLflow creates them, compacted by VACUUM."""
    with tempfile.TemporaryDirectory(prefix="sysid-registry-") as folder:
        made, packed = Path(folder) / "made.db", Path(folder) / "packed.db"
        open_client(f"{SQLITE}{made.resolve()}")
        with closing(sqlite3.connect(made)) as connection:
            connection.execute("VACUUM INTO ?", (str(packed),))
        return packed.read_bytes()


def _origin() -> str:
    """Versions of the libraries and digest of the list of migrations, found without importing MLflow."""
    versions = [importlib.metadata.version(name) for name in ("mlflow-skinny", "sqlalchemy", "alembic")]
    package = importlib.util.find_spec("mlflow")
    folders = list(package.submodule_search_locations or ()) if package is not None else []
    migrations = [
        f"{path.name} {path.stat().st_size}"
        for folder in folders
        for path in sorted((Path(folder) / "store" / "db_migrations" / "versions").glob("*.py"))
    ]
    return f"mlflow-{versions[0]}-{_digest(chr(10).join([*versions, *migrations]).encode())}"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
