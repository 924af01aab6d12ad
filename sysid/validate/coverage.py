"""Do the intervals hold, and is the flag for queries outside the data right? Counted on rows that nothing was learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: The level at which intervals are evaluated, where there were rows enough to tell it.
LEVEL = 0.95
THIRDS = ("lower", "middle", "upper")


@dataclass(frozen=True)
class Region:
    """Rows of one kind: how many, the share of them inside their intervals, and how large the errors are there."""

    name: str
    count: int
    covered: float
    rmse: float


@dataclass(frozen=True)
class Coverage:
    """Intervals and flag of one output on rows that it has not seen.

    Args:
        level: asked for.
        covered: share of the rows inside their intervals.
        half_width: median of the intervals' half widths, in the unit of the output.
        flagged: share of the rows that are flagged as outside the data; ``expected`` of rows like those that were learned from.
        regions: inside and outside the data, and each third of every input's range.
    """

    level: float
    covered: float
    half_width: float
    flagged: float
    expected: float
    regions: tuple[Region, ...]


def coverage_of(
    truth: Array,
    interval: tuple[Array, Array],
    inside: Mask,
    inputs: Array,
    names: Sequence[str],
    expected: float,
    level: float = LEVEL,
) -> Coverage:
    """Count how often intervals hold.

    Args:
        truth: (n,); ``interval``: lower and upper ends, (n,) each, of a prediction in their middle.
        inside: rows that are not flagged, (n,).
        inputs: (n, d), columns named ``names``.
        expected: share of rows like those that were learned from that are flagged.
    """
    low, high = interval
    holds = (truth >= low) & (truth <= high)
    errors = 0.5 * (low + high) - truth
    groups: list[tuple[str, Mask]] = [("inside the data", inside), ("outside the data", ~inside)]
    for column, name in zip(inputs.T, names, strict=True):
        first, last = float(column.min()), float(column.max())
        third = np.clip(((column - first) / max(last - first, 1e-300) * 3.0).astype(int), 0, 2)
        groups += [(f"{name}, {where} third", third == number) for number, where in enumerate(THIRDS)]
    regions = tuple(
        Region(name, int(rows.sum()), float(holds[rows].mean()), float(np.sqrt(np.mean(errors[rows] ** 2))))
        for name, rows in groups
        if rows.any()
    )
    return Coverage(
        level=level,
        covered=float(holds.mean()),
        half_width=float(np.median(0.5 * (high - low))),
        flagged=float(np.mean(~inside)),
        expected=expected,
        regions=regions,
    )
