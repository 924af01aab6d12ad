"""One direction of an actuator network with history as it runs: a correction that remembers, sample by sample, without torch.

Every ``interval`` seconds a long short-term memory (:mod:`sysid.networks.cell`) looks at the position, at its speed since the
last look, and at where the position stands inside plays of given widths; what it says is added to the static map until the next
look. A play of width w is ``p ← min(max(p, x − w/2), x + w/2)``, and the network sees ``(x − p)/w``: hysteresis of any shape
that does not depend on the rate is made of such plays (Prandtl's; Visintin, Differential Models of Hysteresis, 1994), and
sensor noise below a width does not move them. Without widths it is the memory alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.compiled import inlined, kernel
from sysid.errors import InputError
from sysid.networks import cell

Array = npt.NDArray[np.float64]

# What a correction keeps: samples since it looked (NaN: never), the position then, what it adds now; then plays, then its cell.
_SINCE, _LAST, _ADDS, _PLAYS = range(4)


@dataclass(frozen=True, eq=False)
class Memory:
    """The correction of one direction.

    Args:
        interval: seconds between two looks.
        bound: it never adds more than this [SI of the output].
        widths: of the plays, (K,) [SI of the input].
        weights: arrays by the names of :data:`sysid.networks.cell.TENSORS`; inputs are position, speed and the plays.
        loss: with it on the recordings to select, in units of what the static map leaves (Huber's; below 1 it helps).
        epochs: that it was trained.
    """

    interval: float
    bound: float
    widths: Array
    weights: Mapping[str, Array]
    loss: float = math.nan
    epochs: int = 0

    @property
    def units(self) -> int:
        return len(self.weights["w"])

    @property
    def silent(self) -> bool:
        """Whether it adds nothing: it did not help on the recordings to select."""
        return not (self.weights["w"].any() or self.weights["w0"].any())

    def stride(self, rate_hz: float) -> int:
        """Samples from one look to the next.

        Raises:
            InputError: samples are further apart than the looks that it learned with.
        """
        if not rate_hz * self.interval > 0.99:
            found = f"samples at {rate_hz:g} Hz"
            raise InputError("network with history", found, f"at least {1.0 / self.interval:g} Hz, the rate of its looks")
        return max(1, round(self.interval * rate_hz))

    def added(self, values: Array, rate_hz: float) -> Array:
        """What it adds along a motion ``values`` (n,) at ``rate_hz``, (n,); NaN where that is NaN, and forgotten behind it."""
        stream = self.stream(rate_hz)
        out = np.empty(len(values))
        _run(*self._arrays, stream.kept, np.ascontiguousarray(values, dtype=np.float64), stream.stride, stream.looks_apart, out)
        return out

    def stream(self, rate_hz: float) -> MemoryStream:
        """It at the beginning of a motion that comes sample by sample."""
        return MemoryStream(self, rate_hz)

    def inputs(self, values: Array, stride: int, interval: float) -> Array:
        """What the network sees at its looks along ``values`` (n,) without NaN, (looks, 2 + K)."""
        at = np.arange(0, len(values), stride)
        speed = np.diff(values[at], prepend=values[at[0]]) / interval
        shares = np.empty((len(values), len(self.widths)))
        _plays(values, self.widths, shares)
        return np.column_stack([values[at], speed, shares[at]])

    @cached_property
    def _arrays(self) -> tuple[Array, Array, Array, Array, float]:
        return cell.flat(self.weights), self.weights["mean"], self.weights["scale"], self.widths, self.bound


class MemoryStream:
    """A :class:`Memory` in motion; ``kept`` is all it remembers."""

    def __init__(self, memory: Memory, rate_hz: float) -> None:
        self.memory, self.stride = memory, memory.stride(rate_hz)
        self.looks_apart = self.stride / rate_hz
        self.kept = np.zeros(_PLAYS + len(memory.widths) + cell.room(len(memory.weights["mean"]), memory.units))
        self.reset()

    def reset(self) -> None:
        """Forget, as if nothing had come before."""
        self.kept[:] = 0.0
        self.kept[_SINCE] = np.nan

    def step(self, value: float) -> float:
        """The next sample → what is added to the static map there; NaN forgets."""
        return float(_step(*self.memory._arrays, self.kept, value, self.stride, self.looks_apart))


@kernel
def _run(weights, mean, scale, widths, bound, s, values, stride, interval, out):
    for k in range(len(values)):
        out[k] = _sample(weights, mean, scale, widths, bound, s, values[k], stride, interval)


@kernel
def _step(weights, mean, scale, widths, bound, s, value, stride, interval):
    return _sample(weights, mean, scale, widths, bound, s, value, stride, interval)


@inlined
def _sample(weights, mean, scale, widths, bound, s, x, stride, interval):
    if np.isnan(x):
        for k in range(len(s)):
            s[k] = 0.0
        s[_SINCE] = np.nan
        return np.nan
    first = np.isnan(s[_SINCE])
    for k in range(len(widths)):
        p = x if first else s[_PLAYS + k]
        s[_PLAYS + k] = min(max(p, x - 0.5 * widths[k]), x + 0.5 * widths[k])
    if first or s[_SINCE] >= stride:
        units, h = (len(s) - _PLAYS - len(widths) - len(mean)) // 3, _PLAYS + len(widths)
        at = h + 3 * units
        s[at] = x
        s[at + 1] = 0.0 if first else (x - s[_LAST]) / interval
        for k in range(len(widths)):
            s[at + 2 + k] = (x - s[_PLAYS + k]) / widths[k]
        for k in range(len(mean)):
            s[at + k] = cell.drawn_in(s[at + k], mean[k], scale[k])
        s[_ADDS] = bound * math.tanh(cell.look(weights, len(mean), units, s, h))
        s[_LAST] = x
        s[_SINCE] = 0.0
    s[_SINCE] += 1.0
    return s[_ADDS]


@kernel
def _plays(values, widths, shares):
    """Where ``values`` (n,) stand inside plays, as shares of their widths, (n, K)."""
    for k in range(len(widths)):
        p = values[0]
        for n in range(len(values)):
            p = min(max(p, values[n] - 0.5 * widths[k]), values[n] + 0.5 * widths[k])
            shares[n, k] = (values[n] - p) / widths[k]
