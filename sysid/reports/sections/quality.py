"""What the recordings contain: length, completeness, range, clocks, files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from sysid.datasets.recording import ClockRecord, Dataset, Recording
from sysid.reports import display, words
from sysid.reports.inputs import ReportInputs

_ROLES = {"fit": "fit", "select": "selection", "held_out": "held out (proof)"}


def context(inputs: ReportInputs) -> dict[str, Any]:
    dataset = inputs.dataset
    return {
        "reference": dataset.reference,
        "recordings": [_recording(recording, dataset) for recording in dataset.recordings],
        "ranges": _ranges(dataset),
        "clocks": [_clock(clock) for clock in dataset.clocks],
        "sources": [
            {
                "path": s.path,
                "size": f"{display.number(s.size / 1e6)} MB",
                "sha256": s.sha256[:16],
                "losses": "; ".join(s.losses),
            }
            for s in dataset.sources
        ],
        "losses": sum(1 for source in dataset.sources if source.losses),
        "units": ", ".join(f"{name} [{unit}]" for name, unit in dataset.units.items()),
    }


def _recording(recording: Recording, dataset: Dataset) -> dict[str, Any]:
    poses = recording.kind == "poses"
    length = f"{len(recording)} poses" if poses else f"{display.number(len(recording) / recording.rate_hz)} s"
    missing = {s: float(np.mean(np.isnan(recording.values(s)))) for s in recording.signals}
    worst = max(missing, key=lambda s: missing[s], default="")
    return {
        "name": recording.name,
        "role": "static poses" if poses else _ROLES.get(dataset.splits.get(recording.name, ""), "not used"),
        "length": length,
        "signals": len(recording.signals),
        "complete": 1.0 - (sum(missing.values()) / len(missing) if missing else 0.0),
        "worst": f"{worst}: {display.percent(missing[worst])} missing" if worst and missing[worst] > 0.0 else "",
        "flags": _flags(dataset.quality, recording.name),
    }


def _flags(quality: Mapping[str, Any], name: str) -> list[str]:
    """What ingest noticed about a recording, wherever the summary keeps it."""
    entry = quality.get("recordings", quality).get(name, {})
    flags = entry.get("flags", ()) if isinstance(entry, Mapping) else ()
    if isinstance(flags, Mapping):
        return [f"{key.replace('_', ' ')}: {value}" for key, value in flags.items() if value]
    return [str(flag) for flag in flags]


def _ranges(dataset: Dataset) -> list[dict[str, Any]]:
    """The part of each axis' range that the motion recordings visit, in per cent of the range."""
    rows = []
    for axis in dataset.machine.axes:
        ends = axis.range
        if not math.isfinite(ends[0] + ends[1]):
            continue
        values = np.concatenate([recording.values(axis.driven) for recording in dataset.of_kind("motion")] or [np.empty(0)])
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        span = ends[1] - ends[0]
        low, high = float(values.min()), float(values.max())
        unit = dataset.units.get(axis.driven, "1")
        rows.append(
            {
                "name": words.signal_name(axis.driven),
                "left": round(100 * min(max((low - ends[0]) / span, 0.0), 1.0), 1),
                "width": round(100 * min(max((high - low) / span, 0.0), 1.0), 1),
                "seen": display.interval(low, high, unit),
                "range": display.interval(ends[0], ends[1], unit),
            }
        )
    return rows


def _clock(clock: ClockRecord) -> dict[str, Any]:
    half = 0.5 * (clock.offset_interval95[1] - clock.offset_interval95[0])
    skew = 0.5 * (clock.skew_interval95[1] - clock.skew_interval95[0])
    return {
        "recording": clock.recording,
        "stream": clock.stream,
        "offset": display.fixed(clock.offset_s, 6),
        "offset_error": display.fixed(1e3 * half, 3),
        "skew": display.fixed(clock.skew_ppm, 1),
        "skew_error": display.fixed(skew, 1),
        "signals": ", ".join(clock.used_signals),
        "applied": clock.applied,
        "reason": clock.reason,
    }
