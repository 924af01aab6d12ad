"""Runs every fault detector on every channel of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.chunked import copied, known, masked, median, median_step
from sysid.datasets.clocks.records import Placed, RecordingClocks, by_source
from sysid.datasets.flags.flag import KINDS, Array, Flag, Mask, dropouts, jitter
from sysid.datasets.flags.values import SensorContext, ends_of, jumps, outliers, saturation, stuck
from sysid.datasets.recipe import IngestRecipe
from sysid.datasets.recording import ClockRecord
from sysid.datasets.resample import gap_limit, hold
from sysid.machine import Machine
from sysid.progress import Progress, silent
from sysid.scratch import computed, leave, pieces
from sysid.signals import split_signal

#: A channel and its stamps on the time axis of the recording [s].
Timed = tuple[Channel, Array]

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
        machine: gives the axes and their ends.
        hold_s: longest hold of a command [s].
        progress: called with the share of the samples that have been checked.
    """
    if recording.kind == "poses" and not any(channel.flags for channel in recording.channels):
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
        flags = _on_axis(channel, at) if channel.flags else []
        if recording.kind == "poses":
            found += [(channel.source, flag) for flag in flags if flag.kind == "sentinel"]
            continue
        swaps = [flag for flag in flags if flag.kind == "marker_swap"]
        flags += [flag for flag in _of(channel, at, commands, machine, hold_s) if not _is_swap(flag, swaps, channel.period_s)]
        found += [(channel.source, flag) for flag in flags]
        leave()
    found.sort(key=lambda item: (item[1].signal, item[0], KINDS.index(item[1].kind), item[1].from_s))
    return [{"recording": recording.name, "source": source, **asdict(flag)} for source, flag in found]


def _on_axis(channel: Channel, at: Array) -> list[Flag]:
    """Flags from reading a channel, on the time axis of the recording."""
    own = seconds(channel.stamps, int(channel.stamps[0]))
    return [
        replace(flag, from_s=float(np.interp(flag.from_s, own, at)), to_s=float(np.interp(flag.to_s, own, at)))
        for flag in channel.flags
    ]


def _is_swap(flag: Flag, swaps: Sequence[Flag], period: float) -> bool:
    """Whether a dropout consists of the frames of a mistake that is already flagged."""
    slack = 1.5 * period
    return flag.kind == "dropout" and any(s.from_s - slack <= flag.from_s and flag.to_s <= s.to_s + slack for s in swaps)


def _of(channel: Channel, at: Array, commands: Sequence[Timed], machine: Machine, hold_s: float) -> list[Flag]:
    signal, values, unit = channel.signal, channel.values, channel.unit
    if signal.endswith(".command"):
        return [*jitter(signal, at), *dropouts(signal, at, values, hold_s)]
    context = _context(signal, at, commands, machine, hold_s)
    saturated = saturation(signal, at, values, context, ends_of(signal, machine), unit)
    constant = [
        flag
        for flag in stuck(signal, at, values, context, unit)
        if not any(flag.from_s <= other.to_s and other.from_s <= flag.to_s for other in saturated)
    ]
    return [
        *outliers(signal, at, values, unit),
        *(jumps(signal, at, values, unit) if split_signal(signal)[1] != "speed" else ()),  # an end stop is a jump of the speed
        *constant,
        *saturated,
        *dropouts(signal, at, values, gap_limit(channel)),
        *jitter(signal, at),
    ]


def _context(signal: str, at: Array, commands: Sequence[Timed], machine: Machine, hold_s: float) -> SensorContext:
    """Commands of the axes that move ``signal``: its own axis, for a point any axis."""
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
    return SensorContext(commanded, driven)


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
