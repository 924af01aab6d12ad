"""Clock records: one for each file of another device in each recording, and what they do to its stamps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.alignment import MAX_SKEW_HALF_WIDTH, Estimate, Pair, estimate, pairs_of
from sysid.datasets.bursts import match_bursts
from sysid.datasets.channel import Channel, seconds
from sysid.datasets.recording import ClockRecord, Kind
from sysid.errors import AlignmentError, InputError

Array = npt.NDArray[np.float64]

#: Degrees of freedom of what earlier recordings say together.
_MANY = 1000
_LATENCY = "a constant latency of this device is part of the offset: it cannot be told apart"


@dataclass(frozen=True)
class Clocked:
    """A recording whose clocks are to be aligned."""

    name: str
    kind: Kind
    channels: tuple[Channel, ...]

    @property
    def machine(self) -> tuple[Channel, ...]:
        return tuple(channel for channel in self.channels if channel.domain == "machine" and len(channel.stamps))

    def clocks(self) -> dict[str, tuple[Channel, ...]]:
        """Clock → its channels, without the machine's."""
        others: dict[str, list[Channel]] = {}
        for channel in self.channels:
            if channel.domain != "machine" and len(channel.stamps):
                others.setdefault(channel.clock, []).append(channel)
        return {clock: tuple(channels) for clock, channels in others.items()}

    @property
    def start_ns(self) -> int:
        """First stamp on the machine's clock: time zero of the recording."""
        if not self.machine:
            found = "no samples on the machine's clock"
            raise InputError(f"recording {self.name}", found, "commands or sensors of the machine")
        return min(int(channel.stamps[0]) for channel in self.machine)


@dataclass(frozen=True)
class KnownSkew:
    """Skew of a device from recordings that were aligned before.

    Args:
        skew_ppm: as in their clock records, with its 95 % interval.
        recordings: how many they were.
    """

    skew_ppm: float
    interval95: tuple[float, float]
    recordings: int

    @property
    def variance(self) -> float:
        """Of the skew as a share, not ppm."""
        return (1e-6 * _half(self.interval95) / _quantile(_MANY)) ** 2


def _half(interval: tuple[float, float]) -> float:
    return (interval[1] - interval[0]) / 2.0


def known_skews(records: Sequence[ClockRecord], domains: Mapping[tuple[str, str], str]) -> dict[str, KnownSkew]:
    """What earlier records say of the skew of each device, where they applied one and its recordings agree.

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
        # Recordings that were added later share a skew that holds what was known before: the narrowest interval is of all.
        best = min(own, key=lambda record: _half(record.skew_interval95))
        if all(abs(r.skew_ppm - best.skew_ppm) <= _half(r.skew_interval95) + _half(best.skew_interval95) for r in own):
            shown = {record.recording for record in own if math.isfinite(record.residual_rms)}  # static poses show none
            known[domain] = KnownSkew(best.skew_ppm, best.skew_interval95, len(shown))
    return known


def align(recordings: Sequence[Clocked], known: Mapping[str, KnownSkew] | None = None) -> tuple[ClockRecord, ...]:
    """Clock records of all recordings.

    The skew is a property of two crystals: where the estimates of the recordings of one device agree, their weighted mean is
    applied to each; where they do not, each has its own. A skew whose interval is too wide is not applied.

    Args:
        known: clock domain → its skew from recordings that are not among these; counts as one more estimate.

    Raises:
        AlignmentError: nothing can be observed and the stamps do not even overlap, so the samples have no place in time.
    """
    first: dict[tuple[str, str], Estimate] = {}
    for recording in recordings:
        for clock, channels in recording.clocks().items():
            if recording.kind == "motion":
                first[recording.name, clock] = estimate(_pairs(recording, channels))
    earlier = known if known is not None else {}
    pooled = {
        domain: _pool(first, domain, earlier.get(domain)) for domain in {_domain(clock) for _, clock in first} | {*earlier}
    }
    records = []
    for recording in recordings:
        for clock, channels in recording.clocks().items():
            shared = pooled.get(_domain(clock))
            if recording.kind == "poses":
                records.append(_static(recording, clock, channels, shared))
            else:
                records.append(_moving(recording, clock, channels, first[recording.name, clock], shared))
    return tuple(records)


def machine_times(channel: Channel, start_ns: int, record: ClockRecord | None) -> Array:
    """Stamps of ``channel`` as seconds on the machine's clock from ``start_ns``."""
    if record is None:
        return seconds(channel.stamps, start_ns)
    return seconds(channel.stamps, record.stream_start_ns) * (1.0 + 1e-6 * record.skew_ppm) + record.offset_s


