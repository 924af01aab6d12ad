"""MLflow client (imported late, without telemetry), lock of the registry, and translation of errors."""

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

#: State after a failed write, and its remedy.
UNCHANGED = "nothing was registered, existing versions are unchanged"
DISK_REMEDY = "Free disk space, or name a writable workspace, and run the command again."
#: Polling interval of the lock [s], short compared with the time that it is held.
POLL_S = 0.01
#: sqlite's messages for a full disk, an exceeded quota, or missing permission.
DISK_MESSAGES = (
    "database or disk is full",
    "disk I/O error",
    "attempt to write a readonly database",
    "unable to open database file",
)


def open_client(uri: str) -> Any:
    """An ``MlflowClient`` for the registry and the runs at ``uri``; creates the tables of a new sqlite file.

    Raises:
        StoreError: the registry is unreachable or is no registry.
    """
    quieten()
    from mlflow import MlflowClient

    with mlflow_errors(uri):
        client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        client.search_registered_models(max_results=1)
    return client


def quieten() -> None:
    """Set MLflow's environment; to be called before its import."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("DO_NOT_TRACK", "true")
    # The default of seven retries with back-off takes minutes for a mistyped address.
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    for name in ("mlflow.store.db.utils", "alembic"):
        # They log the creation of tables, and tracebacks of errors that are raised as well.
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def mlflow_errors(uri: str) -> Iterator[None]:
    """Translate MLflow's and SQLAlchemy's errors to :class:`StoreError`."""
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (MlflowException, SQLAlchemyError) as error:
        text = str(error)
        if "database is locked" in text:
            raise locked(uri) from None
        reason = next((message for message in DISK_MESSAGES if message in text), None)
        if reason is not None:
            found = f"cannot be written ({reason}); {UNCHANGED}"
            raise StorageError(f"model registry {uri}", found, remedy=DISK_REMEDY) from None
        raise StoreError(
            f"model registry {uri}",
            text.splitlines()[0],
            "a registry that answers",
            "Check the address and that it is running.",
        ) from None


@contextmanager
def disk_errors(where: object) -> Iterator[None]:
    """Translate errors of the disk to :class:`StorageError`."""
    try:
        yield
    except TimeoutError:  # of the lock
        raise
    except (OSError, StorageError) as error:
        reason = error.found if isinstance(error, StorageError) else error.strerror or error
        found = f"cannot be written ({reason}); {UNCHANGED}"
        raise StorageError(f"model registry {where}", found, remedy=DISK_REMEDY) from None


def locked(where: object) -> StoreError:
    return StoreError(
        f"model registry {where}",
        "in use by another process",
        "a free registry",
        "Try again when the other program has finished.",
    )


@contextmanager
def exclusive(workspace: Path, wait_s: float) -> Iterator[None]:
    """The registry's lock, across processes; to be held only while files and rows are written.

    Raises:
        StoreError: another process held it for longer than ``wait_s``; or its file is a link.
        StorageError: the workspace is not writable.
    """
    try:
        with disk_errors(workspace):
            lock = FileLock(Root(workspace).output("registry.lock"), poll_interval=POLL_S)
            lock.acquire(timeout=wait_s)
    except Timeout:
        raise locked(workspace) from None
    try:
        yield
    finally:
        lock.release()
