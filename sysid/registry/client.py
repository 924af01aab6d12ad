"""Opens MLflow late and quietly: it takes a second to import, reports home by default and logs tracebacks of handled errors."""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from sysid.errors import StorageError, StoreError

SQLITE = "sqlite:///"

#: What is left of work that the disk ended.
UNTOUCHED = "nothing was registered, the versions that are there are whole"
MEND = "Make room, or name a workspace that may be written, and run the command again."
#: What sqlite says when the disk is full, quota is used up, or nothing may be written.
_REFUSED = (
    "database or disk is full",
    "disk I/O error",
    "attempt to write a readonly database",
    "unable to open database file",
)


def open_client(uri: str) -> Any:
    """An ``MlflowClient`` for both the registry and the runs at ``uri``; creates the tables of a new sqlite file.

    Raises:
        StoreError: the registry cannot be reached or is no registry.
    """
    # Read by MLflow when it is imported.
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("DO_NOT_TRACK", "true")
    # Seven retries with back-off would be minutes of silence for a mistyped address.
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    for name in ("mlflow.store.db.utils", "alembic"):
        # Progress of table creation, and a traceback for errors that are raised as well.
        logging.getLogger(name).setLevel(logging.CRITICAL)
    from mlflow import MlflowClient

    with translated(uri):
        client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        client.search_registered_models(max_results=1)
    return client


@contextmanager
def translated(uri: str) -> Iterator[None]:
    """MLflow's and SQLAlchemy's errors as one clear :class:`StoreError`."""
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (MlflowException, SQLAlchemyError) as error:
        text = str(error)
        if "database is locked" in text:
            raise locked(uri) from None
        refused = next((words for words in _REFUSED if words in text), None)
        if refused is not None:
            raise StorageError(f"model registry {uri}", f"cannot be written ({refused}); {UNTOUCHED}", remedy=MEND) from None
        raise StoreError(
            f"model registry {uri}",
            text.splitlines()[0],
            "a registry that answers",
            "Check the address and that it is running.",
        ) from None


@contextmanager
def written(where: object) -> Iterator[None]:
    """What the disk refuses, as a :class:`StorageError` that says how the registry stands."""
    try:
        yield
    except TimeoutError:  # a lock that somebody holds is no fault of the disk
        raise
    except OSError as error:
        found = f"cannot be written ({error.strerror or error}); {UNTOUCHED}"
        raise StorageError(f"model registry {where}", found, remedy=MEND) from None


def locked(where: object) -> StoreError:
    return StoreError(
        f"model registry {where}",
        "in use by another process",
        "a free registry",
        "Try again when the other program has finished.",
    )


def probe_sqlite(path: Path, wait_s: float, write: bool) -> None:
    """Find out before MLflow does whether the file can be used, since MLflow waits 20 s for a lock.

    Raises:
        StoreError: the file is locked for longer than ``wait_s`` or is no database.
    """
    if not path.exists():
        return
    try:
        with closing(sqlite3.connect(path, timeout=wait_s, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE" if write else "SELECT count(*) FROM sqlite_master")
    except sqlite3.OperationalError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise locked(path) from None
        raise StoreError(path, f"cannot be opened ({error})", "a readable and writable sqlite file") from None
    except sqlite3.DatabaseError as error:
        raise StoreError(path, f"not a model registry ({error})", "a sqlite file", "Restore it or move it away.") from None
