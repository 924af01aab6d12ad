"""Reversals of a signal: changes of direction by more than a least size."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Values that are looked at together after a reversal, and at most.
_FEW, _MOST = 64, 2**16


def turning_points(values: Array, least: float) -> int:
    """Number of reversals of a signal without gaps (n,) by more than ``least``; 0 if that is not positive."""
    return len(turning_rows(values, least)) if least > 0.0 else 0


def turning_rows(values: Array, least: float) -> npt.NDArray[np.intp]:
    """Rows at which it is certain that a signal without gaps (n,) has reversed by more than ``least``.

    The first motion by more than ``least``, in either direction, is none.
    """
    found: list[int] = []
    direction, low, high, row, piece = 0, np.inf, -np.inf, 0, _FEW
    while row < len(values):
        some = values[row : row + piece]
        rise = some - np.minimum(np.minimum.accumulate(some), low) > least if direction <= 0 else None
        fall = np.maximum(np.maximum.accumulate(some), high) - some > least if direction >= 0 else None
        up, down = _first(rise), _first(fall)
        if up is None and down is None:
            low, high, row = min(low, float(some.min())), max(high, float(some.max())), row + len(some)
            piece = min(2 * piece, _MOST)
            continue
        rises = down is None or (up is not None and up < down)
        row += (up if rises else down) or 0
        if direction:
            found.append(row)
        direction, low, high = (1, low, float(values[row])) if rises else (-1, float(values[row]), high)
        row, piece = row + 1, _FEW
    return np.array(found, dtype=np.intp)


def _first(mask: npt.NDArray[np.bool_] | None) -> int | None:
    """The first True of a mask."""
    if mask is None:
        return None
    place = int(np.argmax(mask))
    return place if mask[place] else None
