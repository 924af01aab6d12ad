"""Bandwidth of the force comparison of an axis, from its recordings: up to where the measured motion determines the force.

The multiple coherence of the force with acceleration and direction is the share of its power that a linear system
with these inputs can explain, whatever its dynamics are (Bendat and Piersol, Random Data (2010), §7.3). The band ends

- where the coherence, averaged over an octave, falls below one half: there noise has as much power as the force of the motion,
- where the noise of the position sensor is a tenth of its spectrum: there the differentiated noise biases an inertia,
- or where it contains nearly all of the coherent power: what lies above it is negligible.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from sysid.datasets.recording import Recording
from sysid.machine import Axis
from sysid.plant.force import LEAST_HZ, POSITION_RATIO, ForceFilter, Motion, highest_force_hz, measured_motion

Array = npt.NDArray[np.float64]
Spectra = npt.NDArray[np.complex128]

#: Length of the segments over which spectra are averaged [s], and the least number of them in the longest recording.
SEGMENT, SEGMENTS = 1.0, 4
#: Least length of a segment [samples]: a shorter one has hardly a frequency at which a position is noise.
LEAST_LENGTH = 8
#: Least share of the force that the motion explains, and least ratio of position to its noise, in power.
COHERENCE, SIGNAL_TO_NOISE = 0.5, 10.0
#: Share of the coherent power that the band contains.
POWER = 0.99
#: Share of the sample rate above which the spectrum of a position is noise.
NOISE_FROM = 0.35


def force_filter(recordings: Sequence[Recording], axis: Axis) -> ForceFilter:
    """The filter of the force comparison for these recordings.

    Its force band is at least :data:`sysid.plant.force.LEAST_HZ`, and at most what the sample rate allows.
    """
    default = ForceFilter()
    motions = [motion for r in recordings if (motion := measured_motion(r, axis)) is not None]
    if not motions:
        return default
    rate = motions[0].rate_hz
    found = band([m for m in motions if m.rate_hz == rate])
    force_hz = min(max(found, LEAST_HZ), highest_force_hz(rate))
    return replace(default, force_hz=force_hz, position_hz=max(default.position_hz, POSITION_RATIO * force_hz))


def band(motions: Sequence[Motion]) -> float:
    """Upper end of the band [Hz] of recordings with one sample rate; zero where they are too short, or too slow, to tell."""
    rate = motions[0].rate_hz
    length = round(min(SEGMENT * rate, max(len(m.force) for m in motions) / SEGMENTS))
    if length < LEAST_LENGTH:
        return 0.0
    segments = np.concatenate([fourier_segments(np.column_stack([*_inputs(m), m.force]), length) for m in motions])
    inputs = segments.shape[2] - 1
    if len(segments) <= 2 * inputs:
        return 0.0
    frequency: Array = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    coherent, power = _coherent_power(segments)
    of_position, noise = _position_and_noise(motions, length)
    explained = octave_sums(frequency, coherent) >= COHERENCE * octave_sums(frequency, power)
    clear = octave_sums(frequency, of_position) >= (SIGNAL_TO_NOISE + 1.0) * noise * octave_sums(
        frequency, np.ones(len(frequency))
    )
    end = _end(frequency, explained & clear)
    content = np.cumsum(np.maximum(coherent[: end + 1], 0.0))
    return float(frequency[np.searchsorted(content, POWER * content[-1])])


def motion_of(motion: Motion) -> tuple[Array, Array]:
    """Position and speed without the highest frequencies, which are noise, (n,) each."""
    position = scipy.signal.sosfiltfilt(_low_pass(motion.rate_hz), motion.position)
    return position, np.gradient(position, 1.0 / motion.rate_hz)


def acceleration_noise(motions: Sequence[Motion], length: int) -> Array:
    """Power of the noise of second differences of :func:`motion_of` in segments of ``length`` samples, (frequencies,).

    From the highest frequencies of the measured positions, which contain noise alone.
    """
    frequency, rate = np.fft.rfftfreq(length), motions[0].rate_hz
    gain = np.abs(scipy.signal.sosfreqz(_low_pass(rate), 2.0 * np.pi * frequency)[1]) ** 2
    return _position_and_noise(motions, length)[1] * np.asarray((2.0 * np.sin(np.pi * frequency)) ** 4 * gain**2 * rate**4)


def _low_pass(rate_hz: float) -> Array:
    return np.asarray(scipy.signal.butter(4, 0.4 * rate_hz, fs=rate_hz, output="sos"))


def _position_and_noise(motions: Sequence[Motion], length: int) -> tuple[Array, float]:
    """Power of the positions (frequencies,) and of their white noise, each summed over segments of ``length`` samples."""
    rate = motions[0].rate_hz
    of_position = np.sum([_position_power(m, length) for m in motions], axis=0)
    return of_position, float(np.median(of_position[np.fft.rfftfreq(length, 1.0 / rate) > NOISE_FROM * rate]))


def _inputs(motion: Motion) -> tuple[Array, Array]:
    """Acceleration, of which the speed is a linear function, and direction."""
    speed = motion_of(motion)[1]
    return np.gradient(speed, 1.0 / motion.rate_hz), np.sign(speed)


def fourier_segments(columns: Array, length: int) -> Spectra:
    """Fourier transforms of windowed, half overlapping segments of columns (n, k), (segments, frequencies, k)."""
    starts = range(0, len(columns) - length + 1, max(1, length // 2))
    window = scipy.signal.windows.hann(length)[:, None]
    parts = [
        np.fft.rfft(scipy.signal.detrend(columns[k : k + length], axis=0, type="constant") * window, axis=0) for k in starts
    ]
    return np.array(parts, dtype=np.complex128).reshape(len(parts), length // 2 + 1, columns.shape[1])


def _coherent_power(segments: Spectra) -> tuple[Array, Array]:
    """Power of the last column that the others explain, and its whole power, (frequencies,).

    The share that q inputs explain of an independent force is on average q over the number of independent segments, which is
    corrected; half overlapping Hann windows count 0.55 each (Welch 1967).
    """
    spectra = np.einsum("sfi,sfj->fij", segments, segments.conj())
    inputs = spectra.shape[1] - 1
    among, cross, power = spectra[:, :inputs, :inputs], spectra[:, :inputs, inputs], spectra[:, inputs, inputs].real
    size = np.sqrt(np.maximum(np.einsum("fii->fi", among).real, 1e-300))
    among = among / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(inputs)
    cross = cross / size
    explained = np.einsum("fi,fi->f", cross.conj(), np.linalg.solve(among, cross[:, :, None])[:, :, 0]).real
    count = 0.55 * len(segments) + 0.45
    return power - (power - explained) * count / max(count - inputs, 1.0), power


def _position_power(motion: Motion, length: int) -> Array:
    """Power of a position, (frequencies,), in which white noise is flat, from its second differences (against leakage)."""
    segments = fourier_segments(np.diff(motion.position, 2)[:, None], length)
    frequency = np.fft.rfftfreq(length)
    return np.asarray(
        np.sum(np.abs(segments[:, :, 0]) ** 2, axis=0) / np.maximum((2.0 * np.sin(np.pi * frequency)) ** 4, 1e-12)
    )


def _end(frequency: Array, determined: npt.NDArray[np.bool_]) -> int:
    """Index of the last frequency before an octave in which the force is not determined; an antiresonance is narrower."""
    good = np.flatnonzero(determined[1:]) + 1
    for before, after in itertools.pairwise(good):
        if frequency[after] > 2.0 * frequency[before]:
            return int(before)
    return int(good[-1]) if len(good) else 0


def octave_sums(frequency: Array, power: Array) -> Array:
    """Power in the octave around each frequency, (frequencies,)."""
    total = np.concatenate([[0.0], np.cumsum(np.maximum(power, 0.0))])
    low = np.searchsorted(frequency, frequency / np.sqrt(2.0))
    high = np.searchsorted(frequency, frequency * np.sqrt(2.0), side="right")
    return np.asarray(total[high] - total[low])
