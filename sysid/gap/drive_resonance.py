"""Resonance of a drive in the response of force to acceleration: a load behind a spring.

At measured motion of the motor, a motor with inertia Jm and a load Jl behind a spring and damper need the force

    F = (Jm + Jl·H(s))·a + B·v + K·x,     H(s) = (2ζω·s + ω²)/(s² + 2ζω·s + ω²),

so that the motor hardly moves at ω (antiresonance), and most easily at ω·√(1 + Jl/Jm) (resonance). Both follow from the
averaged spectra of force and acceleration, beside the direction of motion (dry friction). K is the slope of a weight or of a
spring to the frame, which would otherwise look like a load behind a soft spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from sysid.datasets.recording import Recording
from sysid.gap.thresholds import PRICE
from sysid.machine import Axis
from sysid.plant.force import ForceFilter, delayed, measured_motion
from sysid.plant.force_band import COHERENCE, acceleration_noise, fourier_segments, motion_of, octave_sums
from sysid.plant.smooth_motion import second_difference

Array = npt.NDArray[np.float64]
Spectra = npt.NDArray[np.complex128]

#: Length of the segments [s], which resolves a resonance, and the least number of them in the longest recording.
SEGMENT, SEGMENTS = 4.0, 4
#: Lowest frequency of the response and of a resonance [Hz].
FROM, LOWEST = 1.0, 2.0
#: Least share of the measured power of the acceleration that is not noise.
CLEAR = 0.5
#: Start values: number of frequencies, and damping ratios.
FREQUENCIES, DAMPINGS = 120, (0.01, 0.03, 0.1)
#: Least and largest damping ratio of a resonance.
LEAST_DAMPED, DAMPED = 1e-3, 0.4


@dataclass(frozen=True)
class DriveResonance:
    """Antiresonance and resonance [Hz], damping ratio of the antiresonance, and inertia of the load over that of the motor."""

    antiresonance_hz: float
    resonance_hz: float
    damping_ratio: float
    inertia_ratio: float

    @property
    def parameters(self) -> dict[str, float]:
        """As parameters of the effect ``flexible_drive``."""
        return {
            "frequency": self.antiresonance_hz,
            "damping_ratio": self.damping_ratio,
            "inertia_ratio": self.inertia_ratio,
        }

    def __str__(self) -> str:
        return (
            f"the force responds to motion like a load of {self.inertia_ratio:.2f} times the motor's inertia behind a spring: "
            f"antiresonance at {self.antiresonance_hz:.1f} Hz, resonance at {self.resonance_hz:.1f} Hz"
        )


@dataclass(frozen=True)
class _Response:
    """Force per acceleration (f,) at circular frequencies ``w``, and its inverse standard deviation up to a factor."""

    w: Array
    values: Spectra
    weight: Array

    def fit(self, columns: Sequence[Spectra]) -> tuple[Array, float]:
        """Real coefficients of the columns, and the weighted sum of squares that they leave."""
        X = np.column_stack(columns) * self.weight[:, None]
        y = self.values * self.weight
        stacked, target = np.vstack([X.real, X.imag]), np.concatenate([y.real, y.imag])
        beta = np.linalg.lstsq(stacked, target, rcond=None)[0]
        return beta, float(np.sum((target - stacked @ beta) ** 2))

    def rigid(self) -> list[Spectra]:
        """Columns of an inertia, of viscous friction and of a spring to the frame."""
        powers = [(1j * self.w) ** -k for k in range(3)]
        return [column.astype(np.complex128) for column in powers]

    def flexible(self, frequency: float, damping: float) -> list[Spectra]:
        """The same, and the column of a load behind a spring."""
        omega = 2.0 * np.pi * frequency
        spring = 2j * damping * omega * self.w + omega**2
        return [*self.rigid(), spring / (spring - self.w**2)]


def drive_resonance(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter) -> DriveResonance | None:
    """The resonance within the band of the force comparison; None where a rigid drive explains the response about as well.

    It has to divide the squared error of a rigid drive with viscous friction by the price of an effect.
    """
    response = _response(recordings, axis, settings)
    if response is None:
        return None
    rigid = response.fit(response.rigid())[1]
    grid = [(f, z) for f in np.geomspace(LOWEST, settings.force_hz, FREQUENCIES) for z in DAMPINGS]
    start = min(grid, key=lambda pair: response.fit(response.flexible(*pair))[1])

    def left_at(x: Array) -> float:
        return response.fit(response.flexible(float(np.exp(x[0])), float(np.exp(x[1]))))[1]

    found = minimize(left_at, np.log(start), method="Nelder-Mead", options={"xatol": 1e-4})
    frequency, damping = float(np.exp(found.x[0])), max(float(np.exp(found.x[1])), LEAST_DAMPED)
    (motor, _, _, load), left = response.fit(response.flexible(frequency, damping))
    if not (motor > 0.0 and load > 0.0 and damping < DAMPED and LOWEST < frequency < settings.force_hz):
        return None
    if rigid < PRICE * left:
        return None
    return DriveResonance(frequency, float(frequency * np.sqrt(1.0 + load / motor)), damping, float(load / motor))


def _response(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter) -> _Response | None:
    """Force per acceleration beside the direction of motion; None where the recordings are too short or too noisy.

    At frequencies that the force does not excite, all of the acceleration follows from dry friction, and what remains beside
    the direction of motion is noise: force per acceleration would be zero there, as at an antiresonance.
    """
    motions = [motion for r in recordings if (motion := measured_motion(r, axis)) is not None]
    if not motions:
        return None
    rate = motions[0].rate_hz
    motions = [motion for motion in motions if motion.rate_hz == rate]
    length = round(min(SEGMENT * rate, max(len(motion.force) for motion in motions) / SEGMENTS))
    parts = []
    for motion in motions:
        position, speed = motion_of(motion)
        columns = [second_difference(position) * rate**2, np.sign(speed), delayed(motion.force, settings.delay)]
        parts.append(fourier_segments(np.column_stack(columns), length))
    segments = np.concatenate(parts)
    frequency: Array = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    if len(segments) < SEGMENTS:
        return None
    s = np.einsum("sfi,sfj->fij", segments, segments.conj())
    direction = np.maximum(s[:, 1, 1].real, 1e-300)
    measured = np.maximum(s[:, 0, 0].real - np.abs(s[:, 0, 1]) ** 2 / direction, 1e-300)
    acceleration = measured - acceleration_noise(motions, length)
    cross = s[:, 2, 0] - s[:, 2, 1] * s[:, 1, 0] / direction
    force = np.maximum(s[:, 2, 2].real - np.abs(s[:, 2, 1]) ** 2 / direction, 1e-300)
    band = (frequency >= FROM) & (frequency <= settings.force_hz)
    band &= (np.abs(cross) ** 2 > COHERENCE * measured * force) & (acceleration > CLEAR * measured)
    if band.sum() < 2 * SEGMENTS:
        return None
    noise = octave_sums(frequency, force - np.abs(cross) ** 2 / measured)
    noise /= np.maximum(octave_sums(frequency, np.ones(len(frequency))), 1.0)
    weight = acceleration / np.sqrt(measured * np.maximum(noise, 1e-9 * float(noise.max()) + 1e-300))
    return _Response(2.0 * np.pi * frequency[band], cross[band] / acceleration[band], weight[band])
