"""The list of all checks, and what runs them: those of a channel and of a recording at ingest, whose flags and texts are
stored, and those of a dataset whenever it is asked for.

Checks of a dataset compare what is known twice: positions with stroke and limits, speeds with ``gain``, cylinders with joints,
joints with the end effector, commands with the motion that follows, stamps with ``rate_hz``. They are computed from the tables
and not stored, so that they hold for versions of any age and for changed roles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.checks import axes, columns, flag, points, roles, sensors, streams
from sysid.datasets.checks.figures import CheckContext
from sysid.datasets.checks.finding import Finding
from sysid.datasets.checks.flag import Flag, SignalSamples, ends_of
from sysid.datasets.chunked import Array, Mask, copied, known, masked, median, median_step
from sysid.datasets.clocks.records import Placed, RecordingClocks, by_source
from sysid.datasets.recipe import IngestRecipe
from sysid.datasets.recording import ClockRecord, Dataset
from sysid.datasets.resample import gap_limit, hold
from sysid.machine import Machine
from sysid.progress import Progress, silent
from sysid.scratch import computed, leave, pieces
from sysid.signals import split_signal

#: Kinds of flags, in the order in which they are stored. ``sentinel`` and ``stamps`` are found in the rows of the file, and
#: ``marker_swap`` in the frames of rigid bodies; the rest by the checks of a channel.
KINDS = ("sentinel", "outlier", "jump", "marker_swap", "stuck", "saturation", "dropout", "jitter", "stamps")
ChannelChecks = Mapping[Callable[[SignalSamples], list[Flag]], tuple[str, ...]]
#: Of every channel, and of one with a measured signal: check → kinds of its flags.
CHANNEL_CHECKS: ChannelChecks = {flag.dropouts: ("dropout",), flag.jitter: ("jitter",)}
SENSOR_CHECKS: ChannelChecks = {
    sensors.outliers: ("outlier",),
    sensors.jumps: ("jump",),
    sensors.constant_values: ("stuck", "saturation"),
    **CHANNEL_CHECKS,
}
_OF_AXIS = ("range", "response", "sign", "linkage", "description")
#: Of a dataset, in the order in which they run: check → ends of the keys of its findings. What one finds, those below take into
#: account.
DATASET_CHECKS: Mapping[Callable[[CheckContext], Iterable[Finding]], tuple[str, ...]] = {
    streams.check_stamps: ("rate", "length"),
    axes.check_gains: ("gain",),
    columns.check_wraps: ("wrap",),
    streams.check_sentinels: ("sentinel",),
    columns.check_exchanges: ("exchanged",),
    axes.check_axes: _OF_AXIS,
    axes.check_recordings: _OF_AXIS,
    points.check_points: ("scale", "sign", "axes", "frame", "kinematics"),
    columns.check_columns: ("missing", "constant", "noise"),
    streams.check_samples: ("samples",),
    columns.check_end_stops: ("end_stop",),
    roles.check_roles: (roles.STILL,),
}


def check_plausibility(dataset: Dataset) -> tuple[Finding, ...]:
    """What is implausible in a dataset, severe findings first.

    The command line calls it at ingest, for ``--quality`` and before ``gap``; :func:`sysid.gap.find_gap` does not.
    """
    context, found = CheckContext(dataset), list[Finding]()
    for check in DATASET_CHECKS:
        found += check(context)
        leave()
    return tuple(sorted(found, key=lambda finding: finding.severity != "severe"))


def recording_flags(table: columns.RecordingTable) -> list[str]:
    """Possible faults in the table of a recording, as texts."""
    return [*columns.empty_columns(table), *columns.implausible_positions(table)]


#: Shares of the largest command above which an axis is commanded, and above which it moves with certainty.
IDLE, DRIVEN = 0.02, 0.3
#: On a position axis the command itself has to change: by this share of its range over this time [s].
MOVING_SHARE, MOVING_S = 0.05, 0.5


def flag_rows(
    recording: RecordingClocks,
    clocks: Sequence[ClockRecord],
    machine: Machine,
    hold_s: float = IngestRecipe.hold_s,
    progress: Progress = silent,
) -> list[dict[str, Any]]:
    """Flags of one recording as JSON values by signal and time, see "What is flagged" in ``docs/recipes.md``.

    Static poses have none but numbers that stand for "no value": nothing is recorded between them, and a signal that moves
    within one is missing in its row.

    Args:
        hold_s: longest hold of a command [s].
        progress: called with the share of the samples that have been checked.
    """
    poses = recording.kind == "poses"
    if poses and not any(channel.flags for channel in recording.channels):
        return []
    placed = Placed(recording, by_source(clocks, recording.name))
    timed = [(channel, placed.times(channel)) for channel in recording.channels]
    timed = [(channel, at) for channel, at in timed if len(at)]
    commands = [(channel, at) for channel, at in timed if channel.signal.endswith(".command")]
    found: list[tuple[str, Flag]] = []
    done, total = 0, sum(len(at) for _, at in timed)
    for channel, at in timed:
        progress(done / total, f"checking {channel.signal}")
        done += len(at)
        flags = _while_reading(channel, at)
        if poses:
            flags = [flag for flag in flags if flag.kind == "sentinel"]
        else:
            swaps = [flag for flag in flags if flag.kind == "marker_swap"]
            samples, checks = _samples(channel, at, commands, machine, hold_s)
            more = [flag for check in checks for flag in check(samples)]
            flags += [flag for flag in more if not _is_swap(flag, swaps, channel.period_s)]
            leave()
        found += [(channel.source, flag) for flag in flags]
    found.sort(key=lambda item: (item[1].signal, item[0], KINDS.index(item[1].kind), item[1].from_s))
    return [{"recording": recording.name, "source": source, **asdict(flag)} for source, flag in found]


def _while_reading(channel: Channel, at: Array) -> list[Flag]:
    """Flags from reading a channel, on the time axis of the recording."""
    if not channel.flags:
        return []
    own = seconds(channel.stamps, int(channel.stamps[0]))
    return [
        replace(flag, from_s=float(np.interp(flag.from_s, own, at)), to_s=float(np.interp(flag.to_s, own, at)))
        for flag in channel.flags
    ]


def _is_swap(flag: Flag, swaps: Sequence[Flag], period: float) -> bool:
    """Whether a dropout consists of the frames of a mistake that is already flagged."""
    slack = 1.5 * period
    return flag.kind == "dropout" and any(s.from_s - slack <= flag.from_s and flag.to_s <= s.to_s + slack for s in swaps)


def _samples(
    channel: Channel, at: Array, commands: Sequence[tuple[Channel, Array]], machine: Machine, hold_s: float
) -> tuple[SignalSamples, ChannelChecks]:
    """The samples of a channel, at these times of the recording [s], and the checks that look at them."""
    signal, values, unit = channel.signal, channel.values, channel.unit
    if signal.endswith(".command"):
        return SignalSamples(signal, at, values, unit, hold_s), CHANNEL_CHECKS
    commanded, driven = _commanded(signal, at, commands, machine, hold_s)
    limit, ends = gap_limit(channel), ends_of(signal, machine)
    return SignalSamples(signal, at, values, unit, limit, commanded, driven, ends), SENSOR_CHECKS


def _commanded(
    signal: str, at: Array, commands: Sequence[tuple[Channel, Array]], machine: Machine, hold_s: float
) -> tuple[Mask, Mask]:
    """Where the axes that move ``signal`` are commanded, and certain to move: its own axis, for a point any axis."""
    owner, _ = split_signal(signal)
    commanded, driven = np.zeros(len(at), dtype=bool), np.zeros(len(at), dtype=bool)
    period = median_step(at) if len(at) > 1 else 0.0
    for axis in machine.axes:
        own = [item for item in commands if item[0].signal == f"{axis.name}.command"]
        if not own or (owner in machine.axis_names and owner != axis.name):
            continue
        command, *others = (hold(sent, channel.values, at, 0.0, hold_s) for channel, sent in own)
        for part in others:
            np.copyto(command, part, where=~np.isnan(part))
        more = _moving(command, period) if axis.follows_positions else _beyond(command, DRIVEN)
        commanded |= more if axis.follows_positions else _beyond(command, IDLE)
        if axis.actuation != "force":  # a force may hold without moving
            driven |= more
    return commanded, driven


def _beyond(command: Array, share: float) -> Mask:
    def size(first: int, last: int) -> Array:
        return np.nan_to_num(np.abs(command[first:last]))

    least = share * max((float(size(first, last).max()) for first, last in pieces(len(command))), default=0.0)
    return masked(len(command), lambda first, last: size(first, last) > least)


def _moving(command: Array, period: float) -> Mask:
    usual = median(copied(known(command))) if np.isfinite(command).any() else 0.0
    sent = computed(len(command), lambda first, last: np.nan_to_num(command[first:last], nan=usual))
    width = max(round(MOVING_S / period), 1) if period > 0.0 else 1
    moved = np.zeros(len(sent), dtype=bool)
    if len(sent) > width:
        least = MOVING_SHARE * float(np.ptp(sent))
        moved[width:] = masked(len(sent) - width, lambda a, b: np.abs(sent[a + width : b + width] - sent[a:b]) > least)
    return moved
