"""Estimate of a clock: offset, skew, their covariance, and the backlash between the signals used; and the skew of a device,
pooled over its recordings, with whether it is accurate enough to be applied.

Intervals are cluster-robust: scores are summed over blocks of :data:`BLOCK_S`, so autocorrelated residuals widen them.

Source: sandwich with clusters: Liang and Zeger (1986); few clusters: Bell and McCaffrey (2002).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import Array
from sysid.datasets.clocks.coarse import Pair
from sysid.datasets.clocks.motion_fit import FitSums
from sysid.datasets.recording import ClockRecord

Time = TypeVar("Time", float, Array)

#: Length over which residuals may be correlated [s].
BLOCK_S = 2.0
#: Numbers of blocks that are summed for the widths of intervals, and the least number of such sums.
BLOCKS_TOGETHER, MIN_BLOCKS = (1, 3), 12
#: Upper limit of the share of one block in the information about the offset.
MAX_SHARE = 0.5
#: Backlash is significant from this many standard errors.
BACKLASH_ERRORS = 2.0


@dataclass(frozen=True)
class Blocks:
    """Residuals of the fit in blocks of :data:`BLOCK_S`: arrays (b,).

    Args:
        times: middle of the block on the stream's clock [s].
        shift: offset estimated from the block alone minus that of the fit [s].
        weight: inverse variance of ``shift`` [1/s²].
        energy: mean square of the residual in variances of the noise.
    """

    times: Array
    shift: Array
    weight: Array
    energy: Array


@dataclass(frozen=True)
class Backlash:
    """Backlash between the signals of a pair.

    Args:
        name: of the pair.
        width: difference of y between the directions; negative where y leads x, so that x is behind the backlash.
        error: standard error of the width [both: unit of y].
    """

    name: str
    width: float
    error: float

    @property
    def found(self) -> bool:
        """Whether it is significant."""
        return abs(self.width) > BACKLASH_ERRORS * self.error


@dataclass(frozen=True)
class Estimate:
    """``t_machine = t + mid_offset + skew·(t − mid_time)``, with the covariance of (offset, skew).

    ``normal`` is the curvature (2, 2) for :func:`conditional`. ``span`` is the part of the stream that was compared [s].
    ``refused``: why there is no estimate (then the numbers are NaN). ``backlash`` is that of each pair for which it was fitted.
    """

    mid_time: float = float("nan")
    mid_offset: float = float("nan")
    skew: float = float("nan")
    covariance: Array = field(default_factory=lambda: np.full((2, 2), np.nan))
    degrees_of_freedom: int = 0
    residual: float = float("nan")
    used: tuple[str, ...] = ()
    refused: str = ""
    normal: Array = field(default_factory=lambda: np.full((2, 2), np.nan))
    span: tuple[float, float] = (float("nan"), float("nan"))
    blocks: Blocks | None = None
    backlash: tuple[Backlash, ...] = ()

    def at(self, time: Time) -> Time:
        """The offset at a time of the stream [s]."""
        return self.mid_offset + self.skew * (time - self.mid_time)

    def on_machine(self, times: Array) -> Array:
        """Times of the stream (n,) on the machine's clock [s]."""
        return times + self.at(times)

    def variance_at(self, time: float) -> float:
        """Of :meth:`at` [s²]."""
        row = np.array([1.0, time - self.mid_time])
        return float(row @ self.covariance @ row)


def conditional(found: Estimate, skew: float) -> Estimate:
    """The estimate given a known ``skew``: the best offset and its conditional variance."""
    normal = found.normal
    offset = found.mid_offset + normal[0, 1] / normal[0, 0] * (found.skew - skew)
    meat = normal @ found.covariance @ normal
    covariance = np.array([[meat[0, 0] / normal[0, 0] ** 2, 0.0], [0.0, 0.0]])
    return replace(found, mid_offset=float(offset), skew=skew, covariance=covariance)


def is_singular(normal: Array) -> bool:
    size = np.sqrt(np.diag(normal))
    return bool(size.min() <= 0.0 or float(np.linalg.det(normal / np.outer(size, size))) < 1e-10)


