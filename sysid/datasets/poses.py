"""Static poses: one row for each phase in which the machine is at rest, with the median of every signal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.clocks.bursts import BURST_PERIODS
from sysid.datasets.recipe import StillPhases
from sysid.errors import InputError

Array = npt.NDArray[np.float64]

#: A signal that moves by more standard deviations of its noise within a phase (a swinging tool) is missing there.
MAX_MOTION = 12.0


def still_phases(signals: Mapping[str, tuple[Array, Array]], rules: StillPhases, where: object) -> list[tuple[float, float]]:
    """Start and end [s] of every phase in which all ``signals`` (name → times, values of the machine's sensors) are constant.

    Raises:
        InputError: no signal, or no such phase.
    """
    if not signals:
        raise InputError(f"{where}", "no measured signal on the machine's clock", "a joint or cylinder sensor")
    times = max((t for t, _ in signals.values()), key=len)
    period = float(np.median(np.diff(times)))
    still = np.ones(len(times), dtype=bool)
    half = rules.seconds / 2.0
    first = np.searchsorted(times, times - half, side="left")
    last = np.searchsorted(times, times + half, side="right")
    for own_times, values in signals.values():
        on = values if own_times is times else np.interp(times, own_times, values)
        spread = float(np.nanmax(on) - np.nanmin(on))
        limit = max(rules.tolerance * spread, 1e-9)
        still &= _ranges(on, first, last, times, period) <= limit
    phases = []
    rows = np.flatnonzero(still)
    if len(rows):
        breaks = np.flatnonzero((np.diff(rows) > 1) | (np.diff(times[rows]) > BURST_PERIODS * period)) + 1
        phases = [(float(times[r[0]]), float(times[r[-1]])) for r in np.split(rows, breaks)]
    phases = [(begin, end) for begin, end in phases if end - begin >= rules.seconds]
    if not phases:
        found = f"no phase at rest of {rules.seconds:g} s"
        raise InputError(f"{where}", found, "static poses", "Hold each pose longer, or set [still] in the recipe.")
    return phases


def _ranges(values: Array, first: npt.NDArray[np.intp], last: npt.NDArray[np.intp], times: Array, period: float) -> Array:
    """Largest minus smallest value within each window, which ends at gaps."""
    stretch = np.concatenate([[0], np.cumsum(np.diff(times) > BURST_PERIODS * period)])
    starts = np.searchsorted(stretch, stretch, side="left")
    ends = np.searchsorted(stretch, stretch, side="right")
    first, last = np.maximum(first, starts), np.minimum(last, ends)
    result = np.empty(len(values))
    for row, (a, b) in enumerate(zip(first, last, strict=True)):
        window = values[a:b]
        result[row] = window.max() - window.min()
    return result


def pose_table(
    phases: list[tuple[float, float]],
    signals: Mapping[str, tuple[Array, Array]],
    slack_s: Mapping[str, float],
    noise: Mapping[str, float],
    tolerance: float,
) -> pd.DataFrame:
    """One row a phase: ``time`` (its middle) and the median of each signal (times, values) within it.

    Args:
        noise: signal → its standard deviation; within a phase a signal may move by :data:`MAX_MOTION` times that.
        tolerance: the same for signals of unknown noise, as a share of their range.
        slack_s: signal → widening of the window for the uncertainty of its clock, negative to narrow it [s].
    """
    columns = {"time": np.array([(begin + end) / 2.0 for begin, end in phases])}
    for signal, (times, values) in signals.items():
        medians, ranges = np.full(len(phases), np.nan), np.full(len(phases), np.nan)
        slack = slack_s.get(signal, 0.0)
        for row, (begin, end) in enumerate(phases):
            margin = max(slack, -(end - begin) / 4.0)
            inside = values[np.searchsorted(times, begin - margin - 1e-6) : np.searchsorted(times, end + margin + 1e-6)]
            inside = inside[~np.isnan(inside)]
            if len(inside) >= 2:
                medians[row], ranges[row] = float(np.median(inside)), float(np.ptp(inside))
        known = medians[~np.isnan(medians)]
        spread = float(np.ptp(known)) if len(known) else 0.0
        limit = MAX_MOTION * noise[signal] if signal in noise else max(tolerance * spread, 1e-9)
        medians[ranges > limit] = np.nan
        columns[signal] = medians
    return pd.DataFrame(columns)
