"""Delay of the force of an axis with a flexible drive, with the load behind the spring in the regression.

Below its resonance the load adds the second derivative of the acceleration to the force, which the regression of
:func:`sysid.plant.force_delay.force_delay` contains, but only in a narrow band, where the delay is like viscous friction. With
the resonance known, the acceleration of the load follows from that of the motor, and the whole band determines the delay d:

    F = Jm·(a + d·ȧ) + Jl·(H·a + d·H·ȧ) + friction,     H as in :mod:`sysid.gap.drive_resonance`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.datasets.recording import Recording
from sysid.gap.drive_resonance import DriveResonance
from sysid.machine import Axis
from sysid.plant.force import ForceFilter, ForceInputs
from sysid.plant.force_delay import LARGEST_DEVIATION, RANGE, delay_estimate, fastest_speed, friction_terms, inputs_of

Array = npt.NDArray[np.float64]

#: Relative change of frequency and of damping ratio for the slopes of the load's acceleration.
STEP = 1e-3


def drive_delay(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter, drive: DriveResonance) -> float:
    """The delay [samples] with the drive in the regression; that of ``settings`` where the recordings do not determine it."""
    parts = inputs_of(recordings, axis, settings)
    if not parts:
        return settings.delay
    fastest = fastest_speed(parts)
    terms = [part.compared(np.hstack([_of_drive(part, drive), friction_terms(part.speed / fastest)])) for part in parts]
    force = [part.compared(part.raw[:, None])[:, 0] for part in parts]
    added, deviation = delay_estimate(parts, terms, force)
    delay = settings.delay + added
    return delay if deviation < LARGEST_DEVIATION and RANGE[0] < delay < RANGE[1] else settings.delay


def _of_drive(part: ForceInputs, drive: DriveResonance) -> Array:
    """Acceleration, jerk per sample of motor and load by their inertias, the load's acceleration, and its slopes, (n, 5)."""
    a, rate = part.acceleration, part.rate_hz
    f, damping = drive.antiresonance_hz, drive.damping_ratio
    load = load_acceleration(a, f, damping, rate)
    faster = load_acceleration(a, (1.0 + STEP) * f, damping, rate) - load
    damped = load_acceleration(a, f, (1.0 + STEP) * damping, rate) - load
    jerk = np.gradient(a) + drive.inertia_ratio * np.gradient(load)
    return np.column_stack([a, jerk, load, faster / STEP, damped / STEP])


def load_acceleration(acceleration: Array, frequency: float, damping_ratio: float, rate_hz: float) -> Array:
    """Acceleration of a load behind a spring for that of the motor (n,), which is linear between samples.

    The motor has the first acceleration before the first sample.
    """
    omega = 2.0 * np.pi * frequency
    oscillator = (np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping_ratio * omega]]), np.array([[0.0], [1.0]]),
                  np.array([[omega**2, 2.0 * damping_ratio * omega]]), np.zeros((1, 1)))  # fmt: skip
    discrete = signal.cont2discrete(oscillator, 1.0 / rate_hz, method="foh")[:4]
    numerator, denominator = signal.ss2tf(*discrete)
    begin = signal.lfilter_zi(numerator[0], denominator) * acceleration[0]
    return np.asarray(signal.lfilter(numerator[0], denominator, acceleration, zi=begin)[0])
