"""Estimate of a clock: offset, skew, their covariance, and the backlash between the signals used.

Intervals are cluster-robust: scores are summed over blocks of :data:`BLOCK_S`, so autocorrelated residuals widen them.

Source: sandwich with clusters: Liang and Zeger (1986); few clusters: Bell and McCaffrey (2002).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sysid.datasets.clocks.coarse import Pair
from sysid.datasets.clocks.motion_fit import FitSums

Array = npt.NDArray[np.float64]
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
    numbers, scores, weight, squares, counts, information = summed_blocks(sums)
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
    """Numbers of all blocks, and sums over the pairs: scores (b, 2), weight, squares, counts, information (b,)."""
    numbers = np.unique(np.concatenate([s.blocks for s in sums]))
    scores, weight, squares, counts, information = (np.zeros((len(numbers), *shape)) for shape in ((2,), (), (), (), ()))
    for s in sums:
        row = np.searchsorted(numbers, s.blocks)
        scores[row] += s.block_scores
        weight[row] += s.block_weight
        squares[row] += s.block_squares
        counts[row] += s.block_counts
        information[row] += s.block_information
    return numbers, scores, weight, squares, counts, information


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
