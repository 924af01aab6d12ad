"""One pair of signals at a given offset and skew: its map by robust least squares, and what it says of the two clocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.clocks.coarse import Pair
from sysid.datasets.resample import slopes

Array = npt.NDArray[np.float64]

#: Samples that are worked on at a time: what belongs to them stays in the cache of a core.
CHUNK = 8192


@dataclass(frozen=True)
class Prepared:
    """A pair with the slopes of ``x`` (n,) at its samples; steps of x longer than ``x_gap_s`` are not bridged."""

    x_times: Array
    x: Array
    slopes: Array
    y_times: Array
    y: Array
    degree: int
    x_gap_s: float


def prepared(pair: Pair) -> Prepared:
    """Samples that are known, and the slopes of the smooth curve through those of ``x``."""
    known = ~np.isnan(pair.x)
    times, values = pair.x_times[known], pair.x[known]
    return Prepared(times, values, slopes(times, values, pair.x_gap_s), pair.y_times, pair.y, pair.degree, pair.x_gap_s)


@dataclass(frozen=True)
class Sums:
    """Everything that a Gauss-Newton step and its errors need, with the map projected out.

    ``normal`` (2, 2) and ``score`` (2,) are of (offset, skew); ``curvature`` (2, 2) is the slope of the score, less than
    ``normal`` as weights fall where residuals grow; ``white`` (2, 2) is the covariance of the score if residuals are
    uncorrelated; ``block_*`` belong to the numbered ``blocks`` (b,).
    """

    normal: Array
    score: Array
    curvature: Array
    white: Array
    count: int
    weighted_squares: float
    explained: float
    blocks: npt.NDArray[np.int64]
    block_scores: Array
    block_weight: Array
    block_squares: Array
    block_counts: Array


@dataclass
class PairFit:
    """The state of an iteration over one pair: the samples in use, the map's coefficients, the scale of the noise."""

    pair: Prepared
    rows: slice = field(default_factory=lambda: slice(None))
    coefficients: Array = field(default_factory=lambda: np.zeros(0))
    scale: float = 0.0
    centre: float = 0.0
    half: float = 1.0
    _residuals: list[Array] = field(default_factory=list)
    _system: tuple[Array, Array, Array] | None = None

    def choose(self, window: tuple[float, float], limit: int | None) -> None:
        """Use the samples of y in ``window``, at most about ``limit`` of them, evenly."""
        first, last = np.searchsorted(self.pair.y_times, window)
        stride = 1 if limit is None else max(1, int(last - first) // limit)
        self.rows = slice(int(first), int(last), stride)

    def begin(self, offset: float, skew: float, reference: float) -> None:
        """A map and a scale at this offset and skew, from nothing."""
        self.coefficients = np.zeros(0)
        chunks = list(self._chunks(offset, skew, reference))
        y, x = (np.concatenate([chunk[k] for chunk in chunks]) if chunks else np.zeros(0) for k in (1, 2))
        if len(y) < self._fewest:
            return
        low, high = float(x.min()), float(x.max())
        if high <= low:
            return
        self.centre, self.half = (high + low) / 2.0, (high - low) / 2.0
        basis = self._basis(x)
        weight, residual = np.ones(len(y)), y
        for _ in range(4):
            weighted = basis * weight
            self.coefficients = _solve(weighted @ basis.T, weighted @ y)
            residual = y - self.coefficients @ basis
            self.scale = _scale(residual)
            weight = self._weight(residual)

    def settle(self, step: Array, hold: bool) -> None:
        """The map after the last :meth:`sums` and a ``step`` of offset and skew; the scale too unless it is held."""
        if self._system is not None:
            inner, right, cross = self._system
            self.coefficients = self.coefficients + _solve(inner, right - cross @ step)
            if not hold:
                self.scale = _scale(np.concatenate(self._residuals))

    def sums(self, offset: float, skew: float, reference: float, block_s: float = 0.0) -> Sums | None:
        """One sweep over the samples in use; None where too few of them overlap.

        Args:
            block_s: length of the blocks [s]; 0 leaves them out.
        """
        self._residuals, self._system = [], None
        size = len(self.coefficients)
        if not size:
            return None
        matrix, right = np.zeros((size + 2, size + 2)), np.zeros(size + 2)
        parts: list[tuple[npt.NDArray[np.int64], Array]] = []
        count, weights, slopes_of_scores, plain, robust = 0, 0.0, 0.0, 0.0, 0.0
        sum_y, sum_y2 = 0.0, 0.0
        derivative = np.polynomial.chebyshev.chebder(self.coefficients) / self.half
        for times, y, x, rate in self._chunks(offset, skew, reference):
            basis = self._basis(x)
            residual = y - self.coefficients @ basis
            weight = self._weight(residual)
            slope = derivative @ basis[:-1]
            rows = np.empty((size + 2, len(y)))
            rows[:size] = basis
            np.multiply(slope, rate, out=rows[size])
            np.multiply(rows[size], times - reference, out=rows[size + 1])
            weighted = rows * weight
            matrix += weighted @ rows.T
            right += weighted @ residual
            count += len(y)
            squares = residual**2
            weights += float(weight.sum())
            slopes_of_scores += float(np.sum(weight**3))  # d(r·w)/dr of soft-L1
            plain += float(np.dot(weight, squares))
            robust += float(np.dot(weight**2, squares))
            sum_y, sum_y2 = sum_y + float(y.sum()), sum_y2 + float(np.dot(y, y))
            self._residuals.append(residual)
            if block_s:
                parts.append(_by_block(times, block_s, weighted, residual, weighted[size] * rows[size], squares))
        if count < self._fewest:
            return None
        inner = matrix[:size, :size]
        projection = _solve(inner, matrix[:size, size:])  # of offset and skew on the map
        normal = matrix[size:, size:] - projection.T @ matrix[:size, size:]
        score = right[size:] - projection.T @ right[:size]
        self._system = inner, right[:size], matrix[:size, size:]
        noise = self.scale**2
        variance = max(sum_y2 / count - (sum_y / count) ** 2, 1e-30)
        blocks, table = _merged(parts) if parts else (np.zeros(0, np.int64), np.zeros((0, size + 5)))
        scores = (table[:, size : size + 2] - table[:, :size] @ projection) / noise
        return Sums(
            normal=normal / noise,
            score=score / noise,
            curvature=normal / noise * (slopes_of_scores / weights),
            white=normal / noise * (robust / noise / weights),
            count=count,
            weighted_squares=plain / noise,
            explained=1.0 - plain / weights / variance,
            blocks=blocks,
            block_scores=scores,
            block_weight=table[:, size + 2] / noise,
            block_squares=table[:, size + 3] / noise,
            block_counts=table[:, size + 4],
        )

    def residuals(self, offset: float, skew: float, reference: float) -> tuple[Array, Array]:
        """x and the residual of y at every sample in use where x is known."""
        chunks = [(x, y - self.coefficients @ self._basis(x)) for _, y, x, _ in self._chunks(offset, skew, reference)]
        return np.concatenate([x for x, _ in chunks]), np.concatenate([residual for _, residual in chunks])

    def squares(self, window: tuple[float, float], offset: float, skew: float, reference: float) -> Array:
        """Squared residuals in variances of the noise, of each sample in ``window``; NaN where x is not known."""
        first, last = np.searchsorted(self.pair.y_times, window)
        times, y = self.pair.y_times[first:last], self.pair.y[first:last]
        if not len(self.coefficients):
            return np.full(len(times), np.nan)
        x, _, known = self._x(times + offset + skew * (times - reference))
        u = np.clip((x - self.centre) / self.half, -1.0, 1.0) * self.half + self.centre
        residual = y - self.coefficients @ self._basis(u)
        return np.where(known, (residual / self.scale) ** 2, np.nan)

    @property
    def _fewest(self) -> int:
        """Samples that a map needs, the more the higher its degree."""
        return 20 * (self.pair.degree + 3) if self.rows.step in (None, 1) else 4 * (self.pair.degree + 3)

    def _weight(self, residual: Array) -> Array:
        """Soft-L1 with its knee at two standard deviations: noise counts in full, mistaken frames hardly."""
        return np.asarray(1.0 / np.sqrt(1.0 + (residual / (2.0 * self.scale)) ** 2))

    def _basis(self, x: Array) -> Array:
        """Chebyshev polynomials of the map's argument, (degree + 1, n)."""
        u = (x - self.centre) / self.half
        basis = np.empty((self.pair.degree + 1, len(x)))
        basis[0], basis[1] = 1.0, u
        twice = 2.0 * u
        for k in range(2, self.pair.degree + 1):
            np.multiply(twice, basis[k - 1], out=basis[k])
            basis[k] -= basis[k - 2]
        return basis

    def _chunks(self, offset: float, skew: float, reference: float) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Stream times, y, x there and the rate of x, wherever both are known."""
        all_times, all_y = self.pair.y_times[self.rows], self.pair.y[self.rows]
        for first in range(0, len(all_times), CHUNK):
            times, y = all_times[first : first + CHUNK], all_y[first : first + CHUNK]
            at = times + offset + skew * (times - reference)
            x, rate, known = self._x(at)
            if known.all():
                yield times, y, x, rate
            elif known.any():
                yield times[known], y[known], x[known], rate[known]

    def _x(self, at: Array) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        """Cubic Hermite interpolation of x: values, rates, and where neither gap nor end is in the way."""
        p = self.pair
        right = np.searchsorted(p.x_times, at, side="right")
        known = (right > 0) & (right < len(p.x_times))
        right = np.clip(right, 1, len(p.x_times) - 1)
        left = right - 1
        start, a, b = p.x_times[left], p.x[left], p.x[right]
        step = p.x_times[right] - start
        known &= step <= p.x_gap_s
        s = (at - start) / step
        da, db, rise = p.slopes[left] * step, p.slopes[right] * step, b - a
        # Horner form of the cubic through both values with both slopes.
        c2, c3 = 3.0 * rise - 2.0 * da - db, da + db - 2.0 * rise
        return a + s * (da + s * (c2 + s * c3)), (da + s * (2.0 * c2 + 3.0 * s * c3)) / step, known


def _by_block(
    times: Array, block_s: float, weighted: Array, residual: Array, weight: Array, squares: Array
) -> tuple[npt.NDArray[np.int64], Array]:
    """Numbers of the blocks, and sums over each: scores (rows of ``weighted`` times residual), weight, squares, count."""
    number = np.floor(times / block_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    table = np.vstack([weighted * residual, weight, squares, np.ones(len(times))])
    return number[starts], np.add.reduceat(table, starts, axis=1).T


def _merged(parts: Sequence[tuple[npt.NDArray[np.int64], Array]]) -> tuple[npt.NDArray[np.int64], Array]:
    """Blocks that a chunk ended within are put together again."""
    numbers, tables = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    return numbers[starts], np.add.reduceat(tables, starts, axis=0)


def _scale(residual: Array) -> float:
    """Standard deviation of the noise, from the median."""
    return 1.4826 * float(np.median(np.abs(residual))) + 1e-15


def _solve(matrix: Array, right: Array) -> Array:
    """Normal equations of a Chebyshev basis; a ridge far below the noise keeps a sparse range solvable."""
    return np.asarray(np.linalg.solve(matrix + 1e-12 * np.trace(matrix) * np.eye(len(matrix)), right))
