"""How far a prediction can be trusted: intervals that hold as often as they say, and queries that lie outside the data.

Intervals are split-conformal: on rows that taught nothing the error is divided by a scale, the spread of the members beside a
floor that they share, and an interval reaches as many scales as that share of these rows needed. For rows like these it then
holds at least as often as asked, whatever the network and its errors are like; it is about measurements, noise of the sensor
included. Far from all data nothing can be promised: such queries are flagged instead, by their distance to the nearest rows.

Source: Lei, G'Sell, Rinaldo, Tibshirani, Wasserman, JASA 113 (2018); the distance to the k-th neighbour as a measure of
novelty: Ramaswamy, Rastogi, Shim, SIGMOD (2000), its threshold by leaving one out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, StoreError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Rows count as outside a range beyond this share of it: its ends are the extremes of a sample.
END_SHARE = 0.02
#: So many rows like those that were learned from are flagged by their distance all the same.
FALSE_FLAGS = 0.01
#: The neighbour whose distance counts.
NEIGHBOUR = 3
#: Rows of the data that are kept to measure distances to.
MOST_ROWS = 2000
_DOMAIN = ("rows", "mean", "scale", "low", "high", "threshold")
_INTERVALS = ("floor", "scores")


def within(values: Array, low: Array, high: Array) -> Mask:
    """Whether each row of ``values`` (n, d) lies between ``low`` and ``high`` (d,), give or take :data:`END_SHARE`."""
    margin = END_SHARE * (high - low)
    return np.asarray(np.all((values >= low - margin) & (values <= high + margin), axis=1))


@dataclass(frozen=True)
class TrainingDomain:
    """Where the data are.

    Args:
        rows: of the data, standardised, (n, d).
        mean, scale: by which, (d,).
        low, high: range of each input in the data, (d,).
        threshold: distance to the :data:`NEIGHBOUR`-th row that all but :data:`FALSE_FLAGS` of the rows keep to the others, or
            less; never shorter than :data:`END_SHARE` of the ranges.
    """

    rows: Array
    mean: Array
    scale: Array
    low: Array
    high: Array
    threshold: float

    @staticmethod
    def of(inputs: Array) -> TrainingDomain:
        """Of the rows that a network learned from, (n, d) with n > :data:`NEIGHBOUR`."""
        from scipy.spatial import KDTree

        low, high = inputs.min(axis=0), inputs.max(axis=0)
        kept = inputs[np.linspace(0, len(inputs) - 1, min(len(inputs), MOST_ROWS)).round().astype(int)]
        mean, spread = kept.mean(axis=0), kept.std(axis=0)
        scale = np.where(spread > 0.0, spread, 1.0)
        rows = (kept - mean) / scale
        apart = _distances(KDTree(rows), rows, NEIGHBOUR + 1)  # the first is the row itself
        usual = np.sort(apart)[min(_rank(len(rows), 1.0 - FALSE_FLAGS), len(rows)) - 1]
        narrow = END_SHARE * np.linalg.norm((high - low) / scale)  # dense rows: a gap like this is none
        return TrainingDomain(rows, mean, scale, low, high, float(max(usual, narrow)))

    def distance(self, values: Array) -> Array:
        """Distance of queries (n, d) to the data in units of what is usual among them: beyond 1 lies outside, (n,)."""
        return np.asarray(_distances(self._tree, (values - self.mean) / self.scale, NEIGHBOUR) / max(self.threshold, 1e-12))

    def inside(self, values: Array) -> Mask:
        """Whether queries (n, d) lie where the data are: within their ranges and not far from all of them, (n,)."""
        return np.asarray(within(values, self.low, self.high) & (self.distance(values) <= 1.0))

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self.rows)


@dataclass(frozen=True)
class Intervals:
    """How large errors are where nothing was learned.

    Args:
        floor: what an output is uncertain by where the members agree, (d_out,).
        scores: errors of the rows that taught nothing, each divided by its scale, sorted, (m, d_out).
    """

    floor: Array
    scores: Array

    @staticmethod
    def of(errors: Array, spread: Array) -> Intervals:
        """From errors on rows that taught nothing, and the spread of the members there, (m, d_out) each."""
        floor = np.array([_floor(e, s) for e, s in zip(errors.T, spread.T, strict=True)])
        return Intervals(floor, np.sort(np.abs(errors) / np.hypot(spread, floor), axis=0))

    @property
    def most_level(self) -> float:
        """The highest level that so many rows can tell, to three digits."""
        count = len(self.scores)
        return math.floor(1000.0 * count / (count + 1)) / 1000.0

    def reach(self, spread: Array, level: float) -> Array:
        """Half widths of intervals at a level, (n, d_out), where the members spread by ``spread`` (n, d_out).

        Raises:
            InputError: a level that is no share, or more than that many rows can tell.
        """
        count = len(self.scores)
        if not 0.0 < level < 1.0:
            raise InputError("interval", f"level {level:g}", "a share between 0 and 1, as 0.95")
        rank = _rank(count, level)
        if rank > count:
            expected = f"at most {self.most_level:g}"
            raise InputError(
                "interval", f"level {level:g} from {count} rows", expected, "Record more, or ask for a lower level."
            )
        return np.asarray(self.scores[rank - 1] * np.hypot(spread, self.floor))


@dataclass(frozen=True)
class NetworkUncertainty:
    """What a version knows about its own limits."""

    domain: TrainingDomain
    intervals: Intervals

    @staticmethod
    def of(inputs: Array, errors: Array, spread: Array) -> NetworkUncertainty | None:
        """From the inputs that were learned from (n, d), and errors and spread on rows that taught nothing (m, d_out).

        None where there are too few of either to say anything.
        """
        if len(inputs) <= NEIGHBOUR or not len(errors):
            return None
        return NetworkUncertainty(TrainingDomain.of(inputs), Intervals.of(errors, spread))

    def tensors(self, prefix: str) -> dict[str, Array]:
        """The arrays to store, by name."""
        found = {f"{prefix}.{name}": np.atleast_1d(getattr(self.domain, name)) for name in _DOMAIN}
        return found | {f"{prefix}.{name}": getattr(self.intervals, name) for name in _INTERVALS}

    @staticmethod
    def from_tensors(
        tensors: Mapping[str, npt.NDArray[Any]], prefix: str, width: int, outputs: int, where: object
    ) -> NetworkUncertainty | None:
        """What :meth:`tensors` gave; None where a version has none, as those of earlier releases.

        Raises:
            StoreError: arrays that do not fit the network.
        """
        if f"{prefix}.rows" not in tensors:
            return None
        own = {name: np.asarray(tensors[f"{prefix}.{name}"], dtype=np.float64) for name in (*_DOMAIN, *_INTERVALS)}
        fit = own["rows"].shape[1:] == own["low"].shape == own["high"].shape == own["mean"].shape == (width,)
        if not fit or own["scores"].shape[1:] != own["floor"].shape or own["floor"].shape != (outputs,):
            raise StoreError(
                f"{where}: {prefix}", "arrays that do not fit the network", f"{width} inputs and {outputs} outputs"
            )
        threshold = float(own.pop("threshold")[0])
        domain = TrainingDomain(**{name: own[name] for name in _DOMAIN if name != "threshold"}, threshold=threshold)
        return NetworkUncertainty(domain, Intervals(own["floor"], own["scores"]))


def known(trust: NetworkUncertainty | None, what: str) -> NetworkUncertainty:
    """``trust``, or an error that says how to get it.

    Raises:
        InputError: the version does not have it.
    """
    if trust is None:
        found = "a version that knows neither intervals nor where its data were"
        raise InputError(what, found, "one that was fitted by this release", "Fit it again, with rows to select on.")
    return trust


def _distances(tree: Any, values: Array, neighbour: int) -> Array:
    return np.asarray(tree.query(values, k=[neighbour])[0])[:, 0]


def _rank(count: int, level: float) -> int:
    """How many of ``count`` rows an interval has to hold so that it holds for the next one at ``level``."""
    return math.ceil((count + 1) * level - 1e-9)


def _floor(errors: Array, spread: Array) -> float:
    """The floor beside which the spread explains the sizes of the errors best (normal likelihood, their scale profiled)."""
    size = max(float(np.sqrt(np.mean(errors**2))), 1e-12)
    if not np.any(spread > 0.0):
        return size
    floors = size * np.logspace(-2.0, 1.0, 31)
    variances = spread**2 + floors[:, None] ** 2
    fit = 0.5 * np.log(np.mean(errors**2 / variances, axis=1)) + 0.5 * np.mean(np.log(variances), axis=1)
    return float(floors[int(np.argmin(fit))])
