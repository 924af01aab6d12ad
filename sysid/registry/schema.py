"""The empty tables of a registry: made by MLflow's own migrations, once for each of its versions, and copied from then on.

The copy lies in the user's cache. Its name holds the versions of MLflow, SQLAlchemy and alembic, the list of migrations, and
its own sha256, so that another MLflow makes its own and a damaged copy is made again.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import sqlite3
import tempfile
from contextlib import closing, suppress
from pathlib import Path

from sysid.errors import StoreError
from sysid.files import on_disk, written_whole
from sysid.registry.client import SQLITE, open_client, quieten

#: What the statements of :mod:`sysid.registry.tables` need; MLflow has had them since the end of 2023.
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
REMEDY = "Run `sysid models repair`: it migrates the registry, or makes it anew from the files of its models."


def empty_registry() -> bytes:
    """An sqlite file with the tables of the MLflow that is installed, and no model."""
    folder, stem = _cache_folder(), f"registry-{_origin()}"
    for path in sorted(folder.glob(f"{stem}-*.db")):
        content = path.read_bytes()
        if path.stem == f"{stem}-{_digest(content)}":
            return content
    content = _migrated()
    with suppress(OSError):  # a cache that cannot be written only costs time
        folder.mkdir(parents=True, exist_ok=True)
        with written_whole(folder / f"{stem}-{_digest(content)}.db") as half:
            half.write_bytes(content)
    return content


def install(database: Path, content: bytes) -> None:
    """Put ``content`` where the registry is to be, whole or not at all; only for the holder of the registry's lock."""
    clear_drafts(database)
    with written_whole(database) as half:
        half.write_bytes(content)
    on_disk(database.parent)


def clear_drafts(database: Path) -> None:
    """Remove what dead writers left of a registry that they were making; only for the holder of the registry's lock."""
    for dead in database.parent.glob(f".{database.name}.*.part*"):
        dead.unlink()


def migrate(database: Path) -> None:
    """Bring the tables of an older MLflow up to date, in place: to be called on a copy.

    Raises:
        StoreError: MLflow cannot.
    """
    quieten()
    import sqlalchemy
    from mlflow.store.db.utils import _upgrade_db

    engine = sqlalchemy.create_engine(f"{SQLITE}{database.resolve()}")
    # A copy needs no syncs: it is synced once, when it is whole.
    sqlalchemy.event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA synchronous = OFF"))
    try:
        _upgrade_db(engine)  # type: ignore[no-untyped-call]
    except Exception as error:  # alembic, SQLAlchemy and the migrations themselves raise anything
        message = str(error).splitlines()[0]
        raise StoreError(database, f"cannot be migrated ({message})", "tables that MLflow made") from None
    finally:
        engine.dispose()


def missing(connection: sqlite3.Connection) -> str:
    """What the tables lack, in words; empty where nothing is missing.

    Raises:
        sqlite3.Error: it is no database, or cannot be read.
    """
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    absent = sorted(NEEDED.keys() - tables)
    if absent:
        return f"the table {absent[0]} is missing: its making was interrupted, or it is no registry"
    for table, columns in NEEDED.items():
        found = {row[1] for row in connection.execute(f"PRAGMA table_info({table})")}
        if columns - found:
            return f"{table} has no column {sorted(columns - found)[0]}: an older MLflow made it"
    return ""


def revision(connection: sqlite3.Connection) -> str:
    """The last of MLflow's migrations that the tables have had; empty where that is not known."""
    try:
        row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    except sqlite3.OperationalError:
        return ""
    return str(row[0]) if row else ""


def _migrated() -> bytes:
    """The tables as MLflow makes them; a fraction of the size without what its migrations left free."""
    with tempfile.TemporaryDirectory(prefix="sysid-registry-") as folder:
        made, packed = Path(folder) / "made.db", Path(folder) / "packed.db"
        open_client(f"{SQLITE}{made.resolve()}")
        with closing(sqlite3.connect(made)) as connection:
            connection.execute("VACUUM INTO ?", (str(packed),))
        return packed.read_bytes()


def _origin() -> str:
    """What decides the tables: versions of the libraries and the list of migrations, found without importing MLflow."""
    versions = [importlib.metadata.version(name) for name in ("mlflow-skinny", "sqlalchemy", "alembic")]
    package = importlib.util.find_spec("mlflow")
    folders = list(package.submodule_search_locations or ()) if package is not None else []
    migrations = [
        f"{path.name} {path.stat().st_size}"
        for folder in folders
        for path in sorted((Path(folder) / "store" / "db_migrations" / "versions").glob("*.py"))
    ]
    return f"mlflow-{versions[0]}-{_digest(chr(10).join([*versions, *migrations]).encode())}"


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache") / "sysid" / "registry"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
