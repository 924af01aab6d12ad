"""Clock records of each file of another device in each recording, and their application to its stamps.

A file has one record, or one for each piece where its clock was set or paused while it recorded. A piece begins with the sample
whose stamp is the record's ``stream_start_ns`` and ends where the next one begins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.chunked import Array
from sysid.datasets.clocks.alignment import Estimate, Pair, conditional, pairs_of
from sysid.datasets.clocks.estimate import KnownSkew, Skew, alone, known_skews, pooled, quantile
from sysid.datasets.clocks.resets import Piece, pieces
from sysid.datasets.poses import match_bursts
from sysid.datasets.recording import ClockRecord, Kind
from sysid.errors import AlignmentError, InputError
from sysid.scratch import empty
from sysid.scratch import pieces as sample_pieces

__all__ = ["KnownSkew", "RecordingClocks", "align", "by_source", "known_skews", "machine_times"]

_LATENCY = "a constant latency of this device is part of the offset and not identifiable"
#: A pause of the machine's stamps is a step of its clock if a step of another clock agrees with it to this share.
_STEP_SHARE = 0.2


@dataclass(frozen=True)
class RecordingClocks:
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
            if not self.channels:
                remedy = 'Map fields to signals in the recipe; its lines that begin with "#" are not read.'
                raise InputError(f"recording {self.name}", "no signal of the machine", "commands or sensors", remedy)
            remedy = 'Write `domain = "machine"` for the stream to whose clock all others are aligned.'
            found = "no samples on the machine's clock"
            raise InputError(f"recording {self.name}", found, "commands or sensors of the machine", remedy)
        return min(int(channel.stamps[0]) for channel in self.machine)


@dataclass(frozen=True)
class Alignment:
    """Clock records of the recordings that could be placed in time, and the errors of the others by name."""

    records: tuple[ClockRecord, ...]
    refused: Mapping[str, AlignmentError]


def align(recordings: Sequence[RecordingClocks]) -> tuple[ClockRecord, ...]:
    """Clock records of all recordings; :func:`aligned` continues without those that cannot be placed in time.

    Raises:
        AlignmentError: no offset is observable and the stamps do not overlap; or the machine's own clock was set.
    """
    found = aligned(recordings)
    for error in found.refused.values():
        raise error
    return found.records


def aligned(recordings: Sequence[RecordingClocks], known: Mapping[str, KnownSkew] | None = None) -> Alignment:
    """Clock records of the recordings that can be placed in time.

    The skew is a property of two crystals: where the estimates of the recordings of one device agree, their weighted mean is
    applied to each; else each has its own. A skew with too wide an interval, or from too short a motion, is not applied.

    Args:
        known: clock domain → its skew from other recordings; counts as one more estimate.

    Raises:
        AlignmentError: the machine's own clock was set.
    """
    found = {recording.name: pieces_of(recording) for recording in recordings}
    skews = skews_of(found, known)
    records: list[ClockRecord] = []
    refused: dict[str, AlignmentError] = {}
    for recording in recordings:
        try:
            records += records_of(recording, found[recording.name], skews)
        except AlignmentError as error:
            refused[recording.name] = error
    return Alignment(tuple(records), refused)


def pieces_of(recording: RecordingClocks) -> dict[str, tuple[Piece, ...]]:
    """Clock → its pieces with their estimates, from one recording alone; none for static poses.

    Raises:
        AlignmentError: the machine's own clock was set.
    """
    if recording.kind == "poses":
        return {}
    found = {clock: pieces(_pairs(recording, channels)) for clock, channels in recording.clocks().items()}
    _check_machine(recording, found)
    return found


def skews_of(
    found: Mapping[str, Mapping[str, Sequence[Piece]]], known: Mapping[str, KnownSkew] | None = None
) -> dict[str, Skew | None]:
    """Clock domain → the skew that its recordings share; None where they contradict each other.

    Args:
        found: recording → :func:`pieces_of`.
        known: as of :func:`aligned`.
    """
    earlier = known if known is not None else {}
    skews = {}
    for domain in {_domain(clock) for own in found.values() for clock in own} | {*earlier}:
        estimates = [
            (name, piece.estimate)
            for name, own in found.items()
            for clock, parts in own.items()
            if _domain(clock) == domain
            for piece in parts
        ]
        skews[domain] = pooled(estimates, earlier.get(domain))
    return skews


def records_of(
    recording: RecordingClocks, found: Mapping[str, Sequence[Piece]], skews: Mapping[str, Skew | None]
) -> list[ClockRecord]:
    """Clock records of one recording.

    Args:
        found: its :func:`pieces_of`.
        skews: clock domain → :func:`skews_of`.

    Raises:
        AlignmentError: no offset is observable and the stamps do not overlap.
    """
    records: list[ClockRecord] = []
    for clock, channels in recording.clocks().items():
        shared = skews.get(_domain(clock))
        if recording.kind == "poses":
            records += _static(recording, channels, shared)
        else:
            records += _moving(recording, channels, found[clock], shared)
    return records


def machine_times(channel: Channel, start_ns: int, records: Sequence[ClockRecord] | None) -> Array:
    """Stamps of ``channel`` as seconds on the machine's clock from ``start_ns``, increasing.

    Args:
        records: of the channel's file in its recording, see :func:`by_source`; None for the machine's own clock.
    """
    if records is None:
        return seconds(channel.stamps, start_ns)
    own = sorted(records, key=lambda record: record.stream_start_ns)
    rows = np.searchsorted(channel.stamps, [record.stream_start_ns for record in own[1:]])
    edges = [0, *rows.tolist(), len(channel.stamps)]
    times: Array = empty(len(channel.stamps))
    for record, (first, last) in zip(own, pairwise(edges), strict=True):
        part = times[first:last]
        part[:] = seconds(channel.stamps[first:last], record.stream_start_ns)
        part *= 1.0 + 1e-6 * record.skew_ppm
        part += record.offset_s
    if len(own) > 1 and np.any(times[1:] <= times[:-1]):
        # After a reset, times may repeat: steps of one nanosecond keep the order.
        np.maximum.accumulate(times, out=times)
        for first, last in sample_pieces(len(times)):
            times[first:last] += 1e-9 * np.arange(first, last)
    return times


class Placed:
    """Channels of a recording on the machine's clock, in seconds from ``start_ns``; signals of one stream share their times."""

    def __init__(self, recording: RecordingClocks, records: Mapping[str, Sequence[ClockRecord]]) -> None:
        """``records``: of :func:`by_source`."""
        self.start_ns = recording.start_ns
        self._records = records
        self._times: dict[tuple[int, str], Array] = {}

    def times(self, channel: Channel) -> Array:
        """Stamps of ``channel``, (n,) [s]."""
        key = (id(channel.stamps), channel.source)
        if key not in self._times:
            records = self._records.get(channel.source) if channel.domain != "machine" else None
            self._times[key] = machine_times(channel, self.start_ns, records)
        return self._times[key]


