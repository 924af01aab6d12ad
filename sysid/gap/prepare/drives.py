"""Drives with a load behind a spring: its resonance in their response, and the delay of a force beside it.

At measured motion of the motor, a motor with inertia Jm and a load Jl behind a spring and damper need the force

    F = (Jm + Jl·H(s))·a + B·v + K·x,     H(s) = (2ζω·s + ω²)/(s² + 2ζω·s + ω²),

so that the motor hardly moves at ω (antiresonance), and most easily at ω·√(1 + Jl/Jm) (resonance). Both follow from the
averaged spectra of force and acceleration, beside the direction of motion (dry friction). K is the slope of a weight or of a
spring to the frame, which would otherwise look like a load behind a soft spring.

Below its resonance the load adds the second derivative of the acceleration to the force, which the regression of
:func:`sysid.plant.force_delay.force_delay` contains, but only in a narrow band, where the delay is like viscous friction. With
the resonance known, the acceleration of the load follows from that of the motor, and the whole band determines the delay d:

    F = Jm·(a + d·ȧ) + Jl·(H·a + d·H·ȧ) + friction.

Of a speed-commanded drive, the load follows the speed v as ω²/(s² + 2ζω·s + ω²)·v. A free run fits this narrow peak only from a
frequency close by, which the response of the measured speed to the one that the plant predicts shows: it is compared with a
gain, a delay and a lag, which bend it without a peak.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy import signal
from scipy.optimize import Bounds, minimize

from sysid.datasets.recording import Recording
from sysid.effects import flexible_drive, oil_compressibility
from sysid.gap.problem import Problem
from sysid.gap.thresholds import PRICE
from sysid.machine import Axis
from sysid.plant.force import ForceFilter, ForceInputs, delayed, highest_force_hz, measured_motion
from sysid.plant.force_band import COHERENCE, acceleration_noise, fourier_segments, motion_of, octave_sums
from sysid.plant.force_delay import LARGEST_DEVIATION, RANGE, delay_estimate, fastest_speed, friction_terms, inputs_of
from sysid.plant.smooth_motion import second_difference

Array = npt.NDArray[np.float64]
Spectra = npt.NDArray[np.complex128]

#: Length of the segments [s], which resolves a resonance, and the least number of them in the longest recording.
SEGMENT, SEGMENTS = 4.0, 4
#: Lowest frequency of a response, and of an antiresonance [Hz].
FROM, LOWEST = 1.0, 2.0
#: Least share of the measured power of the acceleration that is not noise.
CLEAR = 0.5
#: Start values: number of frequencies, and damping ratios.
FREQUENCIES, DAMPINGS = 120, (0.01, 0.03, 0.1)
#: Least and largest damping ratio of a resonance.
LEAST_DAMPED, DAMPED = 1e-3, 0.4
#: Start values of delay and lag of a response without a peak [s].
DELAYS = ((0.0, 0.0), (0.005, 0.002))
#: Relative change of frequency and of damping ratio for the slopes of the load's acceleration.
STEP = 1e-3


@dataclass(frozen=True)
class DriveResonance:
    """Antiresonance and resonance [Hz], damping ratio of the antiresonance, and inertia of the load over that of the motor."""

    effect: ClassVar[str] = flexible_drive.EFFECT.name
    antiresonance_hz: float
    resonance_hz: float
    damping_ratio: float
    inertia_ratio: float

    @property
    def parameters(self) -> dict[str, float]:
        """As parameters of the effect."""
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
class SpeedResonance:
    """Natural frequency [Hz] and damping ratio of the load on its spring."""

    effect: ClassVar[str] = oil_compressibility.EFFECT.name
    frequency: float
    damping_ratio: float

    @property
    def parameters(self) -> dict[str, float]:
        """As parameters of the effect."""
        return {"frequency": self.frequency, "damping_ratio": self.damping_ratio}


@dataclass(frozen=True)
class _Response:
    """Output over input (f,) at circular frequencies ``w``, and its inverse standard deviation up to a factor."""

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

    def left(self, shape: Spectra) -> float:
        """Weighted sum of squares beside the best gain of ``shape``; as by ``fit``, in a fraction of its time."""
        product = float(np.sum(self.weight**2 * (self.values * shape.conj()).real))
        gain = product / max(float(np.sum((self.weight * np.abs(shape)) ** 2)), 1e-300)
        return float(np.sum((self.weight * np.abs(self.values - gain * shape)) ** 2))

    def rigid(self) -> list[Spectra]:
        """Columns of an inertia, of viscous friction and of a spring to the frame."""
        return [np.asarray((1j * self.w) ** -k, dtype=np.complex128) for k in range(3)]

    def flexible(self, frequency: float, damping: float) -> list[Spectra]:
        """The same, and the column of a load behind a spring."""
        omega = 2.0 * np.pi * frequency
        spring = 2j * damping * omega * self.w + omega**2
        return [*self.rigid(), spring / (spring - self.w**2)]

    def peak(self, frequency: float, damping: float) -> Spectra:
        """Speed of a load behind a spring over that of its drive."""
        omega = 2.0 * np.pi * frequency
        return np.asarray(omega**2 / (omega**2 - self.w**2 + 2j * damping * omega * self.w), dtype=np.complex128)

    def late(self, delay: float, lag: float) -> Spectra:
        """Response of a delay and a first-order lag [s]."""
        return np.asarray(np.exp(-1j * self.w * delay) / (1.0 + 1j * self.w * abs(lag)), dtype=np.complex128)


def _start(left: Callable[[float, float], float], low: float, high: float) -> Array:
    """Logarithms of the frequency between two ends [Hz] and the damping ratio that leave least."""
    grid = [(f, z) for f in np.geomspace(low, high, FREQUENCIES) for z in DAMPINGS]
    return np.log(min(grid, key=lambda pair: left(*pair)))


def _octave_mean(frequency: Array, noise: Array) -> Array:
    """Power of the noise, averaged over the octave around each frequency, (f,); at least a billionth of the largest."""
    mean = octave_sums(frequency, noise) / np.maximum(octave_sums(frequency, np.ones(len(frequency))), 1.0)
    return np.maximum(mean, 1e-9 * float(mean.max()) + 1e-300)


def drive_resonance(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter) -> DriveResonance | None:
    """The resonance within the band of the force comparison; None where a rigid drive explains the response about as well.

    It has to divide the squared error of a rigid drive with viscous friction by the price of an effect.
    """
    response = _force_response(recordings, axis, settings)
    if response is None:
        return None

    def left(frequency: float, damping: float) -> float:
        return response.fit(response.flexible(frequency, damping))[1]

    def left_at(x: Array) -> float:
        return left(*np.exp(x))

    start = _start(left, LOWEST, settings.force_hz)
    found = minimize(left_at, start, method="Nelder-Mead", options={"xatol": 1e-4})
    frequency, damping = float(np.exp(found.x[0])), max(float(np.exp(found.x[1])), LEAST_DAMPED)
    (motor, _, _, load), flexible = response.fit(response.flexible(frequency, damping))
    if not (motor > 0.0 and load > 0.0 and damping < DAMPED and LOWEST < frequency < settings.force_hz):
        return None
    if response.fit(response.rigid())[1] < PRICE * flexible:
        return None
    return DriveResonance(frequency, float(frequency * np.sqrt(1.0 + load / motor)), damping, float(load / motor))


def _force_response(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter) -> _Response | None:
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
    if len(segments) < SEGMENTS:
        return None
    s = np.einsum("sfi,sfj->fij", segments, segments.conj())
    direction = np.maximum(s[:, 1, 1].real, 1e-300)
    measured = np.maximum(s[:, 0, 0].real - np.abs(s[:, 0, 1]) ** 2 / direction, 1e-300)
    acceleration = measured - acceleration_noise(motions, length)
    cross = s[:, 2, 0] - s[:, 2, 1] * s[:, 1, 0] / direction
    force = np.maximum(s[:, 2, 2].real - np.abs(s[:, 2, 1]) ** 2 / direction, 1e-300)
    frequency: Array = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    band = (frequency >= FROM) & (frequency <= settings.force_hz)
    band &= (np.abs(cross) ** 2 > COHERENCE * measured * force) & (acceleration > CLEAR * measured)
    if band.sum() < 2 * SEGMENTS:
        return None
    weight = acceleration / np.sqrt(measured * _octave_mean(frequency, force - np.abs(cross) ** 2 / measured))
    return _Response(2.0 * np.pi * frequency[band], cross[band] / acceleration[band], weight[band])


def drive_delay(recordings: Sequence[Recording], axis: Axis, settings: ForceFilter, drive: DriveResonance) -> float:
    """The delay of the force [samples] with the drive in the regression.

    That of ``settings`` where the recordings do not determine it.
    """
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


def speed_resonance(problem: Problem, recordings: Sequence[Recording], theta: Array) -> SpeedResonance | None:
    """The resonance of a command stage; None where a delay and a lag explain the response about as well.

    It has to divide the squared error that these leave by the price of an effect, and to be above the start values of its
    effect, which reach the lower ones.
    """
    least_hz = max(oil_compressibility.EFFECT.forms[0].parameters[0].starts)
    motions = [r for r in recordings if r.kind == "motion"]
    if not motions or (highest := highest_force_hz(motions[0].rate_hz)) <= least_hz:
        return None
    response = _speed_response(problem, [r for r in motions if r.rate_hz == motions[0].rate_hz], theta)
    if response is None:
        return None

    def left(x: Array) -> float:
        return response.left(response.peak(*np.exp(x[:2])) * response.late(*x[2:]))

    def left_without(x: Array) -> float:
        return response.left(response.late(*x))

    start = [*_start(lambda f, z: response.left(response.peak(f, z)), FROM, highest), 0.0, 0.0]
    # Without a peak the error falls forever towards one that is far away or flat.
    low = np.array([np.log(FROM / 10.0), np.log(LEAST_DAMPED / 10.0), -np.inf, -np.inf])
    high = np.array([np.log(10.0 * highest), np.log(100.0), np.inf, np.inf])
    found = minimize(left, start, method="Nelder-Mead", bounds=Bounds(low, high), options={"maxiter": 1000})
    frequency, damping = float(np.exp(found.x[0])), max(float(np.exp(found.x[1])), LEAST_DAMPED)
    smooth = min(float(minimize(left_without, first, method="Nelder-Mead").fun) for first in DELAYS)
    if not (least_hz < frequency < highest and damping < DAMPED) or smooth < PRICE * found.fun:
        return None
    return SpeedResonance(frequency, damping)


def _speed_response(problem: Problem, recordings: Sequence[Recording], theta: Array) -> _Response | None:
    """Measured over predicted speed; None where the recordings are too short or interrupted."""
    rate = recordings[0].rate_hz
    length = round(min(SEGMENT * rate, max(len(r) for r in recordings) / SEGMENTS))
    parts = []
    for recording in recordings:
        pair = np.column_stack([problem.predict(theta[None], recording)[0][:, 0], problem.measured(recording)[:, 0]])
        if len(pair) > length and not np.isnan(pair).any():
            parts.append(fourier_segments(np.diff(pair, axis=0), length))
    if not parts:
        return None
    segments = np.concatenate(parts)
    frequency: Array = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    band = (frequency >= FROM) & (frequency <= highest_force_hz(rate))
    if len(segments) < SEGMENTS or band.sum() < 2 * SEGMENTS:
        return None
    predicted = np.maximum((np.abs(segments[:, :, 0]) ** 2).sum(axis=0), 1e-300)
    cross = (segments[:, :, 1] * segments[:, :, 0].conj()).sum(axis=0)
    noise = (np.abs(segments[:, :, 1]) ** 2).sum(axis=0) - np.abs(cross) ** 2 / predicted
    weight = np.sqrt(predicted / _octave_mean(frequency, noise))
    return _Response(2.0 * np.pi * frequency[band], (cross / predicted)[band], weight[band])