def _pairs(recording: Clocked, channels: Sequence[Channel]) -> tuple[Pair, ...]:
    return pairs_of(recording.machine, channels, recording.start_ns, _stream_start(channels))


def _stream_start(channels: Sequence[Channel]) -> int:
    return min(int(channel.stamps[0]) for channel in channels)


def _domain(clock: str) -> str:
    return clock.partition(":")[0]


@dataclass(frozen=True)
class _Skew:
    """Skew shared by the recordings of a device, or why it is not applied (``value`` is a share, not ppm)."""

    value: float
    interval: tuple[float, float]
    applied: bool
    reason: str


def _quantile(degrees_of_freedom: int) -> float:
    from scipy.stats import t

    return float(t.ppf(0.975, max(degrees_of_freedom, 1)))


def _pool(estimates: Mapping[tuple[str, str], Estimate], domain: str, known: KnownSkew | None = None) -> _Skew | None:
    """The common skew of one device; None where the recordings contradict each other, or what is known of the device."""
    own = [e for (_, clock), e in estimates.items() if _domain(clock) == domain and not e.refused]
    if not own and known is None:
        return _Skew(0.0, (-math.inf, math.inf), False, "no recording shows the skew")
    before = [(1e-6 * known.skew_ppm, known.variance, _MANY)] if known is not None else []
    shown = [(e.skew, e.covariance[1, 1], e.degrees_of_freedom) for e in own] + before
    skews = np.array([skew for skew, _, _ in shown])
    weights = np.array([1.0 / variance for _, variance, _ in shown])
    mean = float(np.sum(weights * skews) / np.sum(weights))
    error = float(1.0 / math.sqrt(np.sum(weights)))
    freedom = sum(freedom for _, _, freedom in shown)
    count = len(own) + (known.recordings if known is not None else 0)
    if len(shown) > 1:
        from scipy.stats import chi2

        spread = float(np.sum(weights * (skews - mean) ** 2))
        if spread > chi2.ppf(0.999, len(shown) - 1):
            return None
        # Where the recordings scatter more than their errors say, the mean is less certain by that much.
        error *= max(1.0, math.sqrt(spread / (len(shown) - 1)))
    half = _quantile(freedom) * error
    return _judge(mean, half, f"common to {count} recordings" if count > 1 else "")


def _judge(skew: float, half: float, reason: str) -> _Skew:
    interval = (skew - half, skew + half)
    if half * 1e6 <= MAX_SKEW_HALF_WIDTH:
        return _Skew(skew, interval, True, reason)
    wide = f"skew not applied: known to ±{half * 1e6:.0f} ppm only (limit {MAX_SKEW_HALF_WIDTH:g}): record longer"
    return _Skew(0.0, interval, False, wide)


