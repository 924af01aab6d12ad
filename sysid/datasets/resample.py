"""Channels on their own stamps → a table on the machine's grid k/rate. Gaps stay gaps; commands are held."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sysid.datasets.channel import Channel
from sysid.datasets.chunked import Array, copied, sosfiltfilt_in_place, stretches
from sysid.scratch import chosen, computed, filled, leave, pieces

#: A gap is longer than this many sample periods of its source where the recipe gives no limit.
GAP_PERIODS = 3.0
#: A stamp this share of a grid period late still counts as on the grid (stamps are rounded, clocks jitter).
LATE_SHARE = 0.05
#: Sources this much faster than the grid are low-passed before decimation. A slower one aliases nothing below 0.35 of the
#: grid's rate, up to which the filter is flat.
FAST_RATIO = 1.3
#: The source is first interpolated to a grid this many times finer than its own, so that errors of interpolation are filtered.
OVERSAMPLING = 2
#: Attenuation of aliased content [dB], and settling time of the filter [grid periods]: after it less than 1e-6 of the energy of
#: the impulse response is left.
STOP_DB, SETTLE_PERIODS = 60.0, 16


def grid(start_ns: int, end_ns: int, rate_hz: float) -> Array:
    """Times ``k/rate_hz`` [s] from 0 to the last one that does not pass ``end_ns``."""
    count = int(np.floor((end_ns - start_ns) * 1e-9 * rate_hz + LATE_SHARE)) + 1
    return computed(max(count, 0), lambda first, last: np.arange(first, last) / rate_hz)


def hold(times: Array, values: Array, at: Array, period: float, hold_s: float) -> Array:
    """Zero-order hold: the last value at or before each instant ``at``, for at most ``hold_s``; NaN outside.

    Args:
        times: increasing, (n,) [s].
        values: (n,); a NaN is a missing message, over which the value before is held.
        at: instants (m,) [s].
        period: grid period [s]; a value may be late by up to :data:`LATE_SHARE` of it.
    """
    known = ~np.isnan(values)
    times, values = chosen(times, known), chosen(values, known)
    result: Array = filled(len(at), np.nan)
    if not len(times):
        return result
    for first, last in pieces(len(at)):
        some, part = at[first:last], result[first:last]
        index = np.searchsorted(times, some + LATE_SHARE * period, side="right") - 1
        found = index >= 0
        found[found] = some[found] - times[index[found]] <= hold_s
        part[found] = values[index[found]]
    return result


def interpolate(times: Array, values: Array, at: Array, max_gap_s: float, cubic: bool = False) -> Array:
    """Values between samples; NaN outside and in gaps longer than ``max_gap_s``.

    Linear, or cubic Hermite with the slopes of the parabola through three neighbours (exact for parabolas; a gap or an outlier
    affects only its neighbours).

    Args:
        times: increasing, (n,) [s].
        values: (n,), NaN where missing.
        at: (m,) [s].
    """
    return _interpolated(times, values, len(at), lambda first, last: at[first:last], max_gap_s, cubic)


def _interpolated(
    times: Array, values: Array, count: int, instants: Callable[[int, int], Array], max_gap_s: float, cubic: bool
) -> Array:
    """:func:`interpolate` at ``count`` instants, which ``instants`` returns in chunks."""
    known = ~np.isnan(values)
    times, values = chosen(times, known), chosen(values, known)
    if len(times) < 2:
        return filled(count, np.nan)
    gradients = slopes(times, values, max_gap_s) if cubic and len(times) > 2 else None
    return computed(count, lambda a, b: _between(times, values, gradients, instants(a, b), max_gap_s))


def _between(times: Array, values: Array, gradients: Array | None, at: Array, max_gap_s: float) -> Array:
    """:func:`interpolate` without missing values; ``gradients``: slope at each sample for a cubic."""
    result = np.full(len(at), np.nan)
    right = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    left = right - 1
    step = times[right] - times[left]
    # A sample on the grid up to rounding is used even beside a gap, and a step of exactly the longest gap is bridged.
    slack = 1e-9
    inside = (at >= times[0] - slack) & (at <= times[-1] + slack)
    bridged = inside & (step <= max_gap_s + slack)
    s = np.clip((at - times[left]) / step, 0.0, 1.0)
    if gradients is not None:
        h00, h10 = (1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2
        h01, h11 = s**2 * (3 - 2 * s), s**2 * (s - 1)
        between = h00 * values[left] + h10 * step * gradients[left] + h01 * values[right] + h11 * step * gradients[right]
    else:
        between = (1 - s) * values[left] + s * values[right]
    result[bridged] = between[bridged]
    for end in (left, right):
        on_sample = inside & ~bridged & (np.abs(at - times[end]) <= slack)
        result[on_sample] = values[end[on_sample]]
    return result


def slopes(times: Array, values: Array, max_gap_s: float) -> Array:
    """Slope at each sample from the parabola through it and its neighbours; one-sided beside a gap."""

    def piece(first: int, last: int) -> Array:
        begin, end = max(first - 1, 0), min(last + 1, len(times))  # a slope takes one sample on each side
        return _slopes(times[begin:end], values[begin:end], max_gap_s)[first - begin : last - begin]

    return computed(len(times), piece)


def _slopes(times: Array, values: Array, max_gap_s: float) -> Array:
    steps = np.diff(times)
    secants = np.diff(values) / steps
    result = np.empty(len(times))
    result[0], result[-1] = secants[0], secants[-1]
    before, after = steps[:-1], steps[1:]
    result[1:-1] = (secants[:-1] * after + secants[1:] * before) / (before + after)
    gap = steps > max_gap_s + 1e-9
    after_gap, before_gap = gap[:-1] & ~gap[1:], ~gap[:-1] & gap[1:]
    inner = result[1:-1]
    inner[after_gap] = secants[1:][after_gap]
    inner[before_gap] = secants[:-1][before_gap]
    return result


def low_pass(times: Array, values: Array, cut_hz: float, max_gap_s: float) -> Array:
    """Zero-phase Butterworth (order 4, forwards and backwards) in each stretch without gaps; short stretches are unchanged.

    Samples of a stretch are treated as evenly spaced, because the jitter of stamps is small against a source period.
    """
    from scipy.signal import butter

    known = np.flatnonzero(~np.isnan(values))
    result: Array = copied(values)
    if len(known) < 2:
        return result
    breaks = np.flatnonzero(np.diff(times[known]) > max_gap_s) + 1
    for stretch in np.split(known, breaks):
        if len(stretch) < 40:
            continue
        rate = (len(stretch) - 1) / (times[stretch[-1]] - times[stretch[0]])
        if cut_hz < 0.45 * rate:
            sections = butter(4, cut_hz, fs=rate, output="sos")
            # Both ends are extended by the settling time of the filter.
            padding = min(len(stretch) - 1, max(15, int(3.0 * rate / cut_hz)))
            filtered = copied(values[stretch])
            sosfiltfilt_in_place(sections, filtered, padding)
            result[stretch] = filtered
    return result


def _limit_band(values: Array, factor: int) -> None:
    """Limit evenly spaced samples (n,) in place to the band of a grid ``factor`` times as coarse, each stretch without NaN.

    Chebyshev II of order 6, forwards and backwards: flat to 0.35 of the coarse rate, −6 dB at 0.4, −60 dB from its Nyquist
    frequency on. Ends are mirrored through their last sample, which continues a steady motion.
    """
    from scipy.signal import cheby2

    sections = cheby2(6, STOP_DB / 2.0, 1.0 / factor, output="sos")
    for first, last in zip(*stretches(~np.isnan(values)), strict=True):
        if last - first > 1:
            sosfiltfilt_in_place(sections, values[first:last], min(SETTLE_PERIODS * factor, int(last - first) - 1))


def anti_aliased(times: Array, values: Array, at: Array, rate_hz: float, factor: int, max_gap_s: float) -> Array:
    """Values at the grid instants ``at`` without content above its Nyquist frequency.

    The samples are interpolated at their own instants (stamps may be uneven) to a grid ``factor`` times as fine, low-passed,
    and decimated.
    """
    fine_hz = factor * rate_hz
    first = int(np.ceil((times[0] - at[0]) * fine_hz - LATE_SHARE))
    last = int(np.floor((times[-1] - at[0]) * fine_hz + LATE_SHARE))
    result: Array = filled(len(at), np.nan)
    if last < first:
        return result

    def instants(begin: int, end: int) -> Array:
        return np.asarray(at[0] + np.arange(first + begin, first + end) / fine_hz)

    fine = _interpolated(times, values, last + 1 - first, instants, max_gap_s, cubic=True)
    leave()
    _limit_band(fine, factor)
    begin, end = max(-(-first // factor), 0), min(last // factor + 1, len(at))
    if begin < end:
        result[begin:end] = fine[begin * factor - first : (end - 1) * factor - first + 1 : factor]
    return result


def gap_limit(channel: Channel) -> float:
    """The longest gap that is bridged [s]."""
    return channel.max_gap_s if channel.max_gap_s is not None else GAP_PERIODS * channel.period_s


def resample(channel: Channel, times: Array, at: Array, rate_hz: float, hold_s: float) -> Array:
    """One channel on the grid ``at`` = k/``rate_hz``; ``times`` are its stamps on the machine's clock [s], same origin.

    Commands are held; measured signals are interpolated, and low-passed where the source is faster than the grid.
    """
    if not len(times):
        return filled(len(at), np.nan)
    if channel.signal.endswith(".command"):
        return hold(times, channel.values, at, 1.0 / rate_hz, hold_s)
    limit = gap_limit(channel)
    ratio = 1.0 / (channel.period_s * rate_hz) if channel.period_s > 0.0 else 0.0
    if ratio >= FAST_RATIO and len(at):
        return anti_aliased(times, channel.values, at, rate_hz, int(np.ceil(OVERSAMPLING * ratio)), limit)
    return interpolate(times, channel.values, at, limit, cubic=channel.interpolation == "cubic")
