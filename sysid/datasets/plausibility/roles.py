"""Axes that do not move in the recordings of a role: nothing can be identified, selected or tested there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sysid.datasets.plausibility.finding import Evidence, Finding, listed
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.recording import Recording, Role
from sysid.machine import Axis, Machine
from sysid.signals import axis_signal

#: Least travel of a motion: share of the axis's travel in all recordings, share of its stroke or limits, and standard
#: deviations of the noise.
TRAVEL, WIDTH, NOISES = 0.02, 0.005, 10.0
WORDS: Mapping[Role, str] = {"fit": "fit", "select": "selection", "held_out": "test (held out)"}
_NOISE_ROWS = 2**15


def role_findings(recordings: Sequence[Recording], machine: Machine, splits: Mapping[str, Role]) -> Iterator[Finding]:
    """A notice for each axis that does not move in one of the roles, or in no recording."""
    motion = [r for r in recordings if r.kind == "motion" and r.name in splits]
    roles = {role: [r for r in motion if splits[r.name] == role] for role in WORDS}
    roles = {role: chosen for role, chosen in roles.items() if chosen}
    for axis in machine.axes:
        travels = {role: max((_travel(r, axis) for r in chosen), default=0.0) for role, chosen in roles.items()}
        if not travels or not any(_measured(r, axis) for r in motion):
            continue
        largest = max(travels.values())
        still = [WORDS[role] for role, travel in travels.items() if travel <= TRAVEL * largest]
        if len(still) == len(travels):
            found = f"axis {axis.name} moves in no recording"
        elif still:
            found = f"axis {axis.name} does not move in the recordings of {listed(still)}"
        else:
            continue
        yield Finding((f"{axis.name}:still",), "notice", (Evidence(found, "motion in fit, selection and test"),))


def _measured(recording: Recording, axis: Axis) -> bool:
    return any(not np.isnan(recording.values(signal)).all() for signal in _signals(axis))


def _signals(axis: Axis) -> tuple[str, ...]:
    return tuple(dict.fromkeys((axis.driven, axis_signal(axis.name, "joint"))))


def _travel(recording: Recording, axis: Axis) -> float:
    """Travel of the axis [SI]; 0 where it is noise alone."""
    for signal in _signals(axis):
        values = recording.values(signal)
        if np.isnan(values).all():
            continue
        travel = float(np.nanmax(values) - np.nanmin(values))
        low, high = axis.range if signal == axis.driven else axis.limits or (-math.inf, math.inf)
        least = WIDTH * (high - low) if math.isfinite(high - low) else 0.0
        return travel if travel > max(least, NOISES * table_noise(values[:_NOISE_ROWS], recording.rate_hz)) else 0.0
    return 0.0