def _moving(recording: Clocked, clock: str, channels: Sequence[Channel], first: Estimate, shared: _Skew | None) -> ClockRecord:
    if first.refused:
        return _refused(recording, clock, channels, first.refused)
    half = _quantile(first.degrees_of_freedom) * math.sqrt(first.covariance[1, 1])
    skew = shared if shared is not None else _judge(first.skew, half, "differs between recordings: each has its own")
    result = estimate(_pairs(recording, channels), skew=skew.value, start=first.mid_offset)
    if result.refused:
        return _refused(recording, clock, channels, result.refused)
    # Offset at the stream's first stamp; its error holds that of the offset at mid-recording and of the skew up to there.
    offset = result.mid_offset - skew.value * result.mid_time
    skew_error = (skew.interval[1] - skew.interval[0]) / 2.0 if skew.applied else 0.0
    quantile = _quantile(result.degrees_of_freedom)
    width = math.hypot(quantile * math.sqrt(result.covariance[0, 0]), skew_error * result.mid_time)
    reasons = [reason for reason in (skew.reason, _LATENCY) if reason]
    return ClockRecord(
        recording=recording.name,
        stream=channels[0].source,
        offset_s=offset,
        skew_ppm=1e6 * skew.value,
        offset_interval95=(offset - width, offset + width),
        skew_interval95=(1e6 * skew.interval[0], 1e6 * skew.interval[1]),
        residual_rms=result.residual,
        used_signals=result.used,
        applied=True,
        reason="; ".join(reasons),
        stream_start_ns=_stream_start(channels),
    )


def _static(recording: Clocked, clock: str, channels: Sequence[Channel], shared: _Skew | None) -> ClockRecord:
    """Static poses: bursts of samples are matched; nothing moves in them, so a fraction of a hold is near enough."""
    match = match_bursts(recording.machine, channels, recording.start_ns, _stream_start(channels))
    if match.refused:
        # A log that runs on between the poses shows motion, and that says more than the poses would.
        record = _moving(recording, clock, channels, estimate(_pairs(recording, channels)), shared)
        return record if record.applied else replace(record, reason=f"{match.refused}; {record.reason}")
    skew = shared.value if shared is not None and shared.applied else 0.0
    interval = shared.interval if shared is not None and shared.applied else (-math.inf, math.inf)
    return ClockRecord(
        recording=recording.name,
        stream=channels[0].source,
        offset_s=match.offset - skew * match.mid_time,
        skew_ppm=1e6 * skew,
        offset_interval95=(
            match.offset - skew * match.mid_time - match.half_width,
            match.offset - skew * match.mid_time + match.half_width,
        ),
        skew_interval95=(1e6 * interval[0], 1e6 * interval[1]),
        residual_rms=float("nan"),
        used_signals=match.used,
        applied=True,
        reason=f"static poses: {match.matched} of {match.total} holds matched by their values; skew from the motion recordings",
        stream_start_ns=_stream_start(channels),
    )


def _refused(recording: Clocked, clock: str, channels: Sequence[Channel], reason: str) -> ClockRecord:
    """No estimate. Stamps that overlap the machine's are taken as they are; others have no place in time."""
    start, end = _stream_start(channels), max(int(channel.stamps[-1]) for channel in channels)
    machine_end = max(int(channel.stamps[-1]) for channel in recording.machine)
    if end < recording.start_ns or start > machine_end:
        raise AlignmentError(
            f"recording {recording.name}: {channels[0].source}",
            f"its clock cannot be aligned with the machine's: {reason}",
            "motion of one joint measured on both clocks, or stamps of one time base",
            "Map a joint or cylinder that both devices see (it may be `primary = false`), and move it while recording.",
        )
    nan = float("nan")
    return ClockRecord(
        recording=recording.name,
        stream=channels[0].source,
        offset_s=(start - recording.start_ns) * 1e-9,
        skew_ppm=0.0,
        offset_interval95=(nan, nan),
        skew_interval95=(nan, nan),
        residual_rms=nan,
        used_signals=(),
        applied=False,
        reason=f"{reason}; its stamps overlap the machine's and are taken as they are",
        stream_start_ns=start,
    )


def by_source(records: Sequence[ClockRecord], recording: str) -> dict[str, ClockRecord]:
    """Source file → record, for one recording."""
    return {record.stream: record for record in records if record.recording == recording}
