"""Statistics of long signals, computed in chunks, so that intermediate results take no memory.

Every result is bit-identical to that of the NumPy expression in the docstring.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.scratch import chosen, computed, pieces

Array = npt.NDArray[np.float64]
Values = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]


def copied(values: Values) -> Values:
    """A copy (n,)."""
    return computed(len(values), lambda first, last: values[first:last], values.dtype)


def differences(values: Values, order: int = 1) -> Values:
    """``np.diff(values, order)`` of a signal (n,)."""
    count = max(len(values) - order, 0)
    return computed(count, lambda first, last: np.diff(values[first : last + order], order), values.dtype)


def known(values: Array) -> Array:
    """A signal (n,) without its missing values; itself where none is missing."""
    return chosen(values, ~np.isnan(values))


def masked(count: int, piece: Callable[[int, int], Mask]) -> Mask:
    """A mask (count,); ``piece(first, last + 1)`` returns a part of it."""
    mask: Mask = computed(count, piece, np.bool_)
    return mask


def counted(count: int, piece: Callable[[int, int], Mask]) -> int:
    """Number of True values of a mask that ``piece`` returns as for :func:`masked`."""
    return sum(int(np.count_nonzero(piece(first, last))) for first, last in pieces(count))


def median(values: Values) -> float:
    """Median of (n,), which is reordered in place: pass a copy where the values are needed later."""
    return float(np.median(values, overwrite_input=True))


def median_step(values: Values) -> float:
    """``np.median(np.diff(values))`` of at least two stamps or times (n,)."""
    return median(differences(values))


def mean_square(values: Array) -> float:
    """``np.mean(values**2)``."""
    return float(computed(len(values), lambda first, last: values[first:last] ** 2).sum() / len(values))


def deviation(values: Array) -> float:
    """``np.std(values)``."""
    mean = values.sum() / len(values)
    away = computed(len(values), lambda first, last: values[first:last] - mean)
    np.multiply(away, away, out=away)
    return float(np.sqrt(away.sum() / len(values)))


def stretches(mask: Mask) -> tuple[Rows, Rows]:
    """First and last + 1 of each stretch of True of a mask (n,)."""
    if not len(mask):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    edges = np.flatnonzero(mask[1:] != mask[:-1]) + 1
    ends = np.concatenate([np.arange(int(mask[0])), edges, np.full(int(mask[-1]), len(mask))])
    return ends[::2], ends[1::2]


def longest_run(mask: Mask) -> int:
    """Length of the longest stretch of True."""
    first, last = stretches(mask)
    return int((last - first).max(initial=0))


def absolute(values: Array) -> Array:
    """``np.abs(values)``, in the place of ``values``."""
    return np.abs(values, out=values)


def sosfiltfilt_in_place(sections: Array, values: Array, padding: int) -> None:
    """``scipy.signal.sosfiltfilt(sections, values, padlen=padding)`` in place, in chunks."""
    from scipy.signal import sosfilt, sosfilt_zi

    before = 2.0 * values[0] - values[padding:0:-1]
    after = 2.0 * values[-1] - values[-2 : -(padding + 2) : -1]
    parts = [values[first:last] for first, last in pieces(len(values))]
    settled = sosfilt_zi(sections)
    first = before[0] if padding else values[0]
    _, state = sosfilt(sections, before, zi=settled * first) if padding else (before, settled * first)
    for part in parts:
        part[:], state = sosfilt(sections, part, zi=state)
    if padding:
        after, state = sosfilt(sections, after, zi=state)
        _, state = sosfilt(sections, after[::-1], zi=settled * after[-1])
    else:
        state = settled * values[-1]
    for part in reversed(parts):
        backwards, state = sosfilt(sections, part[::-1], zi=state)
        part[:] = backwards[::-1]
