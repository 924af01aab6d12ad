"""Basis functions of discrepancies, and the filters that they pass."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.datasets.recording import Recording
from sysid.effects import second_order_lag

Array = npt.NDArray[np.float64]

#: Centres and widths of the bumps over a command: narrow near zero, where valves differ most from their formula.
CENTRES = np.array([-1.0, -0.75, -0.5, -0.35, -0.22, -0.12, -0.05, 0.05, 0.12, 0.22, 0.35, 0.5, 0.75, 1.0])
WIDTHS = np.array([0.25, 0.25, 0.2, 0.14, 0.11, 0.08, 0.05, 0.05, 0.08, 0.11, 0.14, 0.2, 0.25, 0.25])
#: A command is off zero beyond this.
SMALL = 0.02


def bumps(u: Array, centres: Array = CENTRES, widths: Array = WIDTHS, small: float = SMALL) -> Array:
    """Gaussian bumps over ``u`` (n,) that vanish at zero, (n, 14)."""
    return np.asarray(np.exp(-0.5 * ((u[:, None] - centres) / widths) ** 2) * np.tanh(np.abs(u[:, None]) / small))


def waves(x: Array, numbers: tuple[float, ...]) -> Array:
    """Sines and cosines of ``x`` (n,) at each wave number, (n, 2k)."""
    phase = np.outer(x, numbers)
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def slow_cosines(time: npt.NDArray[np.floating], count: int = 3) -> Array:
    """Half cosines over a recording and a slope a minute, (n, count + 1)."""
    span = max(float(time[-1] - time[0]), 1e-9) if len(time) else 1.0
    phase = np.pi * np.outer((time - time[:1]) / span, np.arange(1, count + 1))
    return np.column_stack([np.cos(phase), time / 60.0])


def low_pass(x: Array, time_constant: float, dt: float) -> Array:
    """First-order lag of ``x`` (n, …) along time, begun at its first value."""
    if time_constant <= 0.0 or not len(x):
        return x
    e = float(np.exp(-dt / time_constant))
    start = signal.lfilter_zi([1.0 - e], [1.0, -e])
    begin = start.reshape((1,) + (1,) * (x.ndim - 1)) * x[:1]
    out, _ = signal.lfilter([1.0 - e], [1.0, -e], x, axis=0, zi=begin)
    return np.asarray(out)


def second_order(x: Array, time_constant: float, damping_ratio: float, dt: float) -> Array:
    """Second-order lag of ``x`` (n,), begun at rest at its first value (:mod:`sysid.effects.second_order_lag`)."""
    if time_constant < second_order_lag.ABSENT or not len(x):
        return x
    fast = np.array([1.0]), np.array([time_constant**2, 2.0 * damping_ratio * time_constant, 1.0])
    numerator, denominator, _ = signal.cont2discrete(fast, dt)
    start = signal.lfilter_zi(numerator[0], denominator)
    return np.asarray(signal.lfilter(numerator[0], denominator, x, zi=start * x[0])[0])


def delayed(x: Array, delay: float, dt: float) -> Array:
    """``x`` (n,) delayed by ``delay`` [s], linear between samples; the first value before that."""
    rows = np.arange(len(x))
    return np.asarray(np.interp(rows - delay / dt, rows, x))


def filled(values: Array) -> Array:
    """``values`` (n,) with gaps interpolated linearly and ends held; zeros if all are missing."""
    there = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), there, values[there]) if len(there) else np.zeros(len(values))


def smooth(values: Array, samples: int) -> Array:
    """Moving average over an odd number of samples, gaps interpolated."""
    half = max(1, samples // 2)
    padded = np.pad(filled(values), half, mode="edge")
    return np.asarray(np.convolve(padded, np.ones(2 * half + 1) / (2 * half + 1), mode="valid"))


def slope(values: Array, dt: float) -> Array:
    """Derivative of a measured signal, smoothed over 0.1 s."""
    if len(values) < 3:
        return np.zeros(len(values))
    return np.asarray(np.gradient(smooth(values, round(0.1 / dt)), dt))


def span_of(recordings: tuple[Recording, ...], name: str) -> tuple[float, float]:
    """Middle and half of the visited range of a signal; a half range of one if it does not move."""
    found = [r.values(name) for r in recordings]
    joined = np.concatenate(found) if found else np.empty(0)
    joined = joined[~np.isnan(joined)]
    if not len(joined) or np.ptp(joined) <= 0.0:
        return 0.0, 1.0
    return 0.5 * float(joined.max() + joined.min()), 0.5 * float(np.ptp(joined))
