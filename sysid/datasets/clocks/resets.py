"""Clocks that were set while they recorded: one estimate for each piece of a stream, found from the motion.

Where the offset steps, the blocks after the step have another offset than those before, or do not fit at all. A suspected step
is accepted if both sides can be aligned separately and their offsets differ by much more than their errors and by more than
half a frame, and neither side fits the clock of the other about as well. It is placed on the sample that gives the best fit of
both sides, or on an uneven stamp beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sysid.datasets.chunked import median_step
from sysid.datasets.clocks.alignment import BLOCK_S, Blocks, Estimate, Pair, continues, estimate
from sysid.datasets.clocks.measured_motion import moves, smoothed
from sysid.datasets.clocks.motion_fit import PairFit, prepared

#: Least number of blocks on either side of a step.
MIN_BLOCKS = 4
#: A step is suspected from these gains in χ² of the offset and of the residual energy, and this contrast of the energy (ln).
SHIFT_GAIN, ENERGY_GAIN, ENERGY_CONTRAST = 45.0, 60.0, 0.7
#: A step is accepted from this many standard errors, and this share of a sample period of the stream.
STEP_ERRORS, STEP_PERIODS = 6.0, 0.5
#: A stream has at most 2 to this power pieces.
DEPTH = 4


@dataclass(frozen=True)
class Piece:
    """Part of a stream, from ``first_s`` up to ``last_s`` on its own clock, with the estimate of the clock there."""

    first_s: float
    last_s: float
    estimate: Estimate


def pieces(pairs: Sequence[Pair]) -> tuple[Piece, ...]:
    """The stream in pieces of one offset and skew each; one piece where there is no step, or nothing can be estimated."""
    if not pairs:
        return (Piece(-np.inf, np.inf, estimate(pairs)),)
    found = _split(pairs, -np.inf, np.inf, DEPTH)
    if len(found) == 1:
        return found
    cuts = [_located(pairs, before, after) for before, after in pairwise(found)]
    edges = [-np.inf, *cuts, np.inf]
    fresh = [Piece(a, b, estimate(_cut(pairs, a, b))) for a, b in pairwise(edges)]
    if any(piece.estimate.refused for piece in fresh):
        return found
    return _joined(pairs, fresh)


def _split(pairs: Sequence[Pair], first: float, last: float, depth: int) -> tuple[Piece, ...]:
    own = _cut(pairs, first, last)
    whole = Piece(first, last, estimate(own))
    if depth == 0:
        return (whole,)
    tried: list[float] = []
    for at in _suspicions(own, whole.estimate):
        if any(abs(at - other) < BLOCK_S for other in tried):
            continue
        tried.append(at)
        before, after = _split(pairs, first, at, depth - 1), _split(pairs, at, last, depth - 1)
        if any(piece.estimate.refused for piece in (*before, *after)):
            continue
        if len(before) == len(after) == 1 and not _stepped(pairs, before[-1], after[0]):
            return (whole,)
        return (*before, *after)
    if tried and whole.estimate.refused:
        reason = f"{whole.estimate.refused}; its clock may have been set, but not every part of it can be aligned"
        return (replace(whole, estimate=replace(whole.estimate, refused=reason)),)
    return (whole,)


def _suspicions(pairs: Sequence[Pair], whole: Estimate) -> Iterator[float]:
    """Times at which the clock may have been set, the likeliest first: from the fit of all, and if refused from parts."""
    at = suspected(whole.blocks, _period(pairs)) if pairs else None
    if at is not None:
        yield at
    if not whole.refused or whole.blocks is None:
        return
    first, last = min(float(p.y_times[0]) for p in pairs), max(float(p.y_times[-1]) for p in pairs)
    length = last - first
    if length < 4.0 * MIN_BLOCKS * BLOCK_S:
        return
    for a, b in ((first, first + 0.4 * length), (last - 0.4 * length, last)):
        part = estimate(_cut(pairs, a, b))
        at = suspected(_reach(pairs, part, a, b), _period(pairs)) if not part.refused else None
        if at is not None:
            yield at


def _reach(pairs: Sequence[Pair], part: Estimate, first: float, last: float) -> Blocks:
    """Residual energy of the whole stream under the clock and the maps of a part, in blocks."""
    parts = []
    for pair in filter(moves, pairs):
        ready = prepared(smoothed(pair))
        fit = PairFit(ready)
        fit.choose((first, last), 20_000)
        fit.begin(part.mid_offset, part.skew, part.mid_time)
        squares = fit.squares((-np.inf, np.inf), part.mid_offset, part.skew, part.mid_time)
        known = np.isfinite(squares)
        parts.append((np.floor(ready.y_times[known] / BLOCK_S).astype(np.int64), np.clip(squares[known], 0.0, 400.0)))
    numbers, place = np.unique(np.concatenate([rows for rows, _ in parts]), return_inverse=True)
    energy = np.bincount(place, np.concatenate([values for _, values in parts])) / np.bincount(place)
    times = (numbers + 0.5) * BLOCK_S
    return Blocks(times, np.zeros_like(times), np.zeros_like(times), energy)


def _joined(pairs: Sequence[Pair], parts: Sequence[Piece]) -> tuple[Piece, ...]:
    """Pieces without a step between them, joined."""
    done = [parts[0]]
    for piece in parts[1:]:
        if _stepped(pairs, done[-1], piece):
            done.append(piece)
            continue
        both = Piece(done[-1].first_s, piece.last_s, estimate(_cut(pairs, done[-1].first_s, piece.last_s)))
        if both.estimate.refused:
            done.append(piece)
        else:
            done[-1] = both
    return tuple(done)


def _cut(pairs: Sequence[Pair], first: float, last: float) -> list[Pair]:
    """The pairs with the stream's samples in [first, last); a pair without any is omitted."""
    found = []
    for pair in pairs:
        a, b = np.searchsorted(pair.y_times, (first, last))
        if b - a > 1:
            found.append(replace(pair, y_times=pair.y_times[a:b], y=pair.y[a:b]))
    return found


