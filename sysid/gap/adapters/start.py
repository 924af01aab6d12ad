"""Position and speed of a joint at the first row of a recording, for the start of a simulation.

A joint is in motion if the slope of its first :data:`FIRST` seconds is certain. Its position and speed are then those of a
parabola through the first :data:`WINDOW` seconds; both times are longer where samples are few. Otherwise it is at rest, at the
median of the first 0.2 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.adapters.simulator import starting_value

Array = npt.NDArray[np.float64]

#: Time in which a motion has to show [s], time of the parabola [s], and least numbers of samples in both.
FIRST, WINDOW, SAMPLES = 0.06, 0.12, (5, 8)
#: Longest time of the parabola [s]: a joint with fewer samples starts at rest.
LONGEST = 0.2
#: Standard deviations by which a slope differs from zero.
CERTAIN = 6.0


@dataclass(frozen=True)
class JointStart:
    """``position`` [rad or m] and ``speed`` [rad/s or m/s] at the first row."""

    position: float
    speed: float


def joint_start(recording: Recording, signal: str, default: float = 0.0) -> JointStart:
    """The start of a joint from its sensor; ``default`` position where it is not measured."""
    values = recording.values(signal)
    there = np.flatnonzero(~np.isnan(values))
    time = there / recording.rate_hz
    first, whole = (max(int(np.sum(time < most)), least) for most, least in zip((FIRST, WINDOW), SAMPLES, strict=True))
    if len(time) < whole or time[whole - 1] > LONGEST:
        return JointStart(starting_value(recording, signal, default), 0.0)
    (_, slope), deviation = _polynomial(time[:first], values[there[:first]], 1)
    found, deviations = _polynomial(time[:whole], values[there[:whole]], 2)
    moves = abs(slope) > CERTAIN * deviation[1] and abs(found[1]) > CERTAIN * deviations[1] and found[1] * slope > 0.0
    if not moves:
        return JointStart(starting_value(recording, signal, default), 0.0)
    return JointStart(float(found[0]), float(found[1]))


def _polynomial(time: Array, values: Array, degree: int) -> tuple[Array, Array]:
    """Coefficients of a polynomial from the constant on, and their standard deviations by the scatter about it."""
    powers = np.vander(time, degree + 1, increasing=True)
    found: Array = np.asarray(np.linalg.lstsq(powers, values, rcond=None)[0], dtype=np.float64)
    freedom = max(len(time) - degree - 1, 1)
    variance = float(np.sum((values - powers @ found) ** 2)) / freedom
    return found, np.asarray(np.sqrt(variance * np.diag(np.linalg.inv(powers.T @ powers))), dtype=np.float64)
