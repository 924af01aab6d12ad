"""A dataset version as one pandas table."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.datasets.recording import Dataset
from sysid.datasets.versions.store import Store
from sysid.location import default_location


def load(reference: str, workspace: str | os.PathLike[str] | None = None) -> pd.DataFrame:
    """A stored version as one table: ``sysid.load("autolog@3")``.

    Args:
        reference: ``"name"`` (its newest version) or ``"name@3"``.
        workspace: folder or object-store URL; else ``SYSID_WORKSPACE``, else ``./workspace``.

    Returns:
        See :func:`frame_of`.

    Raises:
        StoreError: no such dataset or version, or its files are damaged.
    """
    place = os.fspath(workspace) if workspace is not None else default_location()
    return frame_of(Store(place if "://" in place else Path(place)).load(reference))


def frame_of(dataset: Dataset) -> pd.DataFrame:
    """All recordings of ``dataset``, one below the other.

    Returns:
        Columns ``recording`` and ``role`` (categories; poses have no role), ``time`` [s] since the recording's start, and one
        float64 column a signal, NaN where a recording does not have it. ``attrs``: ``units`` (column → SI unit), ``dataset``
        (``name@version``) and ``digest``.
    """
    roles: tuple[str, ...] = ("fit", "select", "held_out")
    names = [recording.name for recording in dataset.recordings]
    numbers = np.repeat(np.arange(len(names)), [len(recording) for recording in dataset.recordings])
    codes = np.array([roles.index(dataset.splits[name]) if name in dataset.splits else -1 for name in names])
    table = pd.concat([recording.table for recording in dataset.recordings], ignore_index=True)
    columns: dict[str, object] = {
        "recording": pd.Categorical.from_codes(numbers, dtype=pd.CategoricalDtype(names)),
        "role": pd.Categorical.from_codes(codes[numbers], dtype=pd.CategoricalDtype(list(roles))),
    }
    frame = pd.concat([pd.DataFrame(columns), table], axis=1)
    units = {column: unit for column, unit in dataset.units.items() if column in frame.columns}
    frame.attrs = {"units": units, "dataset": dataset.reference, "digest": dataset.digest}
    return frame
