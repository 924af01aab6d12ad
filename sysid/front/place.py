"""Workspace, dataset and progress of a call, where the user does not state them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeAlias

from sysid.errors import StoreError
from sysid.location import default_location
from sysid.progress import Progress
from sysid.progress_bar import progress_bar

if TYPE_CHECKING:
    from sysid.datasets import Dataset
    from sysid.workspace import Workspace

#: A workspace, or its location; None: ``SYSID_WORKSPACE``, else ``./workspace``.
Place: TypeAlias = "Workspace | str | os.PathLike[str] | None"


def location_of(workspace: Place) -> str:
    """The location of a workspace."""
    location = workspace if workspace is None or isinstance(workspace, str | os.PathLike) else workspace.location
    return default_location() if location is None else os.fspath(location)


def open(workspace: Place = None) -> Workspace:  # noqa: A001 - the name at the top, `sysid.open`
    """The workspace of datasets, models and results; it is created by the first write.

    Args:
        workspace: folder, or object-store URL of its datasets; else ``SYSID_WORKSPACE``, else ``./workspace``.

    Raises:
        SettingsError: it is a file.
    """
    from sysid.workspace import Workspace, open_workspace

    return workspace if isinstance(workspace, Workspace) else open_workspace(location_of(workspace))


def dataset_in(workspace: Workspace, dataset: Dataset | str | None) -> Dataset:
    """A dataset of the workspace.

    Raises:
        StoreError: it is not stored there, or None and not exactly one dataset is.
    """
    if dataset is None or isinstance(dataset, str):
        return workspace.dataset(dataset)
    if workspace.datasets.manifest(dataset.reference)["digest"] != dataset.digest:
        expected = "that of the given dataset"
        remedy = "Give the workspace in which it was ingested: workspace=…"
        raise StoreError(f"{dataset.reference} in workspace {workspace.location}", "another content", expected, remedy)
    return dataset


@contextlib.contextmanager
def shown(progress: Progress | None, title: str) -> Iterator[Progress]:
    """The callback of the user, else a progress bar."""
    if progress is not None:
        yield progress
        return
    with progress_bar(title) as bar:
        yield bar
