"""Errors over two variables at a time: two joints, or a joint and its speed, in a table of bins with their counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from sysid.validate.binning import Cut, edges_of, explained, places_in

Array = npt.NDArray[np.float64]

#: Largest number of bins per variable, and least average number of rows per bin.
MAX_BINS, ROWS_A_BIN = 10, 6
#: Largest number of maps of an output: those that explain most.
MAX_MAPS = 6


@dataclass(frozen=True)
class MapAxis:
    """One variable of a map: its unit, its values (n,) with NaN where unknown, and its kind of bins."""

    name: str
    unit: str
    values: Array
    cut: Cut = "range"


@dataclass(frozen=True)
class ErrorMap:
    """Errors of one output in bins of two variables.

    Args:
        over, units: the two variables, and their units.
        edges: of the bins of each, (a + 1,) and (b + 1,).
        count, rmse, bias: a rows of b bins; NaN in an empty bin, in the unit of the output.
        explains: share of the error's variance that the means of the bins explain, 0 … 1.
    """

    over: tuple[str, str]
    units: tuple[str, str]
    edges: tuple[tuple[float, ...], tuple[float, ...]]
    count: tuple[tuple[int, ...], ...]
    rmse: tuple[tuple[float, ...], ...]
    bias: tuple[tuple[float, ...], ...]
    explains: float

    @property
    def worst(self) -> tuple[int, int]:
        """The bin with the largest RMSE among those with several rows."""
        sizes = np.where(np.array(self.count) >= 3, np.array(self.rmse), -1.0)
        row, column = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        return int(row), int(column)


def error_maps(errors: Array, axes: Sequence[MapAxis], pairs: Sequence[tuple[str, str]] | None = None) -> tuple[ErrorMap, ...]:
    """Maps of ``errors`` (n,) over pairs of axes, those that explain most first, at most :data:`MAX_MAPS`.

    Args:
        pairs: names of the axes to pair; default: all pairs. A constant variable has no map.
    """
    named: Mapping[str, MapAxis] = {axis.name: axis for axis in axes}
    chosen = list(combinations(named, 2)) if pairs is None else pairs
    found = [item for a, b in chosen if (item := error_map(errors, named[a], named[b])) is not None]
    return tuple(sorted(found, key=lambda item: -item.explains)[:MAX_MAPS])


def error_map(errors: Array, first: MapAxis, second: MapAxis) -> ErrorMap | None:
    """Errors over two variables; None where one of them is constant or too few rows have both."""
    there = np.isfinite(first.values) & np.isfinite(second.values)
    bins = min(MAX_BINS, int(np.sqrt(there.sum() / ROWS_A_BIN)))
    if bins < 2:
        return None
    edges = [edges_of(axis.values[there], axis.cut, bins) for axis in (first, second)]
    if edges[0] is None or edges[1] is None:
        return None
    shape = (len(edges[0]) - 1, len(edges[1]) - 1)
    place = places_in(edges[0], first.values[there]) * shape[1] + places_in(edges[1], second.values[there])
    own = errors[there]
    count = np.bincount(place, minlength=shape[0] * shape[1])
    filled = np.where(count > 0, count, np.nan)
    bias = np.bincount(place, weights=own, minlength=len(count)) / filled
    rmse = np.sqrt(np.bincount(place, weights=own**2, minlength=len(count)) / filled)
    return ErrorMap(
        over=(first.name, second.name),
        units=(first.unit, second.unit),
        edges=(tuple(edges[0].tolist()), tuple(edges[1].tolist())),
        count=tuple(map(tuple, count.reshape(shape).tolist())),
        rmse=tuple(map(tuple, rmse.reshape(shape).tolist())),
        bias=tuple(map(tuple, bias.reshape(shape).tolist())),
        explains=explained(own, place, count),
    )
