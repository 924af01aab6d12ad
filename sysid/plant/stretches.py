"""Stretches of a recording in which an axis has a command, and the command held over short gaps in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import copied
from sysid.datasets.chunked import stretches as bounds
from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.scratch import empty, pieces, put
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
Segments = npt.NDArray[np.int64]

#: A command may be missing this long [s] before the free run restarts.
COMMAND_GAP = 0.1


def held_for(machine: Machine, recording: Recording, axis: str) -> tuple[Array, Segments]:
    """:func:`held` of the command of an axis, in the rows in which the plant takes it (:meth:`Machine.command_shift`).

    A command moved later begins with the first one of its stretch, one moved earlier ends with the last one.
    """
    filled, stretches = held(recording.values(axis_signal(axis, "command")), recording.rate_hz)
    shift = machine.command_shift(axis)
    if shift:
        moved = copied(filled)
        for first, last in stretches:
            moved[first:last] = filled[np.clip(np.arange(first, last) - shift, first, last - 1)]
        filled = moved
    return filled, stretches


def held(command: Array, rate_hz: float) -> tuple[Array, Segments]:
    """The command with short gaps held, and the stretches (first, last+1) between longer ones."""
    filled, usable = empty(len(command)), empty(len(command), np.bool_)
    last = -1  # row of the latest command
    for begin, end in pieces(len(command)):
        if not np.isnan(command[begin:end]).any():
            usable[begin:end], last = True, end - 1
            put(filled, begin, command[begin:end])
            continue
        rows = np.arange(begin, end)
        latest = np.maximum.accumulate(np.where(np.isnan(command[begin:end]), last, rows))
        last = int(latest[-1])
        usable[begin:end] = known = (latest >= 0) & (rows - latest <= COMMAND_GAP * rate_hz)
        put(filled, begin, np.where(known, command[np.maximum(latest, 0)], 0.0))
    return filled, np.column_stack(bounds(usable)).astype(np.int64)


def common_stretches(stretches: Sequence[Segments], count: int) -> Segments:
    """First and last+1 of the samples that are in one of the stretches (m, 2) of every axis, of ``count`` samples."""
    inside = np.zeros(count + 1, dtype=np.int64)
    for part in stretches:
        np.add.at(inside, part[:, 0], 1)
        np.add.at(inside, part[:, 1], -1)
    there = np.cumsum(inside[:count]) == len(stretches)
    return np.flatnonzero(np.diff(np.concatenate(([False], there, [False])).astype(np.int8))).reshape(-1, 2)


def split(segments: Segments, length: int) -> Segments:
    """Every stretch cut into pieces of at most ``length`` samples."""
    cut = [(k, min(k + length, last)) for first, last in segments for k in range(first, last, length)]
    return np.array(cut, dtype=np.int64).reshape(-1, 2)
