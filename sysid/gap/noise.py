"""Noise of each measured signal: from the data sheet in the machine description, else from the data.

From the data, it is the larger of the white noise (:func:`sysid.datasets.quality.noise.white_noise`) and the error of rounding
to the steps of the sensor. An estimate is accepted if it is a plausible share of the range of motion; where the motion is too
fast for the rate, or only static poses contain the signal, the best bound is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.quality.noise import is_still, noise_bound, white_noise
from sysid.datasets.recording import Dataset, Recording
from sysid.datasets.roles.needs import is_pose_set
from sysid.gap.sensor_resolution import reading_step, rounding
from sysid.gap.statement import FloorSource
from sysid.machine import Machine
from sysid.signals import axis_signal, split_signal

Array = npt.NDArray[np.float64]

#: Largest plausible noise, as a share of the range of motion (larger values are motion); least range of motion, as a share of
#: that of the axis (a smaller range may be noise).
PLAUSIBLE, UNMOVED = 0.01, 0.02
#: Largest plausible noise of a speed, which is noisier than a position, as a share of its range.
PLAUSIBLE_SPEED = 0.1
#: Assumed noise as a share of the range: at static poses without repeats, and of a signal without scatter (a simulation, or an
#: axis at rest).
OF_POSES, OF_NO_SCATTER = 1e-3, 1e-6
#: Static poses are repeats if all other signals agree to this share of their range; least number of repeats for an estimate.
SAME_POSE, REPEATS = 1e-3, 5


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the noise of a signal [SI], and how it is known."""

    level: float
    source: FloorSource


def noise_levels(dataset: Dataset) -> dict[str, float]:
    """Signal → standard deviation of its noise, see :func:`noise_of_signals`."""
    return {signal: noise.level for signal, noise in noise_of_signals(dataset).items()}


def noise_of_signals(dataset: Dataset) -> dict[str, Noise]:
    """The noise of every measured signal; a command has none unless the data sheet says so (a force).

    Without a data sheet: what ingest found in the sensor's own samples, else in the recordings' tables.
    """
    sheet = dataset.machine.noise
    signals = sorted({s for r in dataset.recordings for s in r.signals})
    measured = [s for s in signals if s in sheet or split_signal(s)[1] != "command"]
    return {s: Noise(sheet[s], "stated") if s in sheet else _from_data(dataset, s) for s in measured}


def _from_data(dataset: Dataset, signal: str) -> Noise:
    recordings = [r for r in dataset.recordings if signal in r.signals]
    moving = [r for r in recordings if r.kind == "motion"]
    span = max((_range(r.values(signal)) for r in recordings), default=0.0)
    limits = _limits(dataset.machine, signal)
    plausible = (PLAUSIBLE_SPEED if split_signal(signal)[1] == "speed" else PLAUSIBLE) * span
    most = plausible if span > UNMOVED * limits or limits == 0.0 else math.inf
    found = _of_samples(dataset, signal, moving or recordings, most if moving else plausible)
    if found is None:
        resting = is_pose_set(dataset) and split_signal(signal)[1] == "joint"
        found = _of_tables(moving, signal, most) if moving else _of_poses(recordings, signal, span, resting)
    step = rounding(reading_step([r.values(signal) for r in moving]))
    if found.level < step:
        found = Noise(step, "above_bandwidth")
    return replace(found, level=max(found.level, OF_NO_SCATTER * max(span, limits), 1e-12))


def _of_samples(dataset: Dataset, signal: str, recordings: list[Recording], most: float) -> Noise | None:
    """Plausible estimates by ingest from the samples of the sensor; median of the recordings."""
    quality = dataset.quality.get("recordings", {})
    found = [quality.get(r.name, {}).get("signals", {}).get(signal, {}).get("noise") for r in recordings]
    levels = [v for v in found if v is not None and math.isfinite(v) and 0.0 < v <= most]
    return Noise(float(np.median(levels)), "above_bandwidth") if levels else None


def _of_tables(moving: list[Recording], signal: str, most: float) -> Noise:
    """White noise in tables of motion, else its bound, at most a plausible share of the range."""
    parts = [(r.values(signal), r.rate_hz) for r in moving if not is_still(r.values(signal))]
    levels = [level for values, rate in parts if math.isfinite(level := white_noise(values, rate)) and level <= most]
    if levels:
        return Noise(float(np.median(levels)), "above_bandwidth")
    bounds = [bound for values, _ in parts if math.isfinite(bound := noise_bound(values))]
    return Noise(min(float(np.median(bounds)), most) if bounds else 0.0, "unknown")


def _of_poses(recordings: list[Recording], signal: str, span: float, resting: bool) -> Noise:
    """Scatter among static poses that are repeats in all other signals; without repeats an assumed share of the range.

    ``resting``: a joint of which only poses are known; the scatter of its sensor at rest is left to that of the tip, as an
    assumed one would hide every effect of a wrist.
    """
    differences: list[Array] = []
    for recording in recordings:
        others = [name for name in recording.signals if name != signal and split_signal(name)[1] != "command"]
        if len(recording) < 2 or not others:
            continue
        table = np.column_stack([recording.values(name) for name in others])
        ranges = np.nanmax(table, axis=0, initial=-np.inf) - np.nanmin(table, axis=0, initial=np.inf)
        first, second = np.triu_indices(len(recording), 1)
        same = (np.abs(table[first] - table[second]) <= SAME_POSE * ranges).all(axis=1)
        values = recording.values(signal)
        differences.append((values[first] - values[second])[same])
    found = np.concatenate([*differences, np.empty(0)])
    found = found[~np.isnan(found)]
    if len(found) >= REPEATS:
        return Noise(float(np.sqrt(np.mean(found**2) / 2.0)), "rest")
    return Noise(0.0 if resting else OF_POSES * span, "unknown")


def _range(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(np.ptp(known)) if len(known) else 0.0


def _limits(machine: Machine, signal: str) -> float:
    """Range of the axis of a signal [SI]; zero if unknown, for points and for speeds."""
    owner, quantity = split_signal(signal)
    if owner not in machine.axis_names or quantity == "speed":
        return 0.0
    axis = machine.axis(owner)
    ends = axis.limits if signal == axis_signal(owner, "joint") else axis.range
    return float(ends[1] - ends[0]) if ends is not None and np.isfinite(ends).all() else 0.0
