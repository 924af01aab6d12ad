"""Excitation programs: band-limited Fourier series, moves between postures, chirps, multisines and steps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def fourier(
    draw: np.random.Generator, time: Array, low: Array, high: Array, base_hz: float, harmonics: int, fastest: Array
) -> tuple[Array, Array, Array]:
    """Periodic trajectories q, q̇, q̈, each (n, axes): finite Fourier series within limits (Swevers et al., IEEE TRA 13 (1997)).

    Args:
        low, high: limits of each axis [rad].
        fastest: largest speed of each axis [rad/s].
    """
    axes = len(low)
    w = 2.0 * math.pi * base_hz * np.arange(1, harmonics + 1)
    # Amplitudes of the speed are alike over the harmonics, so that no harmonic dominates the acceleration.
    a = draw.normal(size=(axes, harmonics)) / w
    b = draw.normal(size=(axes, harmonics)) / w
    s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
    q = s @ a.T - c @ b.T
    v = (c * w) @ a.T + (s * w) @ b.T
    acc = (-s * w**2) @ a.T + (c * w**2) @ b.T
    lowest, highest = q.min(axis=0), q.max(axis=0)
    scale = np.minimum((high - low) / (highest - lowest), fastest / np.abs(v).max(axis=0))
    room = (high - low) - scale * (highest - lowest)
    centre = low + draw.uniform(0.0, 1.0, axes) * room - scale * lowest
    return scale * q + centre, scale * v, scale * acc


def moves(draw: np.random.Generator, time: Array, low: Array, high: Array, speed: Array) -> Array:
    """Setpoints (n, axes): each axis moves at its own times with constant speed to a new place, or steps there, and waits."""
    found = np.empty((len(time), len(low)))
    for k in range(len(low)):
        at, place = 0.0, draw.uniform(low[k], high[k])
        knots, places = [0.0], [place]
        while at < time[-1]:
            at += draw.uniform(0.6, 2.0)
            knots.append(at)
            places.append(place)
            place = draw.uniform(low[k], high[k])
            at += 1e-3 if draw.random() < 0.2 else abs(place - places[-1]) / (speed[k] * draw.uniform(0.3, 1.0))
            knots.append(at)
            places.append(place)
        found[:, k] = np.interp(time, knots, places)
    return found


def chirp(time: Array, first_hz: float, last_hz: float) -> Array:
    """Sine of constant amplitude whose frequency rises exponentially from first to last, (n,)."""
    span = time[-1] - time[0]
    rate = math.log(last_hz / first_hz) / span
    return np.asarray(np.sin(2.0 * math.pi * first_hz / rate * (np.exp(rate * (time - time[0])) - 1.0)))


def multisine(draw: np.random.Generator, time: Array, first_hz: float, last_hz: float, lines: int) -> Array:
    """Sum of ``lines`` sines at log-spaced frequencies with random phases, of unit peak, (n,)."""
    frequency = np.geomspace(first_hz, last_hz, lines)
    phase = draw.uniform(0.0, 2.0 * math.pi, lines)
    found = np.sin(2.0 * math.pi * np.outer(time, frequency) + phase).sum(axis=1)
    return np.asarray(found / np.abs(found).max())


def steps(draw: np.random.Generator, time: Array, shortest: float, longest: float) -> Array:
    """Piecewise constant levels in [−1, 1], (n,)."""
    found = np.empty(len(time))
    at = float(time[0])
    while at < time[-1]:
        length = draw.uniform(shortest, longest)
        found[(time >= at) & (time < at + length)] = draw.uniform(-1.0, 1.0)
        at += length
    found[-1] = found[-2]
    return found
