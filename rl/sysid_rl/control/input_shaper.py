"""Input shaping: a setpoint is split into delayed parts whose vibrations cancel each other.

A shaper is a sequence of impulses with amplitudes A_i, which sum to one, at times t_i; the shaped signal is
``Σ A_i·r(t − t_i)``. For a mode of natural frequency ω and damping ratio ζ, with ω_d = ω√(1 − ζ²), it leaves this share of the
vibration after a single impulse::

    V(ω, ζ) = e^(−ζω·t_n)·√((Σ A_i·e^(ζω·t_i)·cos ω_d·t_i)² + (Σ A_i·e^(ζω·t_i)·sin ω_d·t_i)²)

ZV (zero vibration) makes V = 0 at the design frequency with two impulses, half a period apart. ZVD makes dV/dω = 0 there as
well with three, and takes half a period longer. All amplitudes are positive: a shaped setpoint stays within bounds and top
speeds of the unshaped one.

Source: Singer and Seering, Journal of Dynamic Systems, Measurement, and Control 112 (1990) 76–82; Smith (1957) for ZV.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError, nearest

Array = npt.NDArray[np.float64]
ShaperKind = Literal["zv", "zvd"]
SHAPERS: tuple[ShaperKind, ...] = get_args(ShaperKind)


@dataclass(frozen=True)
class InputShaper:
    """An impulse sequence.

    Args:
        times: of the impulses, ascending from zero, (k,) [s].
        amplitudes: positive, with sum one, (k,).
    """

    times: tuple[float, ...]
    amplitudes: tuple[float, ...]

    @property
    def delay(self) -> float:
        """Mean delay of the shaped signal [s]: a slow motion is late by this time."""
        return float(np.dot(self.times, self.amplitudes))

    def residual(self, frequency: float, damping_ratio: float) -> float:
        """Residual vibration V of a mode with natural frequency [rad/s] and damping ratio, as a share of the unshaped one."""
        times, amplitudes = np.array(self.times), np.array(self.amplitudes)
        decay, turn = damping_ratio * frequency, frequency * math.sqrt(1.0 - damping_ratio**2)
        return float(abs(np.sum(amplitudes * np.exp((decay + 1j * turn) * times))) * math.exp(-decay * times[-1]))

    def taps(self, rate_hz: float) -> Array:
        """Weights of the present and past samples, (m,); an impulse between two samples is divided between them linearly.

        The division adds at most ``(ω/rate)²/8`` to V.
        """
        out = np.zeros(math.floor(self.times[-1] * rate_hz) + 2)
        for time, amplitude in zip(self.times, self.amplitudes, strict=True):
            whole = math.floor(time * rate_hz)
            part = time * rate_hz - whole
            out[whole] += (1.0 - part) * amplitude
            out[whole + 1] += part * amplitude
        return out


def input_shaper(kind: ShaperKind, frequency: float, damping_ratio: float) -> InputShaper:
    """The shaper ``zv`` or ``zvd`` for a mode with natural frequency [rad/s] and damping ratio.

    Raises:
        SettingsError: another kind, a frequency that is not positive, a damping ratio outside [0, 1).
    """
    if kind not in SHAPERS:
        raise SettingsError("input shaper", repr(kind), nearest(kind, SHAPERS))
    if not (math.isfinite(frequency) and frequency > 0.0):
        raise SettingsError("input shaper", f"frequency = {frequency} rad/s", "above zero")
    if not 0.0 <= damping_ratio < 1.0:
        raise SettingsError("input shaper", f"damping_ratio = {damping_ratio}", "0 to below 1")
    root = math.sqrt(1.0 - damping_ratio**2)
    half = math.pi / (frequency * root)
    decay = math.exp(-damping_ratio * math.pi / root)
    weights = (1.0, decay) if kind == "zv" else (1.0, 2.0 * decay, decay * decay)
    return InputShaper(tuple(half * k for k in range(len(weights))), tuple(weight / sum(weights) for weight in weights))


class ShapedSetpoints:
    """A shaper that is applied a sample at a time, to ``copies`` of a machine.

    Args:
        rate_hz: samples per second.
        width: setpoints of a copy.
    """

    def __init__(self, shaper: InputShaper, rate_hz: float, width: int, copies: int = 1) -> None:
        self.shaper = shaper
        self._taps = shaper.taps(rate_hz)
        self._past = np.full((len(self._taps), copies, width), np.nan)

    def reset(self, setpoints: npt.ArrayLike) -> None:
        """Rest at ``setpoints``, (A,) or (n, A)."""
        self._past[:] = np.asarray(setpoints, dtype=np.float64)

    def step(self, setpoints: npt.ArrayLike) -> Array:
        """Shaped setpoints (n, A) after the next ``setpoints`` (n, A).

        Raises:
            InputError: it was never reset.
        """
        if np.isnan(self._past).any():
            raise InputError("input shaper", "was never reset, or got a value that is not finite", "reset(setpoints) at rest")
        self._past[1:] = self._past[:-1]
        self._past[0] = setpoints
        return np.asarray(np.tensordot(self._taps, self._past, axes=1))

    def state(self) -> dict[str, Any]:
        """Past setpoints."""
        return {"past": self._past.copy()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a :meth:`state`, exactly."""
        self._past[:] = state["past"]
