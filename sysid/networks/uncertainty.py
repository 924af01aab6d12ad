"""Prediction intervals with a guaranteed coverage, and a flag for queries outside the training domain.

Intervals are split-conformal: on calibration rows that were not fitted, the error is divided by a scale, the ensemble spread
combined with a common floor; an interval is the scale times a quantile of these scores. For exchangeable rows the coverage is
at least the nominal level for any network; it is that of measurements, sensor noise included. There is no guarantee far from
the data: such queries are flagged by their distance to the nearest rows.

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

#: Margin of a range as a share of it, since its ends are sample extremes.
END_SHARE = 0.02
#: Share of rows like the training rows that are flagged by their distance (false-positive rate).
FALSE_FLAGS = 0.01
#: The distance is that to this nearest neighbour.
NEIGHBOURS = 3
#: Largest number of training rows that are stored for distances.
MAX_REFERENCE_ROWS = 2000
_DOMAIN = ("rows", "mean", "scale", "low", "high", "threshold")
_INTERVALS = ("floor", "scores")


def within(values: Array, low: Array, high: Array) -> Mask:
    """Whether each row of ``values`` (n, d) lies between ``low`` and ``high`` (d,), give or take :data:`END_SHARE`."""
    margin = END_SHARE * (high - low)
    return np.asarray(np.all((values >= low - margin) & (values <= high + margin), axis=1))


@dataclass(frozen=True)
class TrainingDomain:
    """Region of the inputs that the training data cover.

    Args:
        rows: standardised training rows, (n, d).
        mean, scale: of the standardisation, (d,).
        low, high: range of each input, (d,).
        threshold: quantile 1 − :data:`FALSE_FLAGS` of the distances of the rows to their :data:`NEIGHBOURS`-th neighbour, at
            least :data:`END_SHARE` of the ranges.
    """

    rows: Array
    mean: Array
    scale: Array
    low: Array
    high: Array
    threshold: float

    @staticmethod
    def of(inputs: Array) -> TrainingDomain:
        """Of the training rows, (n, d) with n > :data:`NEIGHBOURS`."""
        from scipy.spatial import KDTree

        low, high = inputs.min(axis=0), inputs.max(axis=0)
        kept = inputs[np.linspace(0, len(inputs) - 1, min(len(inputs), MAX_REFERENCE_ROWS)).round().astype(int)]
        mean, spread = kept.mean(axis=0), kept.std(axis=0)
        scale = np.where(spread > 0.0, spread, 1.0)
        rows = (kept - mean) / scale
        apart = _distances(KDTree(rows), rows, NEIGHBOURS + 1)  # the first is the row itself
        usual = np.sort(apart)[min(_rank(len(rows), 1.0 - FALSE_FLAGS), len(rows)) - 1]
        narrow = END_SHARE * np.linalg.norm((high - low) / scale)  # lower bound for dense rows
        return TrainingDomain(rows, mean, scale, low, high, float(max(usual, narrow)))

    def distance(self, values: Array) -> Array:
        """Distance of queries (n, d) to the training rows in units of the threshold, (n,): above 1 is outside."""
        return np.asarray(_distances(self._tree, (values - self.mean) / self.scale, NEIGHBOURS) / max(self.threshold, 1e-12))

    def inside(self, values: Array) -> Mask:
        """Whether queries (n, d) are within the ranges and the threshold distance, (n,)."""
        return np.asarray(within(values, self.low, self.high) & (self.distance(values) <= 1.0))

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self.rows)


@dataclass(frozen=True)
class Intervals:
    """Split-conformal intervals.

    Args:
        floor: uncertainty of an output where the members agree, (d_out,).
        scores: magnitudes of the errors on the calibration rows, divided by their scales, sorted, (m, d_out).
    """

    floor: Array
    scores: Array

    @staticmethod
    def of(errors: Array, spread: Array) -> Intervals:
        """From errors on the calibration rows and the ensemble spread there, (m, d_out) each."""
        floor = np.array([_floor(e, s) for e, s in zip(errors.T, spread.T, strict=True)])
        return Intervals(floor, np.sort(np.abs(errors) / np.hypot(spread, floor), axis=0))

    @property
    def max_level(self) -> float:
        """The highest level that the number of calibration rows supports, to three digits."""
        count = len(self.scores)
        return math.floor(1000.0 * count / (count + 1)) / 1000.0

    def reach(self, spread: Array, level: float) -> Array:
        """Half-widths of the intervals at ``level``, (n, d_out), for an ensemble spread (n, d_out).

        Raises:
            InputError: a level outside (0, 1), or higher than the number of calibration rows supports.
        """
        count = len(self.scores)
        if not 0.0 < level < 1.0:
            raise InputError("interval", f"level {level:g}", "a share between 0 and 1, as 0.95")
        rank = _rank(count, level)
        if rank > count:
            expected = f"at most {self.max_level:g}"
            raise InputError(
                "interval", f"level {level:g} from {count} rows", expected, "Record more, or request a lower level."
            )
        return np.asarray(self.scores[rank - 1] * np.hypot(spread, self.floor))


@dataclass(frozen=True)
class NetworkUncertainty:
    """Training domain and intervals of a version."""

    domain: TrainingDomain
    intervals: Intervals

    @staticmethod
    def of(inputs: Array, errors: Array, spread: Array) -> NetworkUncertainty | None:
        """From the training inputs (n, d), and errors and spread on the calibration rows (m, d_out).

        None if there are too few of either.
        """
        if len(inputs) <= NEIGHBOURS or not len(errors):
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
        """Inverse of :meth:`tensors`; None for a version of an earlier release.

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


def required(uncertainty: NetworkUncertainty | None, what: str) -> NetworkUncertainty:
    """``uncertainty``, or an error if it is None.

    Raises:
        InputError: the version has no intervals and training domain.
    """
    if uncertainty is None:
        found = "a version without intervals and training domain"
        raise InputError(what, found, "one that was fitted by this release", "Fit it again, with select rows.")
    return uncertainty


def _distances(tree: Any, values: Array, neighbour: int) -> Array:
    return np.asarray(tree.query(values, k=[neighbour])[0])[:, 0]


def _rank(count: int, level: float) -> int:
    """Rank of the conformal quantile: how many of ``count`` rows an interval has to contain for coverage ``level``."""
    return math.ceil((count + 1) * level - 1e-9)


def _floor(errors: Array, spread: Array) -> float:
    """The floor that maximises the normal likelihood of the errors given the spread, with the common scale profiled out."""
    size = max(float(np.sqrt(np.mean(errors**2))), 1e-12)
    if not np.any(spread > 0.0):
        return size
    floors = size * np.logspace(-2.0, 1.0, 31)
    variances = spread**2 + floors[:, None] ** 2
    fit = 0.5 * np.log(np.mean(errors**2 / variances, axis=1)) + 0.5 * np.mean(np.log(variances), axis=1)
    return float(floors[int(np.argmin(fit))])
