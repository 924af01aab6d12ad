"""Cross-validation folds by whole recordings, or by blocks of time with a guard, with scikit-learn's splitters."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import ExcitationError, SettingsError
from sysid.networks.split import GUARD_S, SignalRows

Index = npt.NDArray[np.int64]


def folds(
    rows: SignalRows, count: int = 5, by: Literal["recording", "block"] = "recording", guard_s: float = GUARD_S
) -> list[tuple[Index, Index]]:
    """Indices (fit, held out) of each fold, for ``cv=`` of scikit-learn's tools and of ``sysid.networks.estimator``.

    Every row is held out exactly once. Rows are not split at random, since neighbours in time have correlated errors.

    Args:
        count: number of folds.
        by: ``recording``: whole recordings; ``block``: each recording is split into ``count`` blocks of time.
        guard_s: rows within this time of a held-out row are not fitted in that fold [s]; for blocks only.

    Raises:
        SettingsError: fewer than two folds.
        ExcitationError: fewer recordings or rows than folds.
    """
    from sklearn.model_selection import GroupKFold

    if count < 2:
        raise SettingsError("folds", str(count), "two and more")
    names, of_recording = np.unique(rows.recording, return_inverse=True)
    if by == "recording" and len(names) < count:
        have, expected = f"{len(names)} recordings", f"at least {count}, one a fold"
        raise ExcitationError("folds", have, expected, "Use fewer folds, or split recordings into blocks (by = 'block').")
    if len(rows) < count:
        raise ExcitationError("folds", f"{len(rows)} rows", f"at least {count}")
    groups = of_recording if by == "recording" else _blocks(rows, of_recording, count)
    found = []
    for fit, held in GroupKFold(count).split(rows.values, groups=groups):
        kept = fit[~_near(rows, fit, held, guard_s)] if by == "block" else fit
        found.append((kept.astype(np.int64), held.astype(np.int64)))
    return found


def _blocks(rows: SignalRows, of_recording: npt.NDArray[np.intp], count: int) -> Index:
    """Block of each row: blocks of equal numbers of rows, in order of time."""
    block = np.empty(len(rows), dtype=np.int64)
    for number in range(int(of_recording.max()) + 1):
        mine = np.flatnonzero(of_recording == number)
        order = mine[np.argsort(rows.time[mine], kind="stable")]
        block[order] = np.arange(len(order)) * count // len(order)
    return block


def _near(rows: SignalRows, fit: npt.NDArray[np.intp], held: npt.NDArray[np.intp], guard_s: float) -> npt.NDArray[np.bool_]:
    """Which rows of ``fit`` are within the guard of a held-out row of their recording."""
    near = np.zeros(len(fit), dtype=bool)
    for name in np.unique(rows.recording[held]):
        times = np.sort(rows.time[held[rows.recording[held] == name]])
        mine = np.flatnonzero(rows.recording[fit] == name)
        at = np.searchsorted(times, rows.time[fit[mine]])
        after, before = times[np.minimum(at, len(times) - 1)], times[np.maximum(at - 1, 0)]
        apart = np.minimum(np.abs(after - rows.time[fit[mine]]), np.abs(before - rows.time[fit[mine]]))
        near[mine] = apart < guard_s
    return near
