"""Pictures of a gap result as SVG, which notebooks show and files keep."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.display import quantity, shown_unit, with_unit
from sysid.errors import SettingsError, nearest
from sysid.pictures import PictureCurve, svg

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sysid.gap import GapResult
    from sysid.gap.result import Gap, Traces

MEASURED, BEFORE, AFTER = "#30363c", "#d9822b", "#1a7f64"


@dataclass(frozen=True)
class Drawing:
    """A picture; ``svg`` is its text."""

    svg: str

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it to a file ``.svg``."""
        Path(path).write_text(self.svg, "utf-8")
        return Path(path)

    def _repr_svg_(self) -> str:
        return self.svg

    def __repr__(self) -> str:
        return f"Drawing({len(self.svg)} characters of SVG)"


def by_error(gap: Gap) -> list[str]:
    """Signals by their held-out error before the repair, in noise floors; the largest first."""
    return sorted(gap.before, key=lambda name: -gap.before[name] / max(gap.noise_floor[name], 1e-300))


def worst_signal(result: GapResult) -> str:
    """The signal with the largest held-out error that can be drawn.

    Raises:
        SettingsError: the result has no run of a held-out recording.
    """
    drawable = set(_shared(result.traces[0])) if result.traces else set()
    signals = [name for name in by_error(result.gap) if name in drawable]
    if not signals:
        raise SettingsError(f"plot of {result.dataset}", "no runs of held-out recordings", "a result with them")
    return signals[0]


def _shared(trace: Traces) -> list[str]:
    return sorted(set(trace.measured.columns) & set(trace.before.columns) - {"time"})


def drawn_traces(result: GapResult, signal: str, recording: str | None, units: Mapping[str, str]) -> Drawing:
    """A held-out recording: measured, before and after the repair."""
    names = [trace.recording for trace in result.traces]
    recording = recording or (names[0] if names else "")
    if recording not in names:
        raise SettingsError(f"plot of {result.dataset}", f"no held-out recording {recording!r}", nearest(recording, names))
    trace = result.traces[names.index(recording)]
    if signal not in _shared(trace):
        raise SettingsError(f"plot of {result.dataset}", f"no signal {signal!r}", nearest(signal, _shared(trace)))
    factor, _ = shown_unit(units.get(signal))
    time = trace.measured["time"].to_numpy() - trace.measured["time"].iloc[0]
    tables = {"simulated before": (trace.before, BEFORE), "measured": (trace.measured, MEASURED)}
    tables |= {"simulated after": (trace.after, AFTER)} if result.repaired else {}
    curves = [
        PictureCurve(label, time, factor * table[signal].to_numpy(), colour, dashed=table is trace.after)
        for label, (table, colour) in tables.items()
    ]
    gap = result.gap
    before, after, floor = (
        quantity(figures.get(signal, np.nan), units.get(signal, "1")) for figures in (gap.before, gap.after, gap.noise_floor)
    )
    errors = f"RMS {before} → {after}; noise {floor}" if result.repaired else f"RMS {before}; noise {floor}"
    title = f"{signal} of {recording}: {errors}"
    return Drawing(svg(title, f"time [s] of {recording} · {errors}", with_unit(signal, units.get(signal)), curves))


def drawn_map(result: GapResult, signal: str, over: str) -> Drawing:
    """The mean error of a stage over a variable, before and after the repair."""
    own = sorted((item for item in result.maps if item.signal == signal), key=lambda item: item.explains)
    maps = {item.over: item for item in own}  # of several stages, that of which it explains most
    if over not in maps:
        raise SettingsError(f"plot of {result.dataset}", f"no error map of {signal} over {over!r}", nearest(over, maps))
    item = maps[over]
    factor, x_factor = shown_unit(item.error_unit)[0], shown_unit(item.unit)[0]
    at = x_factor * np.array(item.at)
    curves = [PictureCurve("before", at, factor * np.array(item.mean), BEFORE)]
    if item.after:
        curves.append(PictureCurve("after", at, factor * np.array(item.after), AFTER, dashed=True))
    label = with_unit(f"{item.quantity} of {signal}", item.error_unit)
    return Drawing(svg(f"{label} over {over}", with_unit(over, item.unit), label, curves))
