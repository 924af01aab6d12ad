"""Residuals of aligned motions over time and over the motion, from the raw channels of a stored version.

A drifting clock, an undetected step or a latency that depends on speed shows over time; an inadequate map or a sticking sensor
shows over the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sysid.datasets.channel import stored_channels
from sysid.datasets.chunked import Array
from sysid.datasets.clocks.alignment import BLOCK_S, Estimate, pairs_of, with_backlash_found
from sysid.datasets.clocks.coarse import Pair
from sysid.datasets.clocks.estimate import summed_blocks
from sysid.datasets.clocks.measured_motion import moves, smoothed
from sysid.datasets.clocks.motion_fit import FitSums, PairFit, prepared
from sysid.datasets.recording import ClockRecord

#: Blocks with less than this share of the median block's weight are omitted.
LEAST_WEIGHT = 0.05
#: Bins over the motion.
BINS = 24


@dataclass(frozen=True)
class PairResidual:
    """Residual of one pair over its motion.

    Args:
        name: machine's signal ~ the other device's.
        motion: machine's signal at the middle of each bin (m,) [SI].
        mean, spread: of the residual there (m,) [SI of the other device's signal].
        noise: standard deviation of the residual [same].
    """

    name: str
    motion: Array
    mean: Array
    spread: Array
    noise: float


@dataclass(frozen=True)
class ClockResidual:
    """One clock record and the residuals in blocks of :data:`~sysid.datasets.clocks.alignment.BLOCK_S`.

    Args:
        times: of the blocks on the machine's clock (b,) [s].
        shift, error: offset estimated from a block alone minus that of the record, and its standard error (b,) [s].
        residual: root mean square of the residuals in standard deviations of their noise (b,).
    """

    record: ClockRecord
    times: Array
    shift: Array
    error: Array
    residual: Array
    pairs: tuple[PairResidual, ...]


def with_residuals(clocks: Sequence[ClockRecord]) -> tuple[str, ...]:
    """The recordings of the records that were estimated from motion."""
    return tuple(dict.fromkeys(record.recording for record in clocks if _estimated(record)))


def _estimated(record: ClockRecord) -> bool:
    return record.applied and bool(np.isfinite(record.residual_rms))


def clock_residuals(channels: pd.DataFrame, clocks: Sequence[ClockRecord]) -> tuple[ClockResidual, ...]:
    """The residual of every record that was estimated from motion.

    Args:
        channels: raw channels as :meth:`sysid.datasets.Store.channels` gives them, of the recordings :func:`with_residuals`.
        clocks: of the same version.
    """
    found = []
    for name in with_residuals(clocks):
        own = channels[channels["recording"] == name]
        for record in clocks:
            if record.recording == name and _estimated(record):
                later = [r.stream_start_ns for r in clocks if (r.recording, r.stream) == (name, record.stream)]
                end = min((ns for ns in later if ns > record.stream_start_ns), default=np.iinfo(np.int64).max)
                residual = _residual(own, record, end)
                if residual is not None:
                    found.append(residual)
    return tuple(found)


def _residual(channels: pd.DataFrame, record: ClockRecord, end_ns: int) -> ClockResidual | None:
    start = int(channels.loc[channels["domain"] == "machine", "stamp_ns"].min())
    machine = stored_channels(channels[(channels["domain"] == "machine") & channels["signal"].isin(record.used_signals)])
    stamps = channels["stamp_ns"]
    piece = (stamps >= record.stream_start_ns) & (stamps < end_ns)
    other = stored_channels(channels[piece & (channels["source"] == record.stream) & (channels["domain"] != "machine")])
    pairs = [
        pair
        for pair in pairs_of(machine, other, start, record.stream_start_ns)
        if set(pair.name.split("~")) <= set(record.used_signals) and moves(pair)
    ]
    skew = 1e-6 * record.skew_ppm
    middle = 0.5 * max((float(pair.y_times[-1]) for pair in pairs), default=0.0)
    near = Estimate(mid_time=middle, mid_offset=record.offset_s + skew * middle, skew=skew)
    sums, residuals = [], []
    for pair in with_backlash_found([smoothed(pair) for pair in pairs], near) if pairs else ():
        fit = PairFit(prepared(pair))
        fit.begin(record.offset_s, 1e-6 * record.skew_ppm, 0.0)
        own = fit.sums(record.offset_s, 1e-6 * record.skew_ppm, 0.0, BLOCK_S)
        if own is not None:
            sums.append(own)
            residuals.append(_over_motion(pair, fit, record))
    return _over_time(record, sums, residuals) if sums else None


def _over_time(record: ClockRecord, sums: Sequence[FitSums], pairs: Sequence[PairResidual]) -> ClockResidual:
    numbers, scores, weight, squares, _, counts = summed_blocks(sums)
    used = weight > LEAST_WEIGHT * float(np.median(weight))
    middle = np.asarray((numbers[used] + 0.5) * BLOCK_S, dtype=np.float64)
    times = middle * (1.0 + 1e-6 * record.skew_ppm) + record.offset_s
    size = np.sqrt(squares / counts)[used]
    return ClockResidual(record, times, scores[used, 0] / weight[used], np.sqrt(1.0 / weight[used]), size, tuple(pairs))


def _over_motion(pair: Pair, fit: PairFit, record: ClockRecord) -> PairResidual:
    x, residual = fit.residuals(record.offset_s, 1e-6 * record.skew_ppm, 0.0)
    edges = np.linspace(float(x.min()), float(x.max()), BINS + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    away = pd.Series(residual)
    counts, middle = away.groupby(place).size(), away.groupby(place).median()  # medians are robust against mistaken frames
    spread = 1.4826 * (away - middle[place].to_numpy()).abs().groupby(place).median()
    means, spreads = (np.asarray(own.where(counts >= 20).reindex(range(BINS)), np.float64) for own in (middle, spread))
    return PairResidual(pair.name, (edges[1:] + edges[:-1]) / 2.0, means, spreads, fit.scale)
