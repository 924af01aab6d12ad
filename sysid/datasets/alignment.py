"""Offset and skew of another device's clock against the machine's, from motion that both have measured.

Model, for every signal pair p that shares its cause (the same joint, or a cylinder and its joint)::

    t_machine = t + o + s·(t − t_mid)            y_p(t) = f_p(x_p(t_machine)) + noise

with ``x_p`` measured on the machine's clock, ``y_p`` on the other one, and ``f_p`` an unknown smooth map (a polynomial: the
linkage between cylinder and joint, the systematic error of a sensor). ``o``, ``s`` and all maps are estimated together by
robust least squares (soft-L1 by reweighting); the maps are projected out of every step (variable projection). Commands are
never used: between a command and the motion lies the dead time of the plant. A start comes from the cross-correlation of the
rates.

Intervals are cluster-robust: scores are summed over blocks of :data:`BLOCK_S`, so autocorrelated residuals widen them. What is
estimated is the offset of the *stamps*: a constant latency of the other device is part of it and cannot be told apart.

Source: variable projection: Golub and Pereyra (1973); sandwich with clusters: Liang and Zeger (1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.resample import interpolate, low_pass
from sysid.signals import split_signal

Array = npt.NDArray[np.float64]

#: Length over which residuals may be correlated [s].
BLOCK_S = 2.0
#: Degree of the polynomial map of a pair: a sensor's error curve, a linkage.
DEGREE_SAME, DEGREE_LINKAGE = 7, 9
#: The skew is applied where its 95 % interval is no wider than this to either side [ppm].
MAX_SKEW_HALF_WIDTH = 30.0
#: A coarse match counts where the rates correlate this well and no other lag comes near.
MIN_CORRELATION, MAX_RIVAL = 0.5, 0.85
#: Share of the variance of y that f(x) has to explain, and the largest skew that a clock has (a share, not ppm).
MIN_EXPLAINED, MAX_SKEW = 0.95, 2e-3
_COARSE_HZ = 50.0


@dataclass(frozen=True)
class Pair:
    """One cause measured on both clocks; times in seconds from the start of the recording (x) and of the stream (y)."""

    name: str
    x_times: Array
    x: Array
    y_times: Array
    y: Array
    degree: int
    x_gap_s: float


@dataclass(frozen=True)
class Estimate:
    """Result of :func:`estimate`: ``t_machine = t + mid_offset + skew·(t − mid_time)``; standard errors beside.

    ``refused`` says why nothing could be estimated (then the numbers are NaN).
    """

    mid_time: float = float("nan")
    mid_offset: float = float("nan")
    skew: float = float("nan")
    covariance: Array = field(default_factory=lambda: np.full((2, 2), np.nan))
    degrees_of_freedom: int = 0
    residual: float = float("nan")
    used: tuple[str, ...] = ()
    refused: str = ""


def pairs_of(machine: Sequence[Channel], other: Sequence[Channel], start_ns: int, other_start_ns: int) -> tuple[Pair, ...]:
    """Every joint or cylinder that is measured on both clocks, and every cylinder with its joint."""
    pairs = []
    for y in other:
        axis, quantity = split_signal(y.signal)
        for x in machine:
            x_axis, x_quantity = split_signal(x.signal)
            if axis != x_axis or "command" in (quantity, x_quantity) or axis in ("ee", "tool"):
                continue
            degree = DEGREE_SAME if quantity == x_quantity else DEGREE_LINKAGE
            x_times, y_times = seconds(x.stamps, start_ns), seconds(y.stamps, other_start_ns)
            pairs.append(Pair(f"{x.signal}~{y.signal}", x_times, x.values, y_times, y.values, degree, 3.5 * x.period_s))
    return tuple(pairs)


def estimate(pairs: Sequence[Pair], skew: float | None = None, start: float | None = None) -> Estimate:
    """Offset and skew from ``pairs``.

    Args:
        skew: fixes the skew (a share, not ppm); None estimates it.
        start: offset to start from, within a few samples; None searches all lags.

    Returns:
        The estimate; ``refused`` where no pair moves, no lag stands out, or too little is left after dropping gaps.
    """
    if not pairs:
        return Estimate(refused="no joint or cylinder is measured on both clocks")
    moving = [pair for pair in pairs if _moves(pair.x) and _moves(pair.y)]
    if not moving:
        names = ", ".join(pair.name for pair in pairs)
        return Estimate(refused=f"nothing moves that both clocks have seen ({names})")
    if start is None:
        start, refused = coarse_offset(moving)
        if refused:
            return Estimate(refused=refused)
    smoothed = [_smoothed(pair) for pair in moving]
    result, explained = _refine(smoothed, start, skew)
    good = [pair for pair, share in zip(smoothed, explained, strict=True) if share >= MIN_EXPLAINED]
    if good and len(good) < len(smoothed):  # a broken sensor must not spoil what the others know
        result, explained = _refine(good, start, skew)
    if not result.refused and (min(explained) < MIN_EXPLAINED or abs(result.skew) > MAX_SKEW):
        listed = ", ".join(f"{pair.name}: {share:.2f}" for pair, share in zip(good or smoothed, explained, strict=True))
        return Estimate(refused=f"the motions do not agree at the best lag (explained shares {listed})")
    return result


def _moves(values: Array) -> bool:
    """Whether a signal moves by much more than its noise (differences of neighbours) and its quantum."""
    known = values[~np.isnan(values)]
    if len(known) < 50:
        return False
    noise = float(np.median(np.abs(np.diff(known, n=2)))) / 1.65
    steps = np.abs(np.diff(np.unique(known)))
    quantum = float(steps.min()) if len(steps) else 0.0
    spread = float(np.quantile(known, 0.99) - np.quantile(known, 0.01))
    return spread > 20.0 * max(noise, quantum)


def coarse_offset(pairs: Sequence[Pair]) -> tuple[float, str]:
    """The lag [s] at which the rates of all pairs correlate best, or why none stands out.

    The sign of a map is unknown (a cylinder may close its joint), so magnitudes of the correlations are summed.
    """
    step = 1.0 / _COARSE_HZ
    start_x = min(float(pair.x_times[0]) for pair in pairs)
    start_y = min(float(pair.y_times[0]) for pair in pairs)
    count_x = int((max(float(pair.x_times[-1]) for pair in pairs) - start_x) / step) + 1
    count_y = int((max(float(pair.y_times[-1]) for pair in pairs) - start_y) / step) + 1
    size = 1 << (count_x + count_y).bit_length()
    total = np.zeros(size)
    for pair in pairs:
        rate_x, known_x = _rates(pair.x_times, pair.x, start_x, count_x)
        rate_y, known_y = _rates(pair.y_times, pair.y, start_y, count_y)
        fx, fy = np.fft.rfft(rate_x, size), np.conj(np.fft.rfft(rate_y, size))
        cross = np.fft.irfft(fx * fy, size)
        # Normalised by the energy that overlaps at that lag, with a floor so that a sliver at the end cannot win.
        energy_x = np.fft.irfft(np.fft.rfft(rate_x**2, size) * np.conj(np.fft.rfft(known_y, size)), size)
        energy_y = np.fft.irfft(np.fft.rfft(known_x, size) * np.conj(np.fft.rfft(rate_y**2, size)), size)
        floor = 0.25 * np.sqrt(np.sum(rate_x**2) * np.sum(rate_y**2)) + 1e-300
        total += np.abs(cross) / np.maximum(np.sqrt(np.clip(energy_x, 0, None) * np.clip(energy_y, 0, None)), floor)
    total /= len(pairs)
    best = int(np.argmax(total))
    lags = np.where(np.arange(size) > size // 2, np.arange(size) - size, np.arange(size)) * step
    rival = float(np.max(total[np.abs(lags - lags[best]) > 2.0], initial=0.0))
    if total[best] < MIN_CORRELATION:
        return 0.0, f"the motions do not resemble each other at any lag (correlation {total[best]:.2f} at best)"
    if rival > MAX_RIVAL * total[best]:
        return (
            0.0,
            f"two lags fit almost equally well (correlations {total[best]:.2f} and {rival:.2f}): the motion repeats itself",
        )
    return float(lags[best] + start_x - start_y), ""


def _rates(times: Array, values: Array, start: float, count: int) -> tuple[Array, Array]:
    """Rate on the coarse grid, zero where nothing was measured, and a mask of where it was."""
    grid = start + np.arange(count) / _COARSE_HZ
    period = float(np.median(np.diff(times)))
    on_grid = interpolate(times, values, grid, max(3.5 * period, 0.2))
    width = max(round(0.08 * _COARSE_HZ), 1)
    rate = np.full(count, np.nan)
    rate[width:-width] = (on_grid[2 * width :] - on_grid[: -2 * width]) * (_COARSE_HZ / (2 * width))
    known = ~np.isnan(rate)
    return np.where(known, rate, 0.0), known.astype(np.float64)


def _smoothed(pair: Pair) -> Pair:
    """Noise of ``x`` above a fifth of its rate off: between samples interpolation would shrink it and so prefer such lags."""
    rate = 1.0 / float(np.median(np.diff(pair.x_times)))
    x = low_pass(pair.x_times, pair.x, 0.2 * rate, pair.x_gap_s)
    known = ~np.isnan(pair.y)
    return Pair(pair.name, pair.x_times, x, pair.y_times[known], pair.y[known], pair.degree, pair.x_gap_s)


def _refine(pairs: Sequence[Pair], start: float, fixed_skew: float | None) -> tuple[Estimate, list[float]]:
    """Gauss-Newton on (offset, skew) with the maps projected out and soft-L1 weights; explained share of each pair beside."""
    overlap = [t for p in pairs for t in (max(p.y_times[0], p.x_times[0] - start), min(p.y_times[-1], p.x_times[-1] - start))]
    mid = (min(overlap) + max(overlap)) / 2.0
    offset, skew = start, fixed_skew or 0.0
    scales = [0.0] * len(pairs)
    for iteration in range(40):
        settled = iteration > 5
        parts = []
        for index, pair in enumerate(pairs):
            part = _linearise(pair, offset, skew, mid, scales[index] if settled else 0.0)
            if part is None:
                return Estimate(refused=f"too little of {pair.name} overlaps"), [0.0] * len(pairs)
            scales[index] = part.scale
            parts.append(part)
        normal = np.sum([part.normal for part in parts], axis=0)
        score = np.sum([part.scores.sum(axis=0) for part in parts], axis=0)
        size = np.sqrt(np.diag(normal))
        if size.min() <= 0.0 or float(np.linalg.det(normal / np.outer(size, size))) < 1e-10:
            return Estimate(refused="too little motion lies where both clocks have seen it"), [0.0] * len(pairs)
        bread = np.linalg.inv(normal) if fixed_skew is None else np.diag([1.0 / normal[0, 0], 0.0])
        # A start from the coarse grid is within its step: larger moves mean that the linearisation does not hold.
        step = np.clip(bread @ score, [-0.05, -5e-4], [0.05, 5e-4])
        offset, skew = offset + float(step[0]), skew + float(step[1])
        if settled and abs(step[0]) < 1e-8 and abs(step[1]) < 1e-10:
            break
    blocks: dict[int, Array] = {}
    for part in parts:
        for block, total in _block_sums(part.times, part.scores):
            blocks[block] = blocks.get(block, np.zeros(2)) + total
    count = len(blocks)
    if count < 4:
        return Estimate(refused=f"only {count} blocks of {BLOCK_S:g} s overlap: too short for an interval"), [0.0] * len(pairs)
    meat = np.sum([np.outer(total, total) for total in blocks.values()], axis=0)
    covariance = bread @ meat @ bread * count / (count - 2)
    used = tuple(sorted({name for pair in pairs for name in pair.name.split("~")}))
    squares = np.concatenate([part.weight * (part.residual / part.scale) ** 2 for part in parts])
    explained = [1.0 - float(np.average(part.residual**2, weights=part.weight)) / part.variance for part in parts]
    return Estimate(float(mid), offset, skew, covariance, count - 2, float(np.sqrt(squares.mean())), used), explained


@dataclass(frozen=True)
class _Part:
    """One pair linearised: residual ``y − f(x)``, weights (n,), noise scale, variance of y, J'WJ, rows of J'Wr (n, 2)."""

    times: Array
    residual: Array
    weight: Array
    scale: float
    variance: float
    normal: Array
    scores: Array


def _linearise(pair: Pair, offset: float, skew: float, mid: float, scale: float) -> _Part | None:
    """``pair`` at (offset, skew) with its map fitted and projected out; None where too little overlaps.

    ``scale`` is the noise's standard deviation; 0 estimates it. It is held while the iteration converges.
    """
    at = pair.y_times + offset + skew * (pair.y_times - mid)
    half = 0.5 * float(np.median(np.diff(pair.x_times)))
    x, later, earlier = (interpolate(pair.x_times, pair.x, at + d, pair.x_gap_s, cubic=True) for d in (0.0, half, -half))
    rate = (later - earlier) / (2.0 * half)
    known = ~np.isnan(x) & ~np.isnan(rate)
    if np.count_nonzero(known) < 20 * (pair.degree + 3):
        return None
    times, y, x, rate = pair.y_times[known], pair.y[known], x[known], rate[known]
    low, high = float(x.min()), float(x.max())
    if high <= low:
        return None
    u = 2.0 * (x - low) / (high - low) - 1.0
    basis = np.polynomial.chebyshev.chebvander(u, pair.degree)
    weight, residual, coefficients = np.ones(len(y)), y, np.zeros(pair.degree + 1)
    for _ in range(4):
        weighted = basis * weight[:, None]
        coefficients = _solve(weighted.T @ basis, weighted.T @ y)
        residual = y - basis @ coefficients
        sigma = scale or 1.4826 * float(np.median(np.abs(residual))) + 1e-15
        # Soft-L1 with its knee at two standard deviations: noise counts in full, mistaken frames hardly.
        weight = 1.0 / np.sqrt(1.0 + (residual / (2.0 * sigma)) ** 2)
    slope = np.polynomial.chebyshev.chebval(u, np.polynomial.chebyshev.chebder(coefficients)) * (2.0 / (high - low))
    jacobian = np.column_stack([slope * rate, slope * rate * (times - mid)])
    weighted = basis * weight[:, None]
    jacobian = jacobian - basis @ _solve(weighted.T @ basis, weighted.T @ jacobian)
    scores = jacobian * (weight / sigma**2 * residual)[:, None]
    normal = (jacobian * (weight / sigma**2)[:, None]).T @ jacobian
    return _Part(times, residual, weight, sigma, max(float(np.var(y)), 1e-30), normal, scores)


def _solve(matrix: Array, right: Array) -> Array:
    """Normal equations of a Chebyshev basis; a ridge far below the noise keeps a sparse range solvable."""
    return np.asarray(np.linalg.solve(matrix + 1e-12 * np.trace(matrix) * np.eye(len(matrix)), right))


def _block_sums(times: Array, contributions: Array) -> list[tuple[int, Array]]:
    blocks = np.floor(times / BLOCK_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(blocks, prepend=blocks[0] - 1))
    sums = np.add.reduceat(contributions, starts, axis=0)
    return [(int(blocks[start]), total) for start, total in zip(starts, sums, strict=True)]
