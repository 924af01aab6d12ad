"""Delay of the force of an axis against its motion, from its recordings.

A log does not say whether a row contains the force that is held from its sample on or one that was measured with the motion,
and whether it was logged before it acted. Half a sample looks like viscous friction: a force J·a(t + d) is J·a + d·J·ȧ, and
over a narrow band −ȧ is proportional to the speed. Over a wider band the two differ, so that a regression separates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from sysid.datasets.recording import Recording
from sysid.errors import ExcitationError
from sysid.machine import Axis
from sysid.plant.force import LEAST_HZ, ForceFilter, ForceInputs, force_inputs
from sysid.plant.smooth_motion import second_difference

Array = npt.NDArray[np.float64]

#: Bands in which the delay is estimated [Hz], the lowest first: below a resonance of the drive, whose damping would bias it.
BANDS = (0.5 * LEAST_HZ, LEAST_HZ)
#: Largest standard deviation of an accepted estimate, and its range [samples].
LARGEST_DEVIATION, RANGE = 0.15, (-0.25, 2.25)
#: Delays of a digital drive [samples], from which the smaller residual chooses otherwise: sampled with the motion, or held.
DELAYS = (0.0, 0.5)
#: Length of the blocks from whose scatter the standard deviation follows [s].
BLOCK = 5.0
#: Widths of smooth friction [share of the 95th percentile of the speed].
WIDTHS = (0.02, 0.07, 0.2)


def force_delay(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter) -> float:
    """How many samples the logged force is ahead of the force that acts on the measured motion.

    The estimate of the lowest band with a small standard deviation; else that of :data:`DELAYS` with the smaller residual of a
    fit by acceleration, speed in each direction, its sign and a constant. No effect is named from these fits.
    """
    for band in (*BANDS, settings.force_hz):
        delay, deviation = _regression(inputs_of(recordings, axis, replace(settings, force_hz=band)), band)
        if deviation < LARGEST_DEVIATION and RANGE[0] < delay < RANGE[1]:
            return delay
    left = [_left(inputs_of(recordings, axis, replace(settings, delay=delay))) for delay in DELAYS]
    return DELAYS[int(np.argmin(left))]


def inputs_of(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter) -> list[ForceInputs]:
    """The recordings that are long enough for the filter."""
    found = []
    for recording in recordings:
        try:
            found.append(force_inputs(recording, axis, settings))
        except ExcitationError:
            continue
    return found


def _regression(parts: Sequence[ForceInputs], band: float) -> tuple[float, float]:
    """Delay and its standard deviation [samples] from acceleration, jerk and friction of any shape.

    The second derivative of the acceleration is what a flexible drive adds below its resonance.
    """
    if not parts:
        return 0.0, np.inf
    fastest = fastest_speed(parts)
    return delay_estimate(parts, [_terms(part, fastest, band)[part.rows] for part in parts], [part.force for part in parts])


def delay_estimate(parts: Sequence[ForceInputs], terms: Sequence[Array], forces: Sequence[Array]) -> tuple[float, float]:
    """Ratio of the first two coefficients of a regression of the forces (m,) on ``terms`` (m, k): delay and its deviation.

    The first term is the acceleration and the second the jerk per sample. The standard deviation is the larger of those of
    independent rows and of independent blocks, which contain the errors of the other terms.
    """
    force, X = np.concatenate(forces), np.concatenate(terms)
    block = np.concatenate([1000 * k + _blocks(part) for k, part in enumerate(parts)])
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    X = X / size
    inverse = np.linalg.pinv(X.T @ X, rcond=1e-12, hermitian=True)
    beta = inverse @ X.T @ force
    left = force - X @ beta
    free = len(force) - X.shape[1]
    if free <= 0 or not beta[0] > 0.0:
        return 0.0, np.inf
    rows = inverse[1, 1] * float(left @ left) / free
    scores = np.array([X[block == k].T @ left[block == k] for k in np.unique(block)]) @ inverse[1]
    deviation = float(np.sqrt(max(rows, float(scores @ scores))))
    inertia = beta[0] / size[0]
    return float(beta[1] / size[1] / inertia), deviation / size[1] / inertia


def fastest_speed(parts: Sequence[ForceInputs]) -> float:
    """95th percentile of the speed of the fastest recording."""
    return max(float(np.percentile(np.abs(part.speed), 95)) for part in parts)


def friction_terms(speed: Array) -> Array:
    """Friction of any shape as functions of the relative speed (n,), and a constant, (n, k)."""
    parts = [np.ones_like(speed), np.maximum(speed, 0.0), np.minimum(speed, 0.0), speed * np.abs(speed), np.sign(speed)]
    return np.column_stack([*parts, *(np.tanh(speed / width) for width in WIDTHS)])


def _terms(part: ForceInputs, fastest: float, band: float) -> Array:
    """Acceleration, jerk per sample, second derivative of the acceleration, and functions of the speed, filtered, (n, k)."""
    a = part.acceleration
    snap = second_difference(a) * (part.rate_hz / (2.0 * np.pi * band)) ** 2
    columns = np.column_stack([a, np.gradient(a), snap, friction_terms(part.speed / fastest)])
    return np.asarray(scipy.signal.sosfiltfilt(part.low_pass, columns, axis=0))


def _blocks(part: ForceInputs) -> npt.NDArray[np.int64]:
    """Number of the block of each row."""
    return np.asarray(part.rows / part.rate_hz // BLOCK, dtype=np.int64)


def _left(parts: Sequence[ForceInputs]) -> float:
    """Sum of squares that the fits of the recordings leave."""
    total = 0.0
    for part in parts:
        v = part.speed
        terms = np.column_stack([part.acceleration, np.maximum(v, 0.0), np.minimum(v, 0.0), np.sign(v), np.ones_like(v)])
        terms = scipy.signal.sosfiltfilt(part.low_pass, terms, axis=0)[part.rows]
        total += float(np.sum((part.force - terms @ np.linalg.lstsq(terms, part.force, rcond=None)[0]) ** 2))
    return total
