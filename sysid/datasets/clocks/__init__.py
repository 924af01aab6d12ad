"""Alignment of the clocks of devices with the machine's, from motion that both measure, with intervals, also over resets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClockRecord:
    """``t_machine = t_stream · (1 + 1e-6 · skew_ppm) + offset_s``, t counted from the stream's first stamp.

    t_machine counts from the start of the uncut recording (its first sample on the machine's clock), so
    ``stamp_machine = start_ns + 1e9·t_machine`` and ``t_stream = (stamp − stream_start_ns)·1e-9``. ``applied`` is False where
    the offset is not observable, for the given ``reason``. ``interval95`` are (lo, hi). A constant latency of a sensor is part
    of the offset. ``residual_rms`` is the residual of the two motions in standard deviations of their noise: far above 1 the
    map is inadequate or the clock is not linear.
    """

    recording: str
    stream: str
    offset_s: float
    skew_ppm: float
    offset_interval95: tuple[float, float]
    skew_interval95: tuple[float, float]
    residual_rms: float
    used_signals: tuple[str, ...]
    applied: bool
    reason: str = ""
    stream_start_ns: int = 0