def _period(pairs: Sequence[Pair]) -> float:
    return min(median_step(pair.y_times) for pair in pairs)


def suspected(blocks: Blocks | None, period: float) -> float | None:
    """Time of the stream at which a step of the offset is suspected; None where there is none."""
    if blocks is None or len(blocks.times) < 2 * MIN_BLOCKS:
        return None
    candidates = []
    row, gain, size = _shift_step(blocks)
    if gain > SHIFT_GAIN and abs(size) > STEP_PERIODS * period:
        candidates.append((gain, row))
    row, gain, size = _energy_step(blocks)
    if gain > ENERGY_GAIN and abs(size) > ENERGY_CONTRAST:
        candidates.append((gain, row))
    return float(blocks.times[max(candidates)[1]] - BLOCK_S / 2.0) if candidates else None


def _shift_step(blocks: Blocks) -> tuple[int, float, float]:
    """First block after the likeliest step, its gain in χ² over a straight line, and its size [s]."""
    t, w = blocks.times - blocks.times.mean(), blocks.weight
    line = np.column_stack([np.ones_like(t), t])
    gram = line.T @ (w[:, None] * line)
    if not w.max() > 0.0 or np.linalg.det(gram) <= 0.0:
        return 0, 0.0, 0.0
    residual = blocks.shift - line @ np.linalg.solve(gram, line.T @ (w * blocks.shift))
    after = np.cumsum((w[:, None] * line)[::-1], axis=0)[::-1]
    score = np.cumsum((w * residual)[::-1])[::-1]
    information = after[:, 0] - np.einsum("ki,ij,kj->k", after, np.linalg.inv(gram), after)
    gain = np.where(information > 1e-9 * after[0, 0], score**2 / np.maximum(information, 1e-300), 0.0)
    gain[:MIN_BLOCKS] = gain[len(gain) - MIN_BLOCKS + 1 :] = 0.0
    row = int(np.argmax(gain))
    # Dispersion about the line with the step, so that a large step does not increase it.
    stepped = np.column_stack([line, np.arange(len(t)) >= row])
    solution = np.linalg.lstsq(np.sqrt(w)[:, None] * stepped, np.sqrt(w) * blocks.shift, rcond=None)[0]
    rest = np.sqrt(w) * (blocks.shift - stepped @ solution)
    dispersion = max(1.0, (1.4826 * float(np.median(np.abs(rest)))) ** 2)
    return row, float(gain[row]) / dispersion, float(solution[2])


