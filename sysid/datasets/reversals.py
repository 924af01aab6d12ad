"""Reversals of a signal: changes of direction by more than a least size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np
import numpy.typing as npt

from sysid.scratch import pieces

Array = npt.NDArray[np.float64]


def turning_points(values: Array, least: float) -> int:
    """Number of reversals of a signal without gaps (n,) by more than ``least``; 0 if that is not positive."""
    if least <= 0.0 or not len(values):
        return 0
    return sum(1 for _ in _turns(chain([float(values[0])], _corners(values)), least))


def turning_rows(values: Array, least: float) -> npt.NDArray[np.intp]:
    """Rows at which it is certain that a signal without gaps (n,) has reversed by more than ``least``."""
    return np.array(list(_turns(values.tolist(), least)), dtype=np.intp)


def _turns(values: Iterable[float], least: float) -> Iterator[int]:
    """Indices at which reversals are certain. The first motion by more than ``least``, in either direction, is none."""
    direction, low, high = 0, np.inf, -np.inf
    for row, value in enumerate(values):
        low, high = min(low, value), max(high, value)
        if direction <= 0 and value - low > least:
            if direction:
                yield row
            direction, high = 1, value
        elif direction >= 0 and high - value > least:
            if direction:
                yield row
            direction, low = -1, value


def _corners(values: Array) -> Iterator[float]:
    """The ends of all monotonic stretches of the signal."""
    before = values[:0]  # the last two different values, for the direction
    for first, last in pieces(len(values)):
        some = np.concatenate([before, values[first:last]])
        changed = some[np.concatenate([[True], np.diff(some) != 0.0])]
        up = np.diff(changed) > 0.0
        yield from changed[1:-1][up[1:] != up[:-1]].tolist()
        before = changed[-2:]
    yield from before[1:].tolist()
