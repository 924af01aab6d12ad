"""Notch at the antiresonance of a drive: there the noise of the motion counts no more than elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from force_axis import MASS, acting, linear_motion, machine, multisine, recording
from scipy import signal

from sysid.gap.drive_delay import load_acceleration
from sysid.gap.drive_notch import drive_notch
from sysid.gap.drive_resonance import DriveResonance
from sysid.plant.force import ForceFilter, force_inputs
from sysid.plant.notch import Notch

Array = npt.NDArray[np.float64]
RATE, HZ = 1000.0, 15.0


def band_power(error: Array) -> float:
    """Within a fifth of the antiresonance."""
    frequency, power = signal.welch(error, RATE, nperseg=4000)
    return float(np.sum(power[np.abs(frequency / HZ - 1.0) < 0.2]))


def resonance(damping: float, ratio: float) -> DriveResonance:
    return DriveResonance(HZ, HZ * np.sqrt(1.0 + ratio), damping, ratio)


def test_a_notch_has_its_gain_at_its_frequency_and_none_elsewhere() -> None:
    sections = Notch(HZ, 0.02, 0.1).section(RATE)
    gain = np.abs(signal.sosfreqz(sections, worN=[0.0, 1.0, HZ, 100.0], fs=RATE)[1])
    assert gain == pytest.approx([1.0, 1.0, 0.2, 1.0], abs=0.01)


@pytest.mark.parametrize("damping", [0.01, 0.03, 0.06])
@pytest.mark.parametrize("ratio", [0.4, 1.5, 3.0])
def test_amplified_noise_is_level_behind_it(damping: float, ratio: float) -> None:
    notch = drive_notch(resonance(damping, ratio))
    assert notch is not None
    frequency = np.linspace(0.3 * HZ, 3.0 * HZ, 2000)
    s = 1j * frequency / HZ
    load = (2.0 * damping * s + 1.0) / (s**2 + 2.0 * damping * s + 1.0)
    amplified = np.abs((1.0 + ratio * load) / (1.0 + ratio))
    behind = amplified * np.abs(signal.sosfreqz(notch.section(RATE), worN=frequency, fs=RATE)[1]) ** 2
    assert amplified.max() > 0.9 * ratio / (2.0 * damping * (1.0 + ratio))
    assert behind.max() < 1.8
    assert behind[np.argmax(amplified)] == pytest.approx(1.0, abs=0.3)


def test_a_damped_drive_needs_none() -> None:
    assert drive_notch(resonance(0.3, 0.5)) is None


def test_noise_of_the_position_is_not_amplified_behind_it() -> None:
    """Around the antiresonance: what the true drive leaves, beside the same noise times the whole inertia."""
    load, omega, noise = 0.6 * MASS, 2.0 * np.pi * HZ, 1e-6
    ratio, damping = load / (MASS - load), 0.03
    force = multisine(25.0, 40.0)
    position = linear_motion(force, RATE, load * omega**2, load, damping=2.0 * damping * omega * load)
    clean, noisy = (recording(acting(force, position, RATE), position, noise=(0.0, size)) for size in (0.0, noise))
    left = {}
    plain = ForceFilter(position_hz=125.0, force_hz=40.0)
    for settings in (plain, replace(plain, notch=drive_notch(resonance(damping, ratio)))):
        parts = [force_inputs(each, machine(RATE).axis("x"), settings) for each in (clean, noisy)]
        error = parts[1].acceleration - parts[0].acceleration
        flexible = (MASS - load) * error + load * load_acceleration(error, HZ, damping, RATE)
        behind, around = signal.sosfiltfilt(parts[0].low_pass, flexible), signal.sosfiltfilt(plain.sections(RATE), MASS * error)
        left[settings.notch is None] = band_power(behind) / band_power(around)
    assert left[True] > 10.0
    assert left[False] < 1.5
