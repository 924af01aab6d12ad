"""Opens MLflow late and quietly: it takes a second to import, reports home by default and logs tracebacks of handled errors.

With it what every registry needs: its lock, and errors of disks and libraries in the words of this toolkit.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from sysid.errors import StorageError, StoreError
from sysid.root import Root

SQLITE = "sqlite:///"

#: What is left of work that the disk ended.
UNTOUCHED = "nothing was registered, the versions that are there are whole"
MEND = "Make room, or name a workspace that may be written, and run the command again."
#: How often the lock of another process is tried again [s]: short beside the time that it is held.
POLL_S = 0.01
#: What sqlite says when the disk is full, quota is used up, or nothing may be written.
REFUSED = (
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
    quieten()
    from mlflow import MlflowClient

    with translated(uri):
        client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        client.search_registered_models(max_results=1)
    return client


def quieten() -> None:
    """To be called before MLflow is imported."""
    # Read by MLflow when it is imported.
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("DO_NOT_TRACK", "true")
    # Seven retries with back-off would be minutes of silence for a mistyped address.
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    for name in ("mlflow.store.db.utils", "alembic"):
        # Progress of table creation, and a traceback for errors that are raised as well.
        logging.getLogger(name).setLevel(logging.CRITICAL)


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
        refused = next((words for words in REFUSED if words in text), None)
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


@contextmanager
def exclusive(workspace: Path, wait_s: float) -> Iterator[None]:
    """One writer at a time, also across processes. To be held for files and rows alone: no imports, no fits.

    Raises:
        StoreError: somebody held it for longer than ``wait_s``; or its file is a link.
        StorageError: the workspace may not be written.
    """
    try:
        with written(workspace):
            lock = FileLock(Root(workspace).output("registry.lock"), poll_interval=POLL_S)
            lock.acquire(timeout=wait_s)
    except Timeout:
        raise locked(workspace) from None
    try:
        yield
    finally:
        lock.release()
