"""Offset and skew of another device's clock against the machine's, from motion that both have measured.

Model, for every signal pair p that shares its cause (the same joint, or a cylinder and its joint)::

    t_machine = t + o + s·(t − t_mid)            y_p(t) = f_p(x_p(t_machine)) + noise

with ``x_p`` measured on the machine's clock, ``y_p`` on the other one, and ``f_p`` an unknown smooth map (a polynomial: the
linkage between cylinder and joint, the systematic error of a sensor). ``o``, ``s`` and all maps are estimated together by
robust least squares (soft-L1 by reweighting). Commands are never used: between a command and the motion lies the dead time of
the plant. A start comes from the cross-correlation of the rates. From there the window in which the two are compared grows to
the whole overlap, so that a skew that is not known yet never moves the ends of a long log out of the reach of a Gauss-Newton
step; until the last steps on every sample, a thinned stream is enough.

What is estimated is the offset of the *stamps*: a constant latency of the other device is part of it, not identifiable.
A play between the two signals (in the slewing drive, the pins of a boom) is allowed for: ``f_p`` then has an intercept for each
direction of motion (:mod:`sysid.datasets.clocks.backlash`).

Source: the maps are eliminated from every step, which is variable projection: Golub and Pereyra (1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.clocks.backlash import turning_rows
from sysid.datasets.clocks.coarse import Pair, coarse_lag
from sysid.datasets.clocks.estimate import BLOCK_S, Backlash, Blocks, Estimate, conditional, estimate_of, is_singular
from sysid.datasets.clocks.motion_band import moves, range_of, smoothed
from sysid.datasets.clocks.motion_fit import PairFit, prepared
from sysid.signals import split_signal

__all__ = ["BLOCK_S", "Blocks", "Estimate", "Pair", "conditional", "estimate", "pairs_of"]

Array = npt.NDArray[np.float64]

#: Degree of the polynomial map of a pair: a sensor's error curve, a linkage.
DEGREE_SAME, DEGREE_LINKAGE = 7, 9
#: Share of the variance of y that f(x) has to explain, and the largest skew that a clock has (a share, not ppm).
MIN_EXPLAINED, MAX_SKEW = 0.95, 2e-3
#: Of two lags one is taken where it leaves less than this share of what the other leaves unexplained.
CLEAR = 0.25
#: Or where less than the first share of the motion falls where the other device has seen nothing, and more than the second one
#: at any other lag that explains as much; the way a signal goes is added up in steps of so long [s].
UNMET, MOSTLY_UNMET, PACE_S = 0.1, 0.5, 0.5
#: Differences beyond this quantile are taken for mistaken frames.
TRUSTED = 0.98
#: The first window [s], and by how much each one is longer than the one before.
WINDOW_S, GROWTH = 120.0, 3.0
#: Samples of a pair that are enough to iterate on.
THINNED = 20_000
#: The longest step [s] that the linearisation is trusted for.
REACH_S = 0.05
#: Play is sought up to this share of the range of x, later up to so many times the width that was found, at least so much of
#: the range and so many times the noise; never over the last share.
PLAY_FIRST, PLAY_MARGIN, PLAY_LEAST, PLAY_NOISE, PLAY_MOST = 0.02, 1.5, 0.005, 6.0, 0.2
#: Fewer reversals do not tell a play from the map between the two signals.
PLAY_TURNS = 8


def pairs_of(machine: Sequence[Channel], other: Sequence[Channel], start_ns: int, other_start_ns: int) -> tuple[Pair, ...]:
    """Every joint or cylinder that is measured on both clocks, and every cylinder with its joint."""
    pairs = []
    for y in other:
        axis, quantity = split_signal(y.signal)
        for x in machine:
            x_axis, x_quantity = split_signal(x.signal)
            if axis != x_axis or "command" in (quantity, x_quantity) or axis in ("ee", "tool"):
                continue
            if min(len(x.stamps), len(y.stamps)) < 2:
                continue
            degree = DEGREE_SAME if quantity == x_quantity else DEGREE_LINKAGE
            x_times, y_times = seconds(x.stamps, start_ns), seconds(y.stamps, other_start_ns)
            pairs.append(Pair(f"{x.signal}~{y.signal}", x_times, x.values, y_times, y.values, degree, 3.5 * x.period_s))
    return tuple(pairs)


def estimate(pairs: Sequence[Pair], start: float | None = None) -> Estimate:
    """Offset and skew from ``pairs``.

    Args:
        start: offset to start from, within a few samples; None searches all lags.

    Returns:
        The estimate; ``refused`` where no pair moves, no lag stands out, or too little is left after dropping gaps. Where the
        motions resemble each other but do not agree, ``mid_offset`` still holds the best lag and ``blocks`` where it fits.
    """
    if not pairs:
        return Estimate(refused="no joint or cylinder is measured on both clocks")
    moving = [pair for pair in pairs if moves(pair)]
    if not moving:
        names = ", ".join(pair.name for pair in pairs)
        return Estimate(refused=f"nothing moves that both clocks have seen ({names})")
    centre: float | None = None
    doubt = ""
    rivals: tuple[float, ...] = ()
    if start is None:
        lag = coarse_lag(moving)
        start, centre, doubt, rivals = lag.offset, lag.centre, lag.refused, lag.rivals
    ready = [smoothed(pair) for pair in moving]
    result, explained = _refine(ready, start, centre)
    if rivals:
        # Rates of a motion that nearly repeats itself look alike; what the positions leave unexplained does not.
        tried = [(start, result, explained), *((rival, *_refine(ready, rival, centre)) for rival in rivals)]
        left = [_unexplained(ready, found, shares) for _, found, shares in tried]
        near = [k for k, value in enumerate(left) if value < 1.0 and CLEAR * value <= min(left)]
        if len(near) > 1:  # strokes between long rests: one of few fits another one, with nothing to compare the rest with
            unmet = {k: _unmet(ready, tried[k][1]) for k in near}
            if not any(UNMET <= share <= MOSTLY_UNMET for share in unmet.values()):
                near = [k for k in near if unmet[k] < UNMET]
        if len(near) == 1:
            (start, result, explained), doubt = tried[near[0]], ""
    if doubt:
        return replace(result, refused=doubt)
    good = [pair for pair, share in zip(ready, explained, strict=True) if share >= MIN_EXPLAINED]
    if good and len(good) < len(ready):  # a broken sensor must not spoil what the others know
        result, explained = _refine(good, start, centre)
    if not result.refused and (min(explained) < MIN_EXPLAINED or _beyond(result)):
        listed = ", ".join(f"{pair.name}: {share:.2f}" for pair, share in zip(good or ready, explained, strict=True))
        return replace(result, refused=f"the motions do not agree at the best lag (explained shares {listed})")
    return result if result.refused else allowing_for_backlash(good or ready, result)


def allowing_for_backlash(pairs: Sequence[Pair], plain: Estimate) -> Estimate:
    """The estimate with play between the signals of each pair, where there is any (:mod:`sysid.datasets.clocks.backlash`).

    Where none is found the offset is kept, but its variance is that with play: there may be some that does not show.

    Args:
        pairs: those that ``plain`` rests on, smoothed.
    """
    full = _with_backlash(pairs, plain)
    if full is None:
        return plain
    widths, found = full
    clear = [item.found for item in found.backlash]
    result = found
    if not all(clear):
        result = plain
        if any(clear):
            some = [
                replace(pair, backlash=width if there else 0.0) for pair, width, there in zip(pairs, widths, clear, strict=True)
            ]
            result = _refine(some, plain.mid_offset, plain.mid_time)[0]
        covariance = result.covariance.copy()
        covariance[0, 0] = max(covariance[0, 0], found.covariance[0, 0])
        result = replace(result, covariance=covariance)
    return replace(result, backlash=found.backlash) if not result.refused else plain


def with_backlash_found(pairs: Sequence[Pair], near: Estimate) -> tuple[Pair, ...]:
    """The smoothed ``pairs`` with the play that shows between their signals, near a clock that is known."""
    full = _with_backlash(pairs, near)
    if full is None:
        return tuple(pairs)
    widths, found = full
    return tuple(
        replace(pair, backlash=width if item.found else 0.0)
        for pair, width, item in zip(pairs, widths, found.backlash, strict=True)
    )


def _with_backlash(pairs: Sequence[Pair], plain: Estimate) -> tuple[list[float], Estimate] | None:
    """Widths that are allowed for [unit of each x], and the fit with them; None where too little is left between reversals."""
    ranges = [range_of(pair.x) for pair in pairs]
    scales = [r / max(range_of(pair.y), 1e-300) for pair, r in zip(pairs, ranges, strict=True)]
    least = [max(PLAY_LEAST * r, PLAY_NOISE * pair.noise) for pair, r in zip(pairs, ranges, strict=True)]
    widths = [max(PLAY_FIRST * r, low) for r, low in zip(ranges, least, strict=True)]
    if min(len(turning_rows(p.x[~np.isnan(p.x)], width)[0]) for p, width in zip(pairs, widths, strict=True)) < PLAY_TURNS:
        return None
    found = plain
    for _ in range(3):
        tried = [replace(pair, backlash=width) for pair, width in zip(pairs, widths, strict=True)]
        found, _ = _refine(tried, plain.mid_offset, plain.mid_time)
        if found.refused or len(found.backlash) < len(pairs) or _beyond(found):
            return None
        wanted = [
            min(max(PLAY_MARGIN * abs(b.width) * s, low), PLAY_MOST * r)
            for b, s, low, r in zip(found.backlash, scales, least, ranges, strict=True)
        ]
        if all(
            width >= want and width <= 2.0 * max(want, 0.5 * PLAY_FIRST * r)
            for width, want, r in zip(widths, wanted, ranges, strict=True)
        ):
            break
        widths = [1.2 * want for want in wanted]
    return widths, found


def _beyond(found: Estimate) -> bool:
    """Whether the skew is one that no clock has, also where the little motion there was tells it badly."""
    return abs(found.skew) > MAX_SKEW + 2.0 * float(np.sqrt(found.covariance[1, 1]))


def _unexplained(pairs: Sequence[Pair], found: Estimate, shares: Sequence[float]) -> float:
    """Share of the variance that the worst pair leaves at a lag; all of it where no lag or no clock is like that.

    Where both measured the same quantity, one sees what the other does, and not some function of it: strokes that look alike
    and are not as long, or go the other way, are others.
    """
    if found.refused or abs(found.skew) > MAX_SKEW:
        return 1.0
    return max(1.0 - min(shares), *(_apart(pair, found) for pair in pairs if pair.degree == DEGREE_SAME), 0.0)


def _unmet(pairs: Sequence[Pair], found: Estimate) -> float:
    """Share of the motion where the other device has seen nothing, of whichever has less of it; mean of all pairs."""
    shares = []
    for pair in pairs:
        known, seen = np.isfinite(pair.x), np.isfinite(pair.y)
        times = pair.y_times[seen]
        there = found.on_machine(times)
        ways = (pair.x_times[known], pair.x[known], there), (there, pair.y[seen], pair.x_times[known])
        shares.append(min(_outside(at, values, span[0], span[-1]) for at, values, span in ways))
    return float(np.mean(shares))


def _outside(times: Array, values: Array, first: float, last: float) -> float:
    """Share of the way that ``values`` go before ``first`` or after ``last``."""
    grid = np.arange(times[0], times[-1], PACE_S)
    way = np.abs(np.diff(np.interp(grid, times, values)))
    middle = grid[:-1] + 0.5 * PACE_S
    return float(way[(middle < first) | (middle > last)].sum() / max(float(way.sum()), 1e-300))


def _apart(pair: Pair, found: Estimate) -> float:
    """Variance of the difference of a pair, constant left out, in that of the motion; mistaken frames do not count."""
    known, seen = np.isfinite(pair.x), np.isfinite(pair.y)
    times, y = pair.y_times[seen], pair.y[seen]
    there = found.on_machine(times)
    both = (there >= pair.x_times[known][0]) & (there <= pair.x_times[known][-1])
    if not both.any():
        return 0.0
    left = y[both] - np.interp(there[both], pair.x_times[known], pair.x[known])
    away = np.abs(left - np.median(left))
    usual = np.minimum(away, np.quantile(away, TRUSTED))
    return min(float(np.mean(usual**2)) / max(float(np.var(y[both])), 1e-300), 1.0)


def _refine(pairs: Sequence[Pair], start: float, centre: float | None) -> tuple[Estimate, list[float]]:
    """Gauss-Newton on (offset, skew) in windows that grow around ``centre``; explained share of each pair beside."""
    nothing = [0.0] * len(pairs)
    ends = [
        t
        for p in pairs
        if len(p.y)
        for t in (max(p.y_times[0], p.x_times[0] - start), min(p.y_times[-1], p.x_times[-1] - start))
    ]
    if not ends:
        return Estimate(refused="too little overlaps"), nothing
    first, last = float(min(ends)), float(max(ends))
    mid = (first + last) / 2.0
    centre = mid if centre is None else centre
    fits = [PairFit(prepared(pair)) for pair in pairs]
    offset, skew, width = start, 0.0, WINDOW_S
    reference = centre  # where ``offset`` holds
    while True:
        low, high = centre - width / 2.0, centre + width / 2.0
        whole = low <= first and high >= last
        offset, skew = _converge(fits, offset, skew, reference, (-np.inf, np.inf) if whole else (low, high), thin=True)
        if whole:
            break
        width *= GROWTH
    offset, reference = offset + skew * (mid - reference), mid
    offset, skew = _converge(fits, offset, skew, reference, (-np.inf, np.inf), thin=False)
    sums = [fit.sums(offset, skew, mid, BLOCK_S) for fit in fits]
    there = [s for s in sums if s is not None]
    if not there:
        return Estimate(refused=f"too little of {' and of '.join(pair.name for pair in pairs)} overlaps"), nothing
    used = [pair for pair, s in zip(pairs, sums, strict=True) if s is not None]
    result = estimate_of(there, used, offset, skew, mid, (first, last))
    play = [
        Backlash(pair.name, -2.0 * s.intercept[0], 2.0 * s.intercept[1])
        for pair, s in zip(pairs, sums, strict=True)
        if s is not None and pair.backlash > 0.0
    ]
    result = replace(result, backlash=tuple(play))
    return result, [s.explained if s is not None else 1.0 for s in sums]  # a pair that does not overlap contradicts nobody


def _converge(
    fits: Sequence[PairFit], offset: float, skew: float, reference: float, window: tuple[float, float], thin: bool
) -> tuple[float, float]:
    """(offset, skew) after Gauss-Newton steps on the samples in ``window``; as they were where nothing there can tell."""
    length = max(fit.pair.y_times[-1] - fit.pair.y_times[0] for fit in fits)
    reach = max(min(window[1] - window[0], length), 1.0)
    limit = np.array([REACH_S, 2.0 * REACH_S / reach])
    for fit in fits:
        fit.choose(window, THINNED if thin else None)
    if thin:
        for fit in fits:
            fit.begin(offset, skew, reference)
    for iteration in range(30 if thin else 4):
        sums = [s for s in (fit.sums(offset, skew, reference) for fit in fits) if s is not None]
        if not sums:
            break
        normal, score = np.sum([s.normal for s in sums], axis=0), np.sum([s.score for s in sums], axis=0)
        if is_singular(normal):
            break
        step = np.clip(np.linalg.solve(normal, score), -limit, limit)
        offset, skew = offset + float(step[0]), skew + float(step[1])
        for fit in fits:
            fit.settle(step, hold=not thin or iteration > 5)
        error = np.sqrt(np.diag(np.linalg.inv(normal)))
        if (not thin or iteration > 6) and bool(np.all(np.abs(step) < (0.02 if not thin else 0.05) * error + [1e-9, 1e-12])):
            break
    return offset, skew
