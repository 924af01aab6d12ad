"""Excitation and noise of a dataset in numbers, computed from its tables for every version."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sysid.datasets.quality import coverage, repeats, use
from sysid.datasets.quality.coverage import PairMap, Rest, Span, noise_at_rest, pair_maps, postures, rests_of, spans_of
from sysid.datasets.quality.noise import noise_of
from sysid.datasets.quality.repeats import Repeat, repeats_of
from sysid.datasets.quality.use import AxisUse, Scale, pairs_together, scales_of, together, use_of
from sysid.datasets.recording import Dataset, Recording
from sysid.signals import split_signal


@dataclass(frozen=True)
class RecordingEvidence:
    """One recording.

    Args:
        seconds: its length; ``poses``: number of static poses.
        axes: use of each; empty for poses.
        together_s: pair of axes → seconds in which both are commanded.
        covered: pair of axes → share of the cells of their ranges that this recording visits.
        rests: its still phases.
    """

    name: str
    role: str
    seconds: float
    poses: int
    axes: Mapping[str, AxisUse]
    together_s: Mapping[tuple[str, str], float]
    covered: Mapping[tuple[str, str], float]
    rests: tuple[Rest, ...]


@dataclass(frozen=True)
class Noise:
    """Standard deviation of a sensor [SI]; None where it is unknown.

    Args:
        sheet: of the machine description.
        moving: scatter of its own samples about a smooth motion, without noise slower than 0.2 s.
        still: scatter in still phases, in the aligned tables; a suspended tool may still swing.
        repeats: difference between recordings of the same commands: noise and disturbances of the machine.
    """

    sheet: float | None
    moving: float | None
    still: float | None
    repeats: float | None


@dataclass(frozen=True)
class DatasetEvidence:
    """Evidence of each recording and of the dataset.

    Args:
        scales: axis → full command and top speed.
        axes, together_s: sums over all recordings of motion.
        spans: range of each axis and its measured part; ``maps``: of each pair of axes.
        postures: the longest still phase of each distinct posture.
    """

    recordings: tuple[RecordingEvidence, ...]
    scales: Mapping[str, Scale]
    axes: Mapping[str, AxisUse]
    together_s: Mapping[tuple[str, str], float]
    spans: tuple[Span, ...]
    maps: tuple[PairMap, ...]
    postures: tuple[Rest, ...]
    noise: Mapping[str, Noise]
    repeats: tuple[Repeat, ...]

    def to_json(self) -> dict[str, Any]:
        """JSON values; pairs of axes are ``first+second``, ``thresholds`` those of the counts."""
        return {
            "schema": 1,
            "recordings": {r.name: _recording_json(r) for r in self.recordings},
            "axes": {name: {**asdict(use), **asdict(self.scales[name])} for name, use in self.axes.items()},
            "together_s": _pairs(self.together_s),
            "ranges": {span.axis: _span_json(span) for span in self.spans},
            "coverage": {
                f"{m.first.axis}+{m.second.axis}": {
                    "covered": m.covered,
                    "covered_moving": m.covered_moving,
                    "seconds": m.seconds,
                    "poses": m.poses,
                }
                for m in self.maps
            },
            "postures": [{**asdict(rest), "seconds": rest.seconds} for rest in self.postures],
            "noise": {signal: asdict(noise) for signal, noise in self.noise.items()},
            "repeats": [asdict(repeat) for repeat in self.repeats],
            "thresholds": THRESHOLDS,
        }


#: Thresholds of the counts; their reasons are in docs/guide/quality.md.
THRESHOLDS: Mapping[str, Any] = {
    "idle_command": use.IDLE,
    "small_command": list(use.SMALL),
    "slow_motion": list(use.SLOW),
    "reversal": use.TURN,
    "reversal_noise": use.TURN_NOISE,
    "speed_over_s": use.SLOPE_S,
    "command_cells": use.CELLS,
    "joint_cells": coverage.GRID,
    "cell_visited_s": use.VISITED_S,
    "still_from_s": coverage.LEAST_S,
    "posture_apart": coverage.APART,
    "repeats_alike": repeats.ALIKE,
    "repeats_overlap": repeats.OVERLAP,
}


def evidence_of(dataset: Dataset) -> DatasetEvidence:
    """Evidence of ``dataset``."""
    recordings, machine = dataset.recordings, dataset.machine
    scales, spans = scales_of(recordings, machine), spans_of(recordings, machine)
    single = tuple(_recording(r, dataset, spans, scales) for r in recordings)
    moving = [r for r in single if r.axes]
    rests = [phase for r in single for phase in r.rests]
    pairs = dict.fromkeys(pair for r in moving for pair in r.together_s)
    again = repeats_of(recordings, scales)
    return DatasetEvidence(
        recordings=single,
        scales=scales,
        axes={name: together([r.axes[name] for r in moving]) for name in scales} if moving else {},
        together_s={pair: sum(r.together_s[pair] for r in moving) for pair in pairs},
        spans=spans,
        maps=pair_maps(recordings, spans),
        postures=postures(rests, spans),
        noise=_noise(dataset, rests, again),
        repeats=again,
    )


def _recording(
    recording: Recording, dataset: Dataset, spans: tuple[Span, ...], scales: Mapping[str, Scale]
) -> RecordingEvidence:
    still = recording.kind == "poses"
    return RecordingEvidence(
        name=recording.name,
        role=dataset.splits.get(recording.name, ""),
        seconds=0.0 if still else len(recording) / recording.rate_hz,
        poses=len(recording) if still else 0,
        axes={} if still else {name: use_of(recording, dataset.machine.axis(name), scale) for name, scale in scales.items()},
        together_s={} if still else pairs_together(recording, scales),
        covered={(m.first.axis, m.second.axis): m.covered for m in pair_maps([recording], spans)},
        rests=() if still else tuple(rests_of(recording, dataset.machine, spans, scales)),
    )


def _noise(dataset: Dataset, rests: list[Rest], again: tuple[Repeat, ...]) -> dict[str, Noise]:
    by_name = {r.name: r for r in dataset.recordings}
    signals = [s for s in dataset.machine.signals if any(s in r.signals for r in dataset.recordings)]
    found = {}
    for signal in signals:
        if split_signal(signal)[1] == "command":
            continue
        levels = [repeat.spread[signal] for repeat in again if signal in repeat.spread]
        found[signal] = Noise(
            sheet=dataset.machine.noise.get(signal),
            moving=_moving_noise(dataset, signal),
            still=noise_at_rest(by_name, rests, signal),
            repeats=float(np.median(levels)) if levels else None,
        )
    return found


def _moving_noise(dataset: Dataset, signal: str) -> float | None:
    """From the sensor's raw samples as stored by ingest, else from the tables."""
    stored = dataset.quality.get("recordings", {})
    levels = [stored.get(r.name, {}).get("signals", {}).get(signal, {}).get("noise") for r in dataset.recordings]
    known = [level for level in levels if level is not None and np.isfinite(level)]
    if not known:
        known = [noise_of(r.values(signal), r.rate_hz) for r in dataset.of_kind("motion")]
        known = [level for level in known if np.isfinite(level)]
    return float(np.median(known)) if known else None


def _span_json(span: Span) -> dict[str, Any]:
    return {**asdict(span), "covered": span.covered, "covered_moving": span.covered_moving}


def _recording_json(recording: RecordingEvidence) -> dict[str, Any]:
    return {
        "role": recording.role,
        "seconds": recording.seconds,
        "poses": recording.poses,
        "axes": {name: asdict(use) for name, use in recording.axes.items()},
        "together_s": _pairs(recording.together_s),
        "covered": _pairs(recording.covered),
        "rests": [{"from_s": r.from_s, "to_s": r.to_s, "posture": dict(r.posture)} for r in recording.rests],
    }


def _pairs(values: Mapping[tuple[str, str], float]) -> dict[str, float]:
    return {f"{first}+{second}": value for (first, second), value in values.items()}