def by_source(records: Sequence[ClockRecord], recording: str) -> dict[str, tuple[ClockRecord, ...]]:
    """Source file → its records, one a piece, for one recording."""
    found: dict[str, list[ClockRecord]] = {}
    for record in records:
        if record.recording == recording:
            found.setdefault(record.stream, []).append(record)
    return {source: tuple(own) for source, own in found.items()}


def _pairs(recording: RecordingClocks, channels: Sequence[Channel]) -> tuple[Pair, ...]:
    return pairs_of(recording.machine, channels, recording.start_ns, _stream_start(channels))


def _stream_start(channels: Sequence[Channel]) -> int:
    return min(int(channel.stamps[0]) for channel in channels)


def _piece_start(channels: Sequence[Channel], first_s: float) -> int:
    """Stamp of the first sample of a piece [ns]."""
    start = _stream_start(channels)
    if not math.isfinite(first_s):
        return start
    begin = start + round(first_s * 1e9) - 1  # the float is within a nanosecond of the stamp
    after = [int(c.stamps[row]) for c in channels if (row := int(np.searchsorted(c.stamps, begin))) < len(c.stamps)]
    return min(after)


def _domain(clock: str) -> str:
    return clock.partition(":")[0]


def _check_machine(recording: RecordingClocks, found: Mapping[str, tuple[Piece, ...]]) -> None:
    """Check that the machine's own clock was not set.

    Raises:
        AlignmentError: it was: a device that recorded without a pause steps against it at a gap of the same length in the
            machine's stamps, or several devices step against it at once.
    """
    steps = [
        (clock, after.first_s + after.estimate.at(after.first_s), before.last_s, _step(before, after))
        for clock, parts in found.items()
        for before, after in pairwise(parts)
    ]
    for clock, at, on_stream, size in steps:
        channels = recording.clocks()[clock]
        begin = _stream_start(channels)
        paused = max(_gap(c, begin, on_stream, 1.0) for c in channels)
        gaps = [_gap(c, recording.start_ns, at, 1.0 + abs(size)) for c in recording.machine]
        at_gap = bool(gaps) and size > 0.0 and abs(min(gaps) - size) < _STEP_SHARE * size and paused < 0.5 * size
        others = [s for s in steps if s[0] != clock and abs(s[1] - at) < 2.0 and abs(s[3] - size) < 0.01 + 0.05 * abs(size)]
        if at_gap or others:
            reason = "its stamps have a gap in which" if at_gap else "there, and only against it,"
            names = ", ".join(dict.fromkeys([channels[0].source, *(s[0].partition(":")[2] for s in others)]))
            raise AlignmentError(
                f"recording {recording.name}: the machine's clock",
                f"it was set by {size:+.3f} s at about {at:.2f} s: {reason} {names} continued evenly",
                "a machine's clock that is not set while it records",
                "Cut the log there into two recordings, or choose another clock of the machine's log in the recipe.",
            )


