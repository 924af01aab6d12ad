"""One pair of signals at a given offset and skew: its map by robust least squares, and its normal equations of the clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import Array, Mask
from sysid.datasets.clocks.coarse import Pair
from sysid.datasets.clocks.measured_motion import directions, range_of, without_noise
from sysid.datasets.resample import slopes
from sysid.scratch import chosen

#: Samples that are processed at a time, so that their data stay in the cache of a core.
CHUNK = 8192
#: A motion back by less than this many standard deviations of the noise is no reversal.
TREMOR = 4.0
#: A rate below this share of its root mean square counts as rest.
MOVING = 0.1
#: Mean square of the residuals in motion, in variances of the noise, above which a pair does not fit there.
MISFIT = 2.0
#: Longest gap of y over which its motion is smoothed [periods].
GAP_PERIODS = 3.5


@dataclass(frozen=True)
class PreparedPair:
    """A pair with the slopes of ``x`` (n,) at its samples; steps of x longer than ``x_gap_s`` are not bridged.

    With backlash, ``direction`` (n,) is that of the motion of x, and only ``settled`` samples of x (n,) and of y (m,) are used
    (:func:`sysid.datasets.clocks.measured_motion.directions`); else all three are empty.
    """

    x_times: Array
    x: Array
    slopes: Array
    y_times: Array
    y: Array
    degree: int
    x_gap_s: float
    direction: Array
    settled: Mask
    y_settled: Mask

    @property
    def branches(self) -> int:
        """Terms of the map that depend on the direction: an intercept and a slope."""
        return 2 if len(self.direction) else 0


def prepared(pair: Pair) -> PreparedPair:
    """The known samples, and the slopes of the smooth curve through those of ``x``."""
    known = ~np.isnan(pair.x)
    times, values = chosen(pair.x_times, known), chosen(pair.x, known)
    rates = slopes(times, values, pair.x_gap_s)
    direction, settled, y_settled = (
        _taken_up(pair, values, rates) if pair.backlash > 0.0 else (np.empty(0), *2 * (np.empty(0, bool),))
    )
    return PreparedPair(times, values, rates, pair.y_times, pair.y, pair.degree, pair.x_gap_s, direction, settled, y_settled)


def _taken_up(pair: Pair, x: Array, rates: Array) -> tuple[Array, Mask, Mask]:
    """Direction of x (n,), and the samples of x and of y with the backlash taken up; either signal may be behind it.

    Samples at rest are not used: they carry no information about the offset, and a motion back may be hidden in their noise.
    """
    direction, settled = directions(x, pair.backlash, TREMOR * pair.noise)
    settled &= np.abs(rates) > MOVING * float(np.sqrt(np.mean(rates**2)))
    y, noise = without_noise(pair.y_times, pair.y, GAP_PERIODS * float(np.median(np.diff(pair.y_times))))
    width = pair.backlash * range_of(y) / max(range_of(x), 1e-300)
    return direction, settled, directions(y, width, TREMOR * noise)[1]


@dataclass(frozen=True)
class FitSums:
    """Sums for a Gauss-Newton step and its errors, with the map projected out.

    ``normal`` (2, 2) and ``score`` (2,) are of (offset, skew); ``curvature`` (2, 2) is the derivative of the score, smaller
    than ``normal`` because weights fall where residuals grow; ``white`` (2, 2) is the covariance of the score for uncorrelated
    residuals; ``block_sums`` (b, 6) are those of the numbered ``blocks`` (b,): scores of offset and skew, information about the
    offset with a known map, squares, information with an unknown one, number of samples. ``intercept`` is half of the
    difference of the map between the two directions in the middle of the motion, and its standard error; NaN without backlash.
    """

    normal: Array
    score: Array
    curvature: Array
    white: Array
    count: int
    weighted_squares: float
    explained: float
    blocks: npt.NDArray[np.int64]
    block_sums: Array
    intercept: tuple[float, float] = (float("nan"), float("nan"))


@dataclass
class PairFit:
    """The state of an iteration over one pair: the samples in use, the map's coefficients, the scale of the residuals.

    ``scale`` is that of the samples that determine the clock, ``noise`` that of all, each by its median. A pair that rests most
    of the time and does not fit where it moves, because of backlash for instance, would otherwise have the weight of its noise.
    """

    pair: PreparedPair
    rows: slice = field(default_factory=lambda: slice(None))
    coefficients: Array = field(default_factory=lambda: np.zeros(0))
    scale: float = 0.0
    noise: float = 0.0
    centre: float = 0.0
    half: float = 1.0
    _residuals: list[Array] = field(default_factory=list)
    _rates: list[Array] = field(default_factory=list)
    _system: tuple[Array, Array, Array] | None = None
    _projection: Array | None = None

    def choose(self, window: tuple[float, float], limit: int | None) -> None:
        """Use the samples of y in ``window``, evenly thinned to about ``limit``."""
        first, last = np.searchsorted(self.pair.y_times, window)
        stride = 1 if limit is None else max(1, int(last - first) // limit)
        self.rows = slice(int(first), int(last), stride)

    def begin(self, offset: float, skew: float, reference: float) -> None:
        """Initial map and scale at this offset and skew."""
        self.coefficients, self._projection = np.zeros(0), None
        chunks = list(self._chunks(offset, skew, reference))
        parts = (np.concatenate([chunk[k] for chunk in chunks]) if chunks else np.zeros(0) for k in (1, 2, 3, 4))
        y, x, rates, direction = parts
        if len(y) < self._min_samples:
            return
        low, high = float(x.min()), float(x.max())
        if high <= low:
            return
        self.centre, self.half = (high + low) / 2.0, (high - low) / 2.0
        basis = self._basis(x, direction)
        weight, residual = np.ones(len(y)), y
        for _ in range(4):
            weighted = basis * weight
            self.coefficients = _solve(weighted @ basis.T, weighted @ y)
            residual = y - self.coefficients @ basis
            self._rescale(residual, rates)
            weight = self._weight(residual)

    def settle(self, step: Array, hold: bool) -> None:
        """Update the map after the last :meth:`sums` and a ``step`` of offset and skew, and the scale unless ``hold``."""
        if self._system is not None:
            inner, right, cross = self._system
            self.coefficients = self.coefficients + _solve(inner, right - cross @ step)
            if not hold:
                self._rescale(np.concatenate(self._residuals), np.concatenate(self._rates))

    def sums(self, offset: float, skew: float, reference: float, block_s: float = 0.0) -> FitSums | None:
        """Sums over the samples in use; None where too few overlap.

        Args:
            block_s: length of the blocks [s]; 0: no blocks.
        """
        self._residuals, self._rates, self._system = [], [], None
        size = len(self.coefficients)
        if not size:
            return None
        matrix, right = np.zeros((size + 2, size + 2)), np.zeros(size + 2)
        parts: list[tuple[npt.NDArray[np.int64], Array]] = []
        count, weights, slopes_of_scores, plain, robust = 0, 0.0, 0.0, 0.0, 0.0
        sum_y, sum_y2 = 0.0, 0.0
        degree = self.pair.degree
        derivative = np.polynomial.chebyshev.chebder(self.coefficients[: degree + 1]) / self.half
        for times, y, x, rate, direction in self._chunks(offset, skew, reference):
            basis = self._basis(x, direction)
            residual = y - self.coefficients @ basis
            weight = self._weight(residual)
            slope = derivative @ basis[:degree]
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
            self._rates.append(rate)
            if block_s:
                alone = rows[size] if self._projection is None else rows[size] - self._projection[:, 0] @ basis
                own = weighted[size] * rows[size], squares, weight * alone**2
                parts.append(_by_block(times, block_s, weighted * residual, own))
        if count < self._min_samples:
            return None
        inner = matrix[:size, :size]
        projection = _solve(inner, matrix[:size, size:])  # of offset and skew on the map
        normal = matrix[size:, size:] - projection.T @ matrix[:size, size:]
        score = right[size:] - projection.T @ right[:size]
        self._system, self._projection = (inner, right[:size], matrix[:size, size:]), projection
        noise = self.scale**2
        variance = max(sum_y2 / count - (sum_y / count) ** 2, 1e-30)
        blocks, table = _merged(parts) if parts else (np.zeros(0, np.int64), np.zeros((0, size + 6)))
        sums = table[:, size:].copy()
        sums[:, :2] -= table[:, :size] @ projection
        sums[:, :5] /= noise
        return FitSums(
            normal=normal / noise,
            score=score / noise,
            curvature=normal / noise * (slopes_of_scores / weights),
            white=normal / noise * (robust / noise / weights),
            count=count,
            weighted_squares=plain / noise,
            explained=1.0 - plain / weights / variance,
            blocks=blocks,
            block_sums=sums,
            intercept=self._intercept(matrix, table, noise * robust / noise / weights)
            if self.pair.branches
            else (np.nan, np.nan),
        )

    def _intercept(self, matrix: Array, table: Array, variance: float) -> tuple[float, float]:
        """Half of the difference between the directions in the middle of the motion, and its error, computed as of the offset.

        Args:
            matrix: normal equations of the map, offset and skew.
            table: scores of blocks (b, …).
            variance: of a residual.
        """
        row = self.pair.degree + 1
        inverse = _solve(matrix, np.eye(len(matrix)))[row]
        influence = table[:, : len(matrix)] @ inverse
        errors = [variance * float(inverse[row])]
        for together in (1, 3):
            sums = np.add.reduceat(influence, np.arange(0, len(influence), together)) if len(influence) else influence
            if len(sums) > 2:
                errors.append(float(np.sum(sums**2)) * len(sums) / (len(sums) - 2))
        return float(self.coefficients[row]), float(np.sqrt(max(*errors, 0.0)))

    def residuals(self, offset: float, skew: float, reference: float) -> tuple[Array, Array]:
        """x and the residual of y at every sample in use where x is known."""
        chunks = [(x, y - self.coefficients @ self._basis(x, d)) for _, y, x, _, d in self._chunks(offset, skew, reference)]
        return np.concatenate([x for x, _ in chunks]), np.concatenate([residual for _, residual in chunks])

    def squares(self, window: tuple[float, float], offset: float, skew: float, reference: float) -> Array:
        """Squared residuals in variances of the noise, of each sample in ``window``; NaN where x is not known."""
        first, last = np.searchsorted(self.pair.y_times, window)
        times, y = self.pair.y_times[first:last], self.pair.y[first:last]
        if not len(self.coefficients):
            return np.full(len(times), np.nan)
        x, _, known, direction = self._x(times + offset + skew * (times - reference))
        u = np.clip((x - self.centre) / self.half, -1.0, 1.0) * self.half + self.centre
        residual = y - self.coefficients @ self._basis(u, direction)
        return np.where(known, (residual / self.scale) ** 2, np.nan)

    @property
    def fits_in_motion(self) -> bool:
        """Whether the residuals are noise where the pair moves."""
        return self.scale**2 <= MISFIT * self.noise**2

    def _rescale(self, residual: Array, rates: Array) -> None:
        self.noise = _scale(residual)
        self.scale = max(self.noise, _scale(residual, rates**2))

    @property
    def _min_samples(self) -> int:
        """Samples that a map of this degree needs."""
        terms = self.pair.degree + 3 + self.pair.branches
        return 20 * terms if self.rows.step in (None, 1) else 4 * terms

    def _weight(self, residual: Array) -> Array:
        """Soft-L1 with its knee at two standard deviations."""
        return np.asarray(1.0 / np.sqrt(1.0 + (residual / (2.0 * self.scale)) ** 2))

    def _basis(self, x: Array, direction: Array) -> Array:
        """Chebyshev polynomials of the map's argument, (degree + 1, n), with backlash two more rows for the direction."""
        u = (x - self.centre) / self.half
        basis = np.empty((self.pair.degree + 1 + self.pair.branches, len(x)))
        basis[0], basis[1] = 1.0, u
        twice = 2.0 * u
        for k in range(2, self.pair.degree + 1):
            np.multiply(twice, basis[k - 1], out=basis[k])
            basis[k] -= basis[k - 2]
        if self.pair.branches:
            basis[-2] = direction
            np.multiply(direction, u, out=basis[-1])
        return basis

    def _chunks(self, offset: float, skew: float, reference: float) -> Iterator[tuple[Array, Array, Array, Array, Array]]:
        """Stream times, y, x there, the rate of x and its direction, at samples where both are known and settled."""
        all_times, all_y = self.pair.y_times[self.rows], self.pair.y[self.rows]
        for first in range(0, len(all_times), CHUNK):
            times, y = all_times[first : first + CHUNK], all_y[first : first + CHUNK]
            at = times + offset + skew * (times - reference)
            x, rate, known, direction = self._x(at)
            if self.pair.branches:
                known &= self.pair.y_settled[self.rows][first : first + CHUNK]
            if known.all():
                yield times, y, x, rate, direction
            elif known.any():
                yield times[known], y[known], x[known], rate[known], direction[known]

    def _x(self, at: Array) -> tuple[Array, Array, Mask, Array]:
        """Cubic Hermite interpolation of x: values, rates, mask of known and settled samples, and directions."""
        p = self.pair
        right = np.searchsorted(p.x_times, at, side="right")
        known = (right > 0) & (right < len(p.x_times))
        right = np.clip(right, 1, len(p.x_times) - 1)
        left = right - 1
        start, a, b = p.x_times[left], p.x[left], p.x[right]
        step = p.x_times[right] - start
        known &= step <= p.x_gap_s
        if p.branches:
            known &= p.settled[left] & p.settled[right]
        s = (at - start) / step
        da, db, rise = p.slopes[left] * step, p.slopes[right] * step, b - a
        # Horner form of the cubic through both values with both slopes.
        c2, c3 = 3.0 * rise - 2.0 * da - db, da + db - 2.0 * rise
        rate = (da + s * (2.0 * c2 + 3.0 * s * c3)) / step
        return a + s * (da + s * (c2 + s * c3)), rate, known, p.direction[left] if p.branches else s


