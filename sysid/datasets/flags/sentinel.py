"""A number that stands for "no value": -9999, 65535 and the like, apart from everything that a sensor measures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.datasets.flags.flag import Array, Flag, Mask
from sysid.machine import Machine
from sysid.signals import split_signal

#: Least number of samples with exactly this number, and of others.
LEAST, LEAST_OTHERS = 3, 10


def ends_of(signal: str, machine: Machine) -> tuple[float, float]:
    """Range of the axis that ``signal`` measures, in SI; infinite where it is not known."""
    owner, kind = split_signal(signal)
    for axis in machine.axes:
        if axis.name == owner:
            if kind == "joint" and axis.limits is not None:
                return axis.limits
            if kind == "cylinder" and axis.stroke is not None:
                return axis.stroke
    return (-np.inf, np.inf)


def sentinels(signal: str, raw: Array, values: Array, stamps: npt.NDArray[np.int64], ends: tuple[float, float]) -> list[Flag]:
    """The numbers of a measured signal that are no measurement, a flag each; seconds count from the first stamp.

    Such a number is the lowest or highest, recurs exactly, lies further from all others than they lie apart and than they lie
    from zero, and is no position of the axis. A sensor that moves there passes values in between. Commands are not examined:
    they jump.

    Args:
        raw: as in the file, (n,).
        values: the same in SI, NaN where there is none, (n,).
        stamps: in nanoseconds, (n,).
        ends: range of the axis in SI; infinite where it is not known.
    """
    if signal.endswith(".command"):
        return []
    found: list[Flag] = []
    left = np.isfinite(raw) & np.isfinite(values)
    while (apart := _apart(raw, left)) is not None:
        numbers, (low, high) = apart
        for number in numbers:
            own = left & (raw == number)
            rows = np.flatnonzero(own)
            left &= ~own
            there = float(values[rows[0]])
            if np.isfinite(ends).all() and ends[0] <= there <= ends[1]:
                continue
            text = f"{number:.10g} stands in {len(rows)} samples, apart from all others ({low:.4g} to {high:.4g})"
            begin, end = ((stamps[rows[[0, -1]]] - stamps[0]) * 1e-9).tolist()
            found.append(Flag(signal, "sentinel", float(begin), float(end), len(rows), text))
    return found


def _apart(raw: Array, left: Mask) -> tuple[list[float], tuple[float, float]] | None:
    """The lowest, the highest or both numbers, where they recur and lie apart from all others, and the range of these."""
    if np.count_nonzero(left) < LEAST + LEAST_OTHERS:
        return None
    ends = [float(np.fmin.reduce(raw, where=left, initial=np.inf)), float(np.fmax.reduce(raw, where=left, initial=-np.inf))]
    often = [number for number in ends if np.count_nonzero(left & (raw == number)) >= LEAST]
    for numbers in ([number] for number in often) if len(often) < 2 else (often[:1], often[1:], often):
        others = left & ~np.isin(raw, numbers)
        if np.count_nonzero(others) < LEAST_OTHERS:
            continue
        low, high = (
            float(np.fmin.reduce(raw, where=others, initial=np.inf)),
            float(np.fmax.reduce(raw, where=others, initial=-np.inf)),
        )
        distance = min(max(low - number, number - high) for number in numbers)
        if low < high and distance > max(high - low, abs(low), abs(high)):
            return numbers, (low, high)
    return None