def estimate_of(
    sums: Sequence[FitSums], pairs: Sequence[Pair], offset: float, skew: float, mid: float, span: tuple[float, float]
) -> Estimate:
    normal = np.sum([s.curvature for s in sums], axis=0)
    if is_singular(normal):
        return Estimate(refused="too little motion is measured on both clocks")
    numbers, scores, weight, squares, information, counts = summed_blocks(sums)
    count = len(numbers)
    if count < 4:
        return Estimate(refused=f"only {count} blocks of {BLOCK_S:g} s overlap: too short for an interval")
    white = np.sum([s.white for s in sums], axis=0)
    covariance, freedom = _covariance(np.linalg.inv(normal), white, numbers, scores, information)
    used = tuple(sorted({name for pair in pairs for name in pair.name.split("~")}))
    residual = float(np.sqrt(sum(s.weighted_squares for s in sums) / sum(s.count for s in sums)))
    used_blocks = weight > 0.0
    times = np.asarray((numbers[used_blocks] + 0.5) * BLOCK_S, dtype=np.float64)
    shift = scores[used_blocks, 0] / weight[used_blocks]
    blocks = Blocks(times, shift, weight[used_blocks], squares[used_blocks] / counts[used_blocks])
    return Estimate(mid, offset, skew, covariance, freedom, residual, used, "", normal, span, blocks)


def summed_blocks(sums: Sequence[FitSums]) -> tuple[npt.NDArray[np.int64], Array, Array, Array, Array, Array]:
    """Numbers of all blocks, and sums over the pairs: scores (b, 2), weight, squares, information, counts (b,)."""
    numbers, rows = np.unique(np.concatenate([s.blocks for s in sums]), return_inverse=True)
    table = np.zeros((len(numbers), 6))
    np.add.at(table, rows, np.concatenate([s.block_sums for s in sums]))
    return numbers, table[:, :2], table[:, 2], table[:, 3], table[:, 4], table[:, 5]


