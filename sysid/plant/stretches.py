"""Stretches of a recording in which an axis has a command, and the command held over short gaps in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine import Machine
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
        moved = filled.copy()
        for first, last in stretches:
            moved[first:last] = filled[np.clip(np.arange(first, last) - shift, first, last - 1)]
        filled = moved
    return filled, stretches


def held(command: Array, rate_hz: float) -> tuple[Array, Segments]:
    """The command with short gaps held, and the stretches (first, last+1) between longer ones."""
    there = ~np.isnan(command)
    if not there.any():
        return np.zeros(len(command)), np.empty((0, 2), dtype=np.int64)
    if there.all():
        return command.copy(), np.array([[0, len(command)]], dtype=np.int64)
    index = np.where(there, np.arange(len(command)), -1)
    last = np.maximum.accumulate(index)
    age = np.arange(len(command)) - last
    usable = (last >= 0) & (age <= COMMAND_GAP * rate_hz)
    filled = np.where(usable, command[np.maximum(last, 0)], 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], usable, [False])).astype(np.int8)))
    return filled, edges.reshape(-1, 2).astype(np.int64)


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
