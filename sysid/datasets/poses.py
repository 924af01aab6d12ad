"""Static poses: logs of bursts, one for each hold, matched between clocks by their values; and the table of a pose set, one row
for each phase in which the machine is at rest, with the median of every signal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.chunked import Array, Rows
from sysid.datasets.recipe import StillPhases
from sysid.errors import InputError
from sysid.signals import split_signal

#: Samples further apart than this many periods belong to different bursts.
BURST_PERIODS = 3.0
#: Required share of matched holds, and rank correlation of their values.
MIN_MATCHED, MIN_CORRELATION = 0.7, 0.9


@dataclass(frozen=True)
class Match:
    """``t_machine = t + offset`` near ``mid_time``, known to ± ``half_width`` [s]; ``refused``: why there is none."""

    offset: float = float("nan")
    half_width: float = float("nan")
    mid_time: float = float("nan")
    matched: int = 0
    total: int = 0
    used: tuple[str, ...] = ()
    refused: str = ""


def bursts(times: Array) -> list[tuple[int, int]]:
    """Rows (first, last + 1) of each stretch without a gap."""
    if not len(times):
        return []
    steps = np.diff(times)
    breaks = np.flatnonzero(steps > BURST_PERIODS * float(np.median(steps))) + 1 if len(steps) else np.array([], dtype=int)
    edges = [0, *breaks.tolist(), len(times)]
    return list(pairwise(edges))


def match_bursts(machine: Sequence[Channel], other: Sequence[Channel], start_ns: int, other_start_ns: int) -> Match:
    """Match the holds of two logs by their start times, confirmed by the ranks of their values."""
    pairs = []
    for y in other:
        axis, quantity = split_signal(y.signal)
        for x in machine:
            if (
                split_signal(x.signal)[0] == axis
                and x.signal.endswith((".joint", ".cylinder"))
                and quantity in ("joint", "cylinder")
            ):
                pairs.append((x, y))
    if not pairs:
        return Match(refused="no joint or cylinder is measured on both clocks")
    holds = [(_holds(x, start_ns), _holds(y, other_start_ns), f"{x.signal}~{y.signal}") for x, y in pairs]
    (begin_x, _), (begin_y, _), _ = holds[0]
    if min(len(begin_x), len(begin_y)) < 5:
        return Match(refused=f"{min(len(begin_x), len(begin_y))} separate holds are too few to match")
    candidates = {round(float(a - b), 3) for a in begin_x[:12] for b in begin_y[:12]}
    best = max((_score(holds, candidate) for candidate in candidates), key=lambda scored: scored[0])
    correlation, offset, rows = best
    total = min(len(begin_x), len(begin_y))
    if len(rows) < MIN_MATCHED * total or correlation < MIN_CORRELATION:
        return Match(refused=f"{len(rows)} of {total} holds match at best (rank correlation {correlation:.2f})")
    used = tuple(sorted({name for _, _, pair in holds for name in pair.split("~")}))
    residual = begin_x[rows[:, 0]] - begin_y[rows[:, 1]]
    period = max(channel.period_s for channel in (pairs[0][0], pairs[0][1]))
    half = period + 2.0 * float(np.std(residual))
    return Match(offset, half, float(np.mean(begin_y[rows[:, 1]])), len(rows), total, used)


def _holds(channel: Channel, start_ns: int) -> tuple[Array, Array]:
    """Start of each hold [s], and the median measured in it."""
    times = seconds(channel.stamps, start_ns)
    rows = bursts(times)
    begin = np.array([times[first] for first, _ in rows])
    values = [channel.values[first:last] for first, last in rows]  # noqa: PD011
    return begin, np.array([float(np.median(v[~np.isnan(v)])) if np.isfinite(v).any() else np.nan for v in values])


def _score(holds: Sequence[tuple[tuple[Array, Array], tuple[Array, Array], str]], offset: float) -> tuple[float, float, Rows]:
    """Mean rank correlation, the offset refined to the matched holds, their rows (m, 2)."""
    (begin_x, _), (begin_y, _), _ = holds[0]
    tolerance = 0.25 * float(np.median(np.diff(begin_x)))
    nearest = np.clip(np.searchsorted(begin_x, begin_y + offset), 1, len(begin_x) - 1)
    nearest -= (begin_y + offset - begin_x[nearest - 1]) < (begin_x[nearest] - begin_y - offset)
    near = np.abs(begin_x[nearest] - begin_y - offset) < tolerance
    rows = np.column_stack([nearest[near], np.flatnonzero(near)])
    if len(rows) < 5:
        return 0.0, offset, rows
    correlations = []
    for (_, x), (_, y), _ in holds:
        if len(x) != len(begin_x) or len(y) != len(begin_y):
            continue
        a, b = x[rows[:, 0]], y[rows[:, 1]]
        known = ~np.isnan(a) & ~np.isnan(b)
        if np.count_nonzero(known) >= 5:
            correlations.append(abs(_rank_correlation(a[known], b[known])))
    if not correlations:
        return 0.0, offset, rows
    refined = float(np.median(begin_x[rows[:, 0]] - begin_y[rows[:, 1]]))
    return float(np.mean(correlations)), refined, rows


def _rank_correlation(a: Array, b: Array) -> float:
    ranks_a, ranks_b = np.argsort(np.argsort(a)), np.argsort(np.argsort(b))
    return float(np.corrcoef(ranks_a, ranks_b)[0, 1])


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


def _ranges(values: Array, first: Rows, last: Rows, times: Array, period: float) -> Array:
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
