"""Play between two measured signals: which way the motion last took it up, and where that is certain.

Behind a play of width w the driven side follows at a distance of w/2 to one side or the other, depending on the direction in
which it is driven; over a reversal it waits until the play is taken up. Taken for a lag that is w/2 over the speed: seconds of
slow motion with half a degree of play look like tens of milliseconds. So the map between two signals gets an intercept for each
direction, ``y = f(x) + c·d``, d = ±1, and samples around reversals, where the play is being taken up on whichever side, say
nothing.

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
    """Direction of motion (n,), −1 or +1, and where a play of up to ``width`` is taken up on either side (n,).

    Args:
        values: a motion without missing samples (n,).
        width: of the play, or more; a motion back by less is no reversal.
        tremor: a motion back by less is noise, and leaves the play taken up [both: unit of the motion].

    Returns:
        Between two reversals a sample counts where it is further than ``width`` from both turning points, and where the motion
        has not been there before nor comes there again since the one and until the other: what waits on the far side of a play
        may be either signal.
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
    """Rows of the reversals of a motion (n,) by more than ``least``, and the direction before the first one (−1 or +1)."""
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
    """Rows at which the motion turns at all, and its ends."""
    rise = np.sign(np.diff(values))
    rows = np.flatnonzero(rise) + 1  # the sample after each change
    turned = np.flatnonzero(np.diff(rise[rows - 1]) != 0.0)
    inner = rows[turned]
    return np.unique(np.concatenate([[0], inner, [max(len(values) - 1, 0)]])).astype(np.intp)