def _step(before: Piece, after: Piece) -> float:
    """Step of the stream's offset between two pieces [s]."""
    return after.estimate.at(after.first_s) - before.estimate.at(after.first_s)


def _gap(channel: Channel, origin_ns: int, at_s: float, reach_s: float) -> float:
    """The longest step between stamps of ``channel`` around ``at_s``, minus its period [s]."""
    times = seconds(channel.stamps, origin_ns)
    first, last = np.searchsorted(times, (at_s - reach_s, at_s + reach_s))
    near = times[max(int(first) - 1, 0) : int(last) + 1]
    return float(np.max(np.diff(near), initial=0.0)) - channel.period_s if len(near) > 1 else 0.0


def _moving(
    recording: RecordingClocks, channels: Sequence[Channel], parts: Sequence[Piece], shared: Skew | None
) -> list[ClockRecord]:
    records = []
    for number, piece in enumerate(parts):
        if piece.estimate.refused:
            return [_refused(recording, channels, piece.estimate.refused)]
        skew = shared if shared is not None else alone(piece.estimate)
        result = conditional(piece.estimate, skew.value)
        start = _piece_start(channels, piece.first_s)
        shift = (start - _stream_start(channels)) * 1e-9
        # Offset at the first stamp; its error combines that at mid-recording and that of the skew up to there.
        offset = shift + result.at(shift)
        error = quantile(result.degrees_of_freedom) * math.sqrt(result.covariance[0, 0])
        width = math.hypot(error, skew.half_width * (result.mid_time - shift))
        reset = ""
        if number:
            size = -_step(parts[number - 1], piece)
            reset = f"piece {number + 1} of {len(parts)}: at {offset:.3f} s its clock was set by {size:+.4f} s, or it paused"
        records.append(
            ClockRecord(
                recording=recording.name,
                stream=channels[0].source,
                offset_s=offset,
                skew_ppm=1e6 * skew.value,
                offset_interval95=(offset - width, offset + width),
                skew_interval95=(1e6 * skew.interval[0], 1e6 * skew.interval[1]),
                residual_rms=result.residual,
                used_signals=result.used,
                applied=True,
                reason="; ".join(reason for reason in (reset, skew.reason, *_backlash_notes(result), _LATENCY) if reason),
                stream_start_ns=start,
            )
        )
    return records


def _backlash_notes(found: Estimate) -> list[str]:
    return [
        f"with backlash of {abs(item.width):.2g} (SI) between {' and '.join(item.name.split('~'))}"
        for item in found.backlash
        if item.found
    ]


def _static(recording: RecordingClocks, channels: Sequence[Channel], shared: Skew | None) -> list[ClockRecord]:
    """Static poses: bursts of samples are matched; an accuracy of a fraction of a hold is sufficient, as nothing moves."""
    match = match_bursts(recording.machine, channels, recording.start_ns, _stream_start(channels))
    if match.refused:
        # A log without pauses between the poses contains motion, which gives a better estimate.
        records = _moving(recording, channels, pieces(_pairs(recording, channels)), shared)
        return [r if r.applied else replace(r, reason=f"{match.refused}; {r.reason}") for r in records]
    skew = shared.value if shared is not None and shared.applied else 0.0
    interval = shared.interval if shared is not None and shared.applied else (-math.inf, math.inf)
    offset = match.offset - skew * match.mid_time
    record = ClockRecord(
        recording=recording.name,
        stream=channels[0].source,
        offset_s=offset,
        skew_ppm=1e6 * skew,
        offset_interval95=(offset - match.half_width, offset + match.half_width),
        skew_interval95=(1e6 * interval[0], 1e6 * interval[1]),
        residual_rms=float("nan"),
        used_signals=match.used,
        applied=True,
        reason=f"static poses: {match.matched} of {match.total} holds matched by their values; skew from the motion recordings",
        stream_start_ns=_stream_start(channels),
    )
    return [record]


def _refused(recording: RecordingClocks, channels: Sequence[Channel], reason: str) -> ClockRecord:
    """The record without an estimate: stamps that overlap the machine's are taken as they are; others are an error."""
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
