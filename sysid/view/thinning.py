"""Which samples of a long recording are shown: a viewer holds all in memory, and a screen is some thousand points wide."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.chunked import strided
from sysid.scratch import MAPPED_PIECES, PIECE, leave

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

#: Samples of a curve, or poses, from which a recording is thinned to at most as many.
MOST = 2**20


def stride(count: int) -> int:
    """Every so manieth pose of ``count`` is shown."""
    return max(-(-count // MOST), 1)


def posed(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the poses that are shown, read block by block."""
    return pd.DataFrame({name: strided(table[name].to_numpy(), stride(len(table))) for name in table})


def bucket(count: int) -> int:
    """Of so many samples of ``count`` the lowest and the highest are shown; 1: all."""
    return 2 * stride(count) if count > MOST else 1


def shown_rows(count: int, values: Callable[[int, int], Array], whole: tuple[int, int] = (0, 0)) -> tuple[Rows, Array]:
    """Rows to show, in order, and their values: the lowest and the highest of every :func:`bucket`, so that no peak is lost.

    Args:
        count: number of rows.
        values: (first, last + 1) → their values; those without a finite one are not shown.
        whole: first and last + 1 of the rows that are all shown.
    """
    size, parts = bucket(count), list[tuple[Rows, Array]]()
    for number, first in enumerate(range(0, count, PIECE // size * size)):
        some = values(first, min(first + PIECE // size * size, count))
        there = np.isfinite(some)
        if size > 1:
            kept = np.zeros(len(some), dtype=np.bool_)
            kept[max(whole[0] - first, 0) : max(whole[1] - first, 0)] = True
            starts = np.arange(0, len(some), size)
            for worst, place in ((np.inf, np.argmin), (-np.inf, np.argmax)):
                padded = np.full(len(starts) * size, worst)
                padded[: len(some)] = np.where(there, some, worst)
                kept[np.minimum(starts + place(padded.reshape(-1, size), axis=1), len(some) - 1)] = True
            there &= kept
        rows = np.flatnonzero(there)
        parts.append((rows + first, some[rows]))
        if number % MAPPED_PIECES == MAPPED_PIECES - 1:
            leave()
    return np.concatenate([np.empty(0, np.intp), *(r for r, _ in parts)]), np.concatenate([np.empty(0), *(v for _, v in parts)])
