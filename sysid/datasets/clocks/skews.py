"""The skew of a device, pooled over its recordings, and whether it is accurate enough to be applied."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.datasets.clocks.alignment import Estimate
from sysid.datasets.recording import ClockRecord

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
