"""Backlash between two measured signals: the direction of motion, and the samples at which the backlash is taken up.

Behind backlash of width w the driven side follows at a distance of w/2 to one side or the other, depending on the direction of
motion; after a reversal it rests until the backlash is taken up. Interpreted as a clock offset, that is w/2 over the speed:
tens of milliseconds for slow motion and half a degree. The map between two signals therefore has an intercept for each
direction, ``y = f(x) + c·d``, d = ±1, and samples around reversals are not used.

Source: the play operator and its two branches: Visintin, Differential Models of Hysteresis (1994), ch. III.2.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]


def directions(values: Array, width: float, tremor: float = 0.0) -> tuple[Array, Mask]:
    """Direction of motion (n,), −1 or +1, and a mask of the samples at which backlash of up to ``width`` is taken up (n,).

    Args:
        values: a motion without missing samples (n,).
        width: upper bound of the backlash; a smaller motion back is no reversal.
        tremor: a smaller motion back is noise and leaves the backlash taken up [both: unit of the motion].

    Returns:
        Between two reversals a sample is valid if it is further than ``width`` from both turning points and the motion passes
        its value only once, because either signal may be the one that rests.
    """
    turns, first = turning_rows(values, width)
    edges = np.concatenate([[0], turns, [len(values) - 1]]).astype(np.intp)
    direction, settled = np.ones(len(values)), np.zeros(len(values), dtype=bool)
    sign = first
    for k, (begin, end) in enumerate(pairwise(edges)):
        rows = slice(int(begin), int(end) + 1)
        along = sign * values[rows]
        highest, lowest = np.maximum.accumulate(along), np.minimum.accumulate(along[::-1])[::-1]
        level = (along >= highest - tremor) & (along <= lowest + tremor)
        left = along - along[0] > width
        ahead = along[-1] - along > width if k < len(edges) - 2 else np.ones(len(along), dtype=bool)
        direction[rows] = sign
        settled[rows] = level & left & ahead
        sign = -sign
    return direction, settled


def turning_rows(values: Array, least: float) -> tuple[Rows, float]:
    """Rows of the reversals of a motion (n,) by more than ``least``, and the direction before the first (−1 or +1)."""
    corners = _corners(values)
    found: list[int] = []
    sign, first = 0.0, 1.0
    low = high = int(corners[0]) if len(corners) else 0
    for row in corners.tolist():
        value = values[row]
        if value > values[high]:
            high = row
        if value < values[low]:
            low = row
        if sign >= 0.0 and values[high] - value > least and high < row:
            if sign == 0.0:
                first = 1.0 if high > low else -1.0
            if sign > 0.0 or high > low:
                found.append(high)
            sign, low, high = -1.0, row, row
        elif sign <= 0.0 and value - values[low] > least and low < row:
            if sign == 0.0:
                first = -1.0 if low > high else 1.0
            if sign < 0.0 or low > high:
                found.append(low)
            sign, low, high = 1.0, row, row
    return np.array(found, dtype=np.intp), first


def _corners(values: Array) -> Rows:
    """Rows of all turning points of the motion, and its ends."""
    rise = np.sign(np.diff(values))
    rows = np.flatnonzero(rise) + 1  # the sample after each change
    turned = np.flatnonzero(np.diff(rise[rows - 1]) != 0.0)
    inner = rows[turned]
    return np.unique(np.concatenate([[0], inner, [max(len(values) - 1, 0)]])).astype(np.intp)
