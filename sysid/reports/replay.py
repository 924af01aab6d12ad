"""A short replay of the machine and its simulation around the largest error, as data that the page's script draws."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.gap.result import GapResult, Traces
from sysid.machine import Kinematics, Machine
from sysid.reports import words
from sysid.reports.figures import packed
from sysid.reports.moments import largest_error_signals, worst_moment
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Length of the replay [s] and its frames per second.
WINDOW, RATE = 12.0, 25.0


def replay(gap: GapResult, machine: Machine, repaired: bool) -> dict[str, Any] | None:
    """Points of the machine over time: link origins, tip and tool of each version, (frames × points × 3) [m].

    None without a URDF, or where a joint was not recorded.
    """
    kinematics = machine.kinematics()
    signals = largest_error_signals(gap)
    moments = [moment for signal in signals if (moment := worst_moment(gap.traces, signal, "before")) is not None]
    if kinematics is None or not gap.traces or not moments:
        return None
    moment = moments[0]
    trace = next(trace for trace in gap.traces if trace.recording == moment.recording)
    rows = _rows(trace, moment.time)
    versions = ("measured", "before", *(("after",) if repaired else ()))
    found = {version: _points(getattr(trace, version).iloc[rows], machine, kinematics) for version in versions}
    if any(points is None or not np.isfinite(points).any() for points in found.values()):
        return None
    time = trace.measured["time"].to_numpy(dtype=np.float64)[rows]
    return {
        "recording": trace.recording,
        "signal": words.signal_name(moment.signal),
        "at": moment.time,
        "time": packed(time),
        "frames": len(rows),
        "rate": RATE,
        "versions": {name: packed(points.ravel()) for name, points in found.items() if points is not None},
    }


def _rows(trace: Traces, moment: float) -> npt.NDArray[np.int64]:
    """Row of each frame: the window around a moment, inside the recording, at a constant rate."""
    time = trace.measured["time"].to_numpy(dtype=np.float64)
    length = min(WINDOW, float(time[-1] - time[0]))
    begin = min(max(moment - 0.5 * length, float(time[0])), float(time[-1]) - length)
    wanted = begin + np.arange(1 + int(length * RATE)) / RATE
    return np.minimum(np.searchsorted(time, wanted), len(time) - 1)


def _points(table: pd.DataFrame, machine: Machine, kinematics: Kinematics) -> Array | None:
    """Origins of the links, then tip and tool as the table has them; NaN where a value is missing."""
    columns = [axis_signal(axis.name, "joint") for axis in machine.axes]
    if not set(columns) <= set(table.columns):
        return None
    poses = kinematics.link_poses(table[columns].to_numpy(dtype=np.float64))
    points = [pose[:, :3, 3] for pose in poses.values()]
    for name in ("ee", "tool"):
        own = list(point_signals(name))
        there = set(own) <= set(table.columns)
        points.append(table[own].to_numpy(dtype=np.float64) if there else np.full((len(table), 3), np.nan))
    return np.stack(points, axis=1)