def _covariance(
    bread: Array, white: Array, numbers: npt.NDArray[np.int64], scores: Array, information: Array
) -> tuple[Array, int]:
    """Covariance of (offset, skew), and its degrees of freedom: the largest over several block lengths.

    FitSums of scores over blocks reflect correlated residuals but scatter when there are few, so no variance is smaller than
    that of uncorrelated residuals. A block with a share h of the ``information`` about the offset (b,) pulls the fit towards
    itself, so its score is divided by 1 − h (Bell and McCaffrey, Survey Methodology 28 (2002) 169); the effective number of
    blocks is (Σh)²/Σh².
    """
    found = [(bread @ white @ bread, len(numbers) - 2)]
    for together in BLOCKS_TOGETHER:
        starts = np.flatnonzero(np.diff(numbers // together, prepend=numbers[0] // together - 1))
        count = len(starts)
        if together > 1 and count < MIN_BLOCKS:
            continue
        shares = np.add.reduceat(information, starts) / max(float(information.sum()), 1e-300)
        sums = np.add.reduceat(scores, starts, axis=0) / (1.0 - np.minimum(shares, MAX_SHARE))[:, None]
        freedom = max(min(count, round(1.0 / float(np.sum(shares**2)))) - 2, 1)
        found.append((bread @ (sums.T @ sums) @ bread * count / (count - 2), freedom))
    errors = np.sqrt(np.max([np.diag(covariance) for covariance, _ in found], axis=0))
    first = found[1][0]
    correlation = first[0, 1] / np.sqrt(first[0, 0] * first[1, 1])
    inner = errors[0] * errors[1] * correlation
    return np.array([[errors[0] ** 2, inner], [inner, errors[1] ** 2]]), found[1][1]


#: The skew is applied if the half-width of its 95 % interval is at most this [ppm] and the motion at least this long [s]: in
#: less time, a drift of a latency or of a sensor cannot be distinguished from a skew.
MAX_SKEW_HALF_WIDTH, MIN_SKEW_SPAN_S = 30.0, 45.0
#: Bound of a skew that is not estimated: two crystals of 100 ppm each, as a share.
TWO_CRYSTALS = 200e-6
#: Degrees of freedom of the skew from earlier recordings.
_MANY = 1000


@dataclass(frozen=True)
class KnownSkew:
    """Skew of a device from recordings that were aligned before.

    Args:
        skew_ppm: as in their clock records, with its 95 % interval.
        recordings: their number.
    """

    skew_ppm: float
    interval95: tuple[float, float]
    recordings: int

    @property
    def variance(self) -> float:
        """Of the skew as a share, not ppm."""
        return (1e-6 * _half(self.interval95) / quantile(_MANY)) ** 2


@dataclass(frozen=True)
class Skew:
    """Skew shared by the recordings of a device, or why it is not applied (``value`` is a share, not ppm)."""

    value: float
    interval: tuple[float, float]
    applied: bool
    reason: str

    @property
    def half_width(self) -> float:
        """95 % bound of the difference between the true and the applied skew."""
        if self.applied:
            return _half(self.interval)
        return min(max(abs(self.interval[0]), abs(self.interval[1])), TWO_CRYSTALS)


def known_skews(records: Sequence[ClockRecord], domains: Mapping[tuple[str, str], str]) -> dict[str, KnownSkew]:
    """Skew of each device from earlier records, where one was applied and its recordings agree.

    Args:
        domains: (recording, source) → clock domain.
    """
    found: dict[str, list[ClockRecord]] = {}
    for record in records:
        domain = domains.get((record.recording, record.stream))
        if domain is not None and record.applied and record.skew_ppm != 0.0 and all(map(math.isfinite, record.skew_interval95)):
            found.setdefault(domain, []).append(record)
    known = {}
    for domain, own in found.items():
        # The skew of later recordings includes that of earlier ones: the narrowest interval is that of all.
        best = min(own, key=lambda record: _half(record.skew_interval95))
        if all(abs(r.skew_ppm - best.skew_ppm) <= _half(r.skew_interval95) + _half(best.skew_interval95) for r in own):
            shown = {record.recording for record in own if math.isfinite(record.residual_rms)}  # static poses show none
            known[domain] = KnownSkew(best.skew_ppm, best.skew_interval95, len(shown))
    return known


def pooled(estimates: Sequence[tuple[str, Estimate]], known: KnownSkew | None = None) -> Skew | None:
    """The common skew of one device; None where the recordings contradict each other or ``known``.

    Args:
        estimates: (recording, estimate) of every piece of every recording.
    """
    own = [(name, e) for name, e in estimates if not e.refused]
    if not own and known is None:
        return Skew(0.0, (-math.inf, math.inf), False, "no recording shows the skew")
    before = [(1e-6 * known.skew_ppm, known.variance, _MANY)] if known is not None else []
    shown = [(e.skew, float(e.covariance[1, 1]), e.degrees_of_freedom) for _, e in own] + before
    skews = np.array([skew for skew, _, _ in shown])
    weights = np.array([1.0 / variance for _, variance, _ in shown])
    mean = float(np.sum(weights * skews) / np.sum(weights))
    error = float(1.0 / math.sqrt(np.sum(weights)))
    freedom = sum(freedom for _, _, freedom in shown)
    if len(shown) > 1:
        from scipy.stats import chi2

        spread = float(np.sum(weights * (skews - mean) ** 2))
        if spread > chi2.ppf(0.999, len(shown) - 1):
            return None
        # Where the recordings scatter more than their errors, the error of the mean is scaled by the ratio.
        error *= max(1.0, math.sqrt(spread / (len(shown) - 1)))
    count = len({name for name, _ in own}) + (known.recordings if known is not None else 0)
    span = math.inf if known is not None else sum(e.span[1] - e.span[0] for _, e in own)
    return _skew_of(mean, quantile(freedom) * error, span, f"common to {count} recordings" if count > 1 else "")


def alone(estimate: Estimate) -> Skew:
    """The skew of one piece of one recording, where those of the device contradict each other."""
    half = quantile(estimate.degrees_of_freedom) * math.sqrt(estimate.covariance[1, 1])
    return _skew_of(estimate.skew, half, estimate.span[1] - estimate.span[0], "differs between recordings: each has its own")


def _skew_of(skew: float, half: float, span_s: float, reason: str) -> Skew:
    """A skew with an interval of ± ``half`` from ``span_s`` of motion, not applied where either is insufficient."""
    interval = (skew - half, skew + half)
    if half * 1e6 > MAX_SKEW_HALF_WIDTH:
        wide = f"skew not applied: known to ±{half * 1e6:.0f} ppm only (limit {MAX_SKEW_HALF_WIDTH:g}): record longer"
        return Skew(0.0, interval, False, wide)
    if span_s < MIN_SKEW_SPAN_S:
        short = f"skew not applied: {span_s:.0f} s are too short for one (at least {MIN_SKEW_SPAN_S:g} s): record longer"
        return Skew(0.0, interval, False, short)
    return Skew(skew, interval, True, reason)


def quantile(degrees_of_freedom: int) -> float:
    """Of Student's t, for 95 % between both ends."""
    from scipy.stats import t

    return float(t.ppf(0.975, max(degrees_of_freedom, 1)))


def _half(interval: tuple[float, float]) -> float:
    return (interval[1] - interval[0]) / 2.0
