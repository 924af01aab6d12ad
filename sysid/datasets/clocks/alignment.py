"""Offset and skew of another device's clock against the machine's, from motion that both measure.

Model, for every pair p of related signals (the same joint, or a cylinder and its joint)::

    t_machine = t + o + s·(t − t_mid)            y_p(t) = f_p(x_p(t_machine)) + noise

with ``x_p`` measured on the machine's clock, ``y_p`` on the other one, and ``f_p`` an unknown smooth map (a polynomial: the
linkage between cylinder and joint, the systematic error of a sensor). ``o``, ``s`` and all maps are estimated together by
robust least squares (soft-L1 by reweighting). Commands are never used, because the dead time of the plant lies between command
and motion. The initial offset comes from the cross-correlation of the rates. The window of comparison then grows to the whole
overlap, so that an unknown skew never moves the ends of a long log out of the reach of a Gauss-Newton step. Only the last steps
use every sample.

The estimate is the offset of the *stamps*: a constant latency of the other device is part of it and not identifiable. With
backlash between the two signals (slewing drive, pins of a boom) ``f_p`` has an intercept for each direction of motion
(:mod:`sysid.datasets.clocks.measured_motion`).

Source: the maps are eliminated from every step by variable projection: Golub and Pereyra (1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.chunked import Array
from sysid.datasets.clocks.coarse import Pair, coarse_lag
from sysid.datasets.clocks.estimate import BLOCK_S, Backlash, Blocks, Estimate, conditional, estimate_of, is_singular
from sysid.datasets.clocks.measured_motion import moves, range_of, smoothed, turning_rows
from sysid.datasets.clocks.motion_fit import PairFit, prepared
from sysid.signals import split_signal

__all__ = ["BLOCK_S", "Blocks", "Estimate", "Pair", "conditional", "estimate", "pairs_of"]


#: Degree of the polynomial map of a pair: a sensor's error curve, a linkage.
DEGREE_SAME, DEGREE_LINKAGE = 7, 9
#: Share of the variance of y that f(x) has to explain, and the largest skew of a clock (a share, not ppm).
MIN_EXPLAINED, MAX_SKEW = 0.95, 2e-3
#: One of several lags is chosen if its unexplained variance is less than this share of every other lag's.
CLEAR_SHARE = 0.25
#: Or if less than the first share of the motion has no counterpart on the other clock, and more than the second at every other
#: lag that explains as much; path lengths are summed in steps of this length [s].
UNMATCHED, MOSTLY_UNMATCHED, PATH_STEP_S = 0.1, 0.5, 0.5
#: Differences beyond this quantile count as mistaken frames.
INLIER_QUANTILE = 0.98
#: The first window [s], and the growth factor of the next ones.
WINDOW_S, GROWTH = 120.0, 3.0
#: Samples of a pair used in the first iterations.
THINNED = 20_000
#: The longest step [s] for which the linearisation holds.
REACH_S = 0.05
#: Width that is allowed for backlash: first share of the range of x, then a multiple of the estimated width; at least a share
#: of the range and a multiple of the noise; at most the last share.
BACKLASH_FIRST, BACKLASH_MARGIN, BACKLASH_LEAST, BACKLASH_NOISE, BACKLASH_MAX = 0.02, 1.5, 0.005, 6.0, 0.2
#: Two clocks agree within this many standard errors.
AGREEMENT = 3.0
#: With fewer reversals backlash cannot be distinguished from the map between the two signals.
MIN_REVERSALS = 4


def pairs_of(machine: Sequence[Channel], other: Sequence[Channel], start_ns: int, other_start_ns: int) -> tuple[Pair, ...]:
    """Every joint, cylinder or speed measured on both clocks, and every cylinder with its joint.

    A speed is not a function of a position, so the two are not paired.
    """
    pairs = []
    for y in other:
        axis, quantity = split_signal(y.signal)
        for x in machine:
            x_axis, x_quantity = split_signal(x.signal)
            if axis != x_axis or "command" in (quantity, x_quantity) or axis in ("ee", "tool"):
                continue
            if "speed" in (quantity, x_quantity) and quantity != x_quantity:
                continue
            if min(len(x.stamps), len(y.stamps)) < 2:
                continue
            degree = DEGREE_SAME if quantity == x_quantity else DEGREE_LINKAGE
            x_times, y_times = seconds(x.stamps, start_ns), seconds(y.stamps, other_start_ns)
            pairs.append(Pair(f"{x.signal}~{y.signal}", x_times, x.values, y_times, y.values, degree, 3.5 * x.period_s))
    return tuple(pairs)


def estimate(pairs: Sequence[Pair]) -> Estimate:
    """Offset and skew from ``pairs``.

    Returns:
        The estimate; ``refused`` where no pair moves, no lag is clearly the best, or too little overlaps. Where the motions
        correlate but do not agree, ``mid_offset`` still is the best lag and ``blocks`` show where it fits.
    """
    if not pairs:
        return Estimate(refused="no joint or cylinder is measured on both clocks")
    moving = [pair for pair in pairs if moves(pair)]
    if not moving:
        names = ", ".join(pair.name for pair in pairs)
        return Estimate(refused=f"nothing moves that both clocks have seen ({names})")
    lag = coarse_lag(moving)
    start, refused = lag.offset, lag.refused
    ready = [smoothed(pair) for pair in moving]
    result, explained = _refine(ready, start, lag.centre)
    if lag.alternatives:
        # The rates of a nearly periodic motion correlate at several lags; the residuals of the positions differ.
        tried = [(start, result, explained), *((other, *_refine(ready, other, lag.centre)) for other in lag.alternatives)]
        unexplained = [_unexplained(ready, found, shares) for _, found, shares in tried]
        near = [k for k, value in enumerate(unexplained) if value < 1.0 and CLEAR_SHARE * value <= min(unexplained)]
        if len(near) > 1:  # strokes between long rests: at a wrong lag one of few fits another and nothing contradicts
            unmatched = {k: _unmatched(ready, tried[k][1]) for k in near}
            if not any(UNMATCHED <= share <= MOSTLY_UNMATCHED for share in unmatched.values()):
                near = [k for k in near if unmatched[k] < UNMATCHED]
        if len(near) == 1:
            (start, result, explained), refused = tried[near[0]], ""
    if refused:
        return replace(result, refused=refused)
    good = [pair for pair, share in zip(ready, explained, strict=True) if share >= MIN_EXPLAINED]
    if good and len(good) < len(ready):  # without the pair of a broken sensor
        result, explained = _refine(good, start, lag.centre)
    if not result.refused and (min(explained) < MIN_EXPLAINED or _implausible_skew(result)):
        listed = ", ".join(f"{pair.name}: {share:.2f}" for pair, share in zip(good or ready, explained, strict=True))
        return replace(result, refused=f"the motions do not agree at the best lag (explained shares {listed})")
    return result if result.refused else allowing_for_backlash(good or ready, result)


def continues(pairs: Sequence[Pair], own: Estimate, near: Estimate) -> bool:
    """Whether the motion of ``pairs`` fits near the clock ``near`` too, about as well as with its ``own`` estimate.

    One stroke resembles other strokes and, up to a map, itself at many lags; backlash then decides which lag fits best. The
    clock of the motion before it is therefore one of the lags that are compared.
    """
    ready = [smoothed(pair) for pair in pairs if moves(pair)]
    if not ready or own.refused or near.refused:
        return False
    middle = own.mid_time
    found, shares = _refine(ready, near.at(middle), middle)
    here = found.at(middle)
    if found.refused or abs(here - near.at(middle)) > abs(here - own.at(middle)):
        return False
    _, own_shares = _refine(ready, own.mid_offset, middle)
    return CLEAR_SHARE * _unexplained(ready, found, shares) <= _unexplained(ready, own, own_shares)


def allowing_for_backlash(pairs: Sequence[Pair], plain: Estimate) -> Estimate:
    """The estimate with backlash between the signals of each pair, where there is any.

    Where none is found, the offset of ``plain`` is kept with the variance of the fit with backlash.

    Args:
        pairs: those of ``plain``, smoothed.
    """
    full = _with_backlash(pairs, plain)
    if full is None:
        return plain
    allowed, found = full
    result = found
    if not all(item.found for item in found.backlash) or len(found.backlash) < len(allowed):
        kept = _significant(allowed, found)
        unchanged = len(kept) == len(pairs) and not any(pair.backlash > 0.0 for pair in kept)
        result = plain if unchanged else _refine(kept, plain.mid_offset, plain.mid_time)[0]
        covariance = result.covariance.copy()
        covariance[0, 0] = max(covariance[0, 0], found.covariance[0, 0])
        result = replace(result, covariance=covariance)
    return replace(result, backlash=found.backlash) if not result.refused else plain


def with_backlash_found(pairs: Sequence[Pair], near: Estimate) -> tuple[Pair, ...]:
    """The smoothed ``pairs`` with the significant backlash between their signals, near a known clock."""
    full = _with_backlash(pairs, near)
    return tuple(pairs) if full is None else _significant(*full)


def _significant(allowed: Sequence[Pair], found: Estimate) -> tuple[Pair, ...]:
    """``allowed`` without the widths of those whose backlash is not significant in ``found``."""
    there = {item.name for item in found.backlash if item.found}
    return tuple(pair if pair.name in there else replace(pair, backlash=0.0) for pair in allowed)


def _with_backlash(pairs: Sequence[Pair], plain: Estimate) -> tuple[tuple[Pair, ...], Estimate] | None:
    """The pairs with the width that is allowed for each, and the fit with them; None where no backlash can be determined.

    A pair that turns too seldom, or has too few samples between its reversals, may have backlash as large as its motion. It is
    compared without backlash if it fits the clock of the others, and left out if it does not.
    """
    found = plain
    allowed = [replace(pair, backlash=width) for pair in pairs if (width := _first_width(pair)) > 0.0]
    for _ in range(4):
        if not allowed:
            return None
        found, _ = _refine(allowed, plain.mid_offset, plain.mid_time)
        if found.refused or _implausible_skew(found):
            return None
        known = {item.name: item.width for item in found.backlash}
        kept = [pair for pair in allowed if pair.name in known]
        needed = [_needed_width(pair, known[pair.name]) for pair in kept]
        limits = [2.0 * max(w, 0.5 * BACKLASH_FIRST * range_of(pair.x)) for w, pair in zip(needed, kept, strict=True)]
        enough = all(w <= pair.backlash <= limit for pair, w, limit in zip(kept, needed, limits, strict=True))
        if enough and len(kept) == len(allowed):
            break
        allowed = [replace(pair, backlash=1.2 * w) for pair, w in zip(kept, needed, strict=True)]
    names = {pair.name for pair in allowed}
    for pair in (pair for pair in pairs if pair.name not in names):
        both, _ = _refine([*allowed, pair], found.mid_offset, found.mid_time)
        if _agree(both, found) and _fits_in_motion(pair, both):
            allowed, found = [*allowed, pair], both
    return tuple(allowed), found


def _agree(one: Estimate, other: Estimate) -> bool:
    """Whether a clock is within the uncertainty of another one, in offset and skew."""
    if one.refused:
        return False
    away = np.array([one.at(other.mid_time) - other.mid_offset, one.skew - other.skew])
    return bool(np.all(np.abs(away) <= AGREEMENT * np.sqrt(np.diag(other.covariance))))


def _first_width(pair: Pair) -> float:
    """Width that is allowed for the backlash of a pair at first [unit of x]; zero where it turns too seldom."""
    width = max(BACKLASH_FIRST * range_of(pair.x), _least_width(pair))
    return width if len(turning_rows(pair.x[~np.isnan(pair.x)], width)[0]) >= MIN_REVERSALS else 0.0


def _least_width(pair: Pair) -> float:
    return max(BACKLASH_LEAST * range_of(pair.x), BACKLASH_NOISE * pair.noise)


def _needed_width(pair: Pair, found: float) -> float:
    """Width that has to be allowed for a backlash ``found`` [unit of y]; in the unit of x."""
    scale = range_of(pair.x) / max(range_of(pair.y), 1e-300)
    return min(max(BACKLASH_MARGIN * abs(found) * scale, _least_width(pair)), BACKLASH_MAX * range_of(pair.x))


def _fits_in_motion(pair: Pair, near: Estimate) -> bool:
    """Whether the residuals of a pair without backlash are noise where it moves."""
    fit = PairFit(prepared(replace(pair, backlash=0.0)))
    fit.begin(near.mid_offset, near.skew, near.mid_time)
    return bool(len(fit.coefficients)) and fit.fits_in_motion


def _implausible_skew(found: Estimate) -> bool:
    """Whether the skew exceeds that of any clock by more than two standard errors."""
    return abs(found.skew) > MAX_SKEW + 2.0 * float(np.sqrt(found.covariance[1, 1]))


def _unexplained(pairs: Sequence[Pair], found: Estimate, shares: Sequence[float]) -> float:
    """Share of the variance that the worst pair leaves unexplained at a lag; 1 where the lag or the skew is impossible.

    Where both clocks measure the same quantity, the values themselves are compared, not only up to a map: strokes of another
    length or direction do not match.
    """
    if found.refused or abs(found.skew) > MAX_SKEW:
        return 1.0
    return max(1.0 - min(shares), *(_difference(pair, found) for pair in pairs if pair.degree == DEGREE_SAME), 0.0)


def _unmatched(pairs: Sequence[Pair], found: Estimate) -> float:
    """Share of the motion without a counterpart on the other clock, the smaller of both sides; mean of all pairs."""
    shares = []
    for pair in pairs:
        known, seen = np.isfinite(pair.x), np.isfinite(pair.y)
        times = pair.y_times[seen]
        there = found.on_machine(times)
        ways = (pair.x_times[known], pair.x[known], there), (there, pair.y[seen], pair.x_times[known])
        shares.append(min(_outside(at, values, span[0], span[-1]) for at, values, span in ways))
    return float(np.mean(shares))


def _outside(times: Array, values: Array, first: float, last: float) -> float:
    """Share of the path of ``values`` before ``first`` or after ``last``."""
    grid = np.arange(times[0], times[-1], PATH_STEP_S)
    path = np.abs(np.diff(np.interp(grid, times, values)))
    middle = grid[:-1] + 0.5 * PATH_STEP_S
    return float(path[(middle < first) | (middle > last)].sum() / max(float(path.sum()), 1e-300))


def _difference(pair: Pair, found: Estimate) -> float:
    """Variance of the difference of a pair without a constant, relative to the motion; mistaken frames are clipped."""
    known, seen = np.isfinite(pair.x), np.isfinite(pair.y)
    times, y = pair.y_times[seen], pair.y[seen]
    there = found.on_machine(times)
    both = (there >= pair.x_times[known][0]) & (there <= pair.x_times[known][-1])
    if not both.any():
        return 0.0
    left = y[both] - np.interp(there[both], pair.x_times[known], pair.x[known])
    away = np.abs(left - np.median(left))
    usual = np.minimum(away, np.quantile(away, INLIER_QUANTILE))
    return min(float(np.mean(usual**2)) / max(float(np.var(y[both])), 1e-300), 1.0)


def _refine(pairs: Sequence[Pair], start: float, centre: float) -> tuple[Estimate, list[float]]:
    """Gauss-Newton on (offset, skew) in windows that grow around ``centre``, and the explained share of each pair."""
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
    backlash = [
        Backlash(pair.name, -2.0 * s.intercept[0], 2.0 * s.intercept[1])
        for pair, s in zip(pairs, sums, strict=True)
        if s is not None and pair.backlash > 0.0
    ]
    result = replace(result, backlash=tuple(backlash))
    return result, [s.explained if s is not None else 1.0 for s in sums]  # a pair without overlap does not count


def _converge(
    fits: Sequence[PairFit], offset: float, skew: float, reference: float, window: tuple[float, float], thin: bool
) -> tuple[float, float]:
    """(offset, skew) after Gauss-Newton steps on the samples in ``window``; unchanged where they are not identifiable there."""
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