def _energy_step(blocks: Blocks) -> tuple[int, float, float]:
    """First block after the likeliest step of the residual's logarithm, its gain in χ², and its size."""
    level = np.log(np.clip(blocks.energy, 1e-2, 1e6))
    count = len(level)
    rows = np.arange(1, count)
    sums = np.cumsum(level)[:-1]
    before, after = sums / rows, (level.sum() - sums) / (count - rows)
    gain = rows * (count - rows) / count * (after - before) ** 2
    gain[: MIN_BLOCKS - 1] = gain[count - MIN_BLOCKS :] = 0.0
    best = int(np.argmax(gain))
    row = int(rows[best])
    inner = np.concatenate([level[:row] - np.median(level[:row]), level[row:] - np.median(level[row:])])
    variance = max((1.4826 * float(np.median(np.abs(inner)))) ** 2, 0.05**2)
    return row, float(gain[best] / variance), float(after[best] - before[best])


def _stepped(pairs: Sequence[Pair], before: Piece, after: Piece) -> bool:
    """Whether the offset differs between two pieces where they meet, and neither fits the clock of the other as well."""
    at = after.first_s
    size = abs(after.estimate.at(at) - before.estimate.at(at))
    error = np.sqrt(before.estimate.variance_at(at) + after.estimate.variance_at(at))
    if size <= max(STEP_PERIODS * _period(pairs), STEP_ERRORS * error):
        return False
    return not any(
        continues(_cut(pairs, own.first_s, own.last_s), own.estimate, other.estimate)
        for own, other in ((before, after), (after, before))
    )


def _located(pairs: Sequence[Pair], before: Piece, after: Piece) -> float:
    """Time of the first sample that fits the later piece better than the earlier one."""
    guess, reach = after.first_s, 3.0 * BLOCK_S
    low, high = max(guess - reach, before.first_s), min(guess + reach, after.last_s)
    times, costs, uneven = [], [], []
    for pair in filter(moves, _cut(pairs, before.first_s, after.last_s)):
        ready = prepared(smoothed(pair))
        costs_of = []
        for piece in (before, after):
            fit = PairFit(ready)
            fit.choose((max(piece.first_s, low - 120.0), min(piece.last_s, high + 120.0)), 20_000)
            found = piece.estimate
            fit.begin(found.mid_offset, found.skew, found.mid_time)
            costs_of.append(fit.squares((low, high), found.mid_offset, found.skew, found.mid_time))
        own = ready.y_times[slice(*np.searchsorted(ready.y_times, (low, high)))]
        # Where the machine has no samples, the cost is between that of noise and that of another motion.
        bounded = [np.clip(np.nan_to_num(cost, nan=4.0), 0.0, 25.0) for cost in costs_of]
        times.append(own)
        costs.append(bounded[0] - bounded[1])
        steps = np.diff(pair.y_times)
        uneven.append(pair.y_times[1:][np.abs(steps / np.median(steps) - 1.0) > 0.5])
    joined = np.concatenate(times)
    if not len(joined):
        return guess
    order = np.argsort(joined, kind="stable")
    joined = joined[order]
    total = np.concatenate([[0.0], np.cumsum(np.concatenate(costs)[order])])[:-1]
    best = float(total.min())
    near = np.unique(np.concatenate(uneven))
    near = near[(near >= joined[0]) & (near <= joined[-1])]
    if len(near):
        there = total[np.searchsorted(joined, near)]
        if there.min() < best + 2.0 * SHIFT_GAIN:
            return float(near[int(np.argmin(there))])
    return float(joined[int(np.argmin(total))])