def _by_block(times: Array, block_s: float, scores: Array, own: Sequence[Array]) -> tuple[npt.NDArray[np.int64], Array]:
    """Numbers of the blocks, and sums over each: rows of ``scores``, each of ``own``, count."""
    number = np.floor(times / block_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    table = np.vstack([scores, *own, np.ones(len(times))])
    return number[starts], np.add.reduceat(table, starts, axis=1).T


def _merged(parts: Sequence[tuple[npt.NDArray[np.int64], Array]]) -> tuple[npt.NDArray[np.int64], Array]:
    """Blocks that were divided by the end of a chunk, joined."""
    numbers, tables = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    return numbers[starts], np.add.reduceat(tables, starts, axis=0)


def _scale(residual: Array, weight: Array | None = None) -> float:
    """Standard deviation of the noise, from the median; ``weight`` (n,) of the samples."""
    size = np.abs(residual)
    if weight is None:
        return 1.4826 * float(np.median(size)) + 1e-15
    order = np.argsort(size)
    share = np.cumsum(weight[order])
    return 1.4826 * float(size[order][np.searchsorted(share, 0.5 * share[-1])]) + 1e-15


def _solve(matrix: Array, right: Array) -> Array:
    """Normal equations of a Chebyshev basis, with a ridge far below the noise for sparsely covered ranges."""
    return np.asarray(np.linalg.solve(matrix + 1e-12 * np.trace(matrix) * np.eye(len(matrix)), right))
