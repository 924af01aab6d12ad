"""Recurrent correction of one direction of an actuator network with history, sample by sample, without torch.

Every ``interval`` seconds an LSTM (:mod:`sysid.networks.cell`) is updated with the position, its mean speed since the last
update, and the states of play operators of given widths; its output is output to the static map until the next update. A play
operator of width w is ``p ← min(max(p, x − w/2), x + w/2)``; the input of the network is ``(x − p)/w``. Rate-independent
hysteresis is a superposition of such operators (Prandtl-Ishlinskii; Visintin, Differential Models of Hysteresis, 1994), and
sensor noise below a width does not move its operator.
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

# State: samples since the last update (NaN: none yet), the position then, the current output; then play operators and the LSTM.
_SINCE, _LAST, _OUTPUT, _OPERATORS = range(4)


@dataclass(frozen=True, eq=False)
class HistoryCorrection:
    """The correction of one direction.

    Args:
        interval: seconds between two updates.
        bound: largest magnitude of the output [SI of the output].
        widths: of the play operators, (K,) [SI of the input].
        weights: arrays by the names of :data:`sysid.networks.cell.TENSORS`; inputs are position, speed and play operators.
        loss: Huber loss on the select recordings relative to the static map alone.
        epochs: of its training.
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
    def inactive(self) -> bool:
        """Whether the output is zero, because it did not lower the loss on the select recordings."""
        return not (self.weights["w"].any() or self.weights["w0"].any())

    def timing(self, rate_hz: float) -> tuple[int, float]:
        """Samples, and seconds, from one update to the next.

        Raises:
            InputError: samples are further apart than the updates.
        """
        if not rate_hz * self.interval > 0.99:
            found = f"samples at {rate_hz:g} Hz"
            raise InputError("network with history", found, f"at least {1.0 / self.interval:g} Hz, its update rate")
        stride = max(1, round(self.interval * rate_hz))
        return stride, stride / rate_hz

    def output(self, values: Array, rate_hz: float) -> Array:
        """Output along a motion ``values`` (n,) at ``rate_hz``, (n,); NaN gives NaN and resets the state."""
        out = np.empty(len(values))
        _run(*self._arrays, self.state(), np.ascontiguousarray(values, dtype=np.float64), *self.timing(rate_hz), out)
        return out

    def state(self) -> Array:
        """The state before the first sample."""
        size = _OPERATORS + len(self.widths) + cell.state_size(len(self.weights["mean"]), self.units)
        return np.concatenate([[np.nan], np.zeros(size - 1)])

    def step(self, state: Array, value: float, timing: tuple[int, float]) -> float:
        """The next sample of the input → the output; NaN gives NaN and resets the state."""
        return float(_step(*self._arrays, state, value, *timing))

    def inputs(self, values: Array, stride: int, interval: float) -> Array:
        """Inputs of the LSTM at its updates along ``values`` (n,) without NaN, (updates, 2 + K)."""
        at = np.arange(0, len(values), stride)
        speed = np.diff(values[at], prepend=values[at[0]]) / interval
        shares = np.empty((len(values), len(self.widths)))
        _play_operators(values, self.widths, shares)
        return np.column_stack([values[at], speed, shares[at]])

    @cached_property
    def _arrays(self) -> tuple[Array, Array, Array, Array, float]:
        return cell.flat_weights(self.weights), self.weights["mean"], self.weights["scale"], self.widths, self.bound


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
        p = x if first else s[_OPERATORS + k]
        s[_OPERATORS + k] = min(max(p, x - 0.5 * widths[k]), x + 0.5 * widths[k])
    if first or s[_SINCE] >= stride:
        units, h = (len(s) - _OPERATORS - len(widths) - len(mean)) // 3, _OPERATORS + len(widths)
        at = h + 3 * units
        s[at] = x
        s[at + 1] = 0.0 if first else (x - s[_LAST]) / interval
        for k in range(len(widths)):
            s[at + 2 + k] = (x - s[_OPERATORS + k]) / widths[k]
        for k in range(len(mean)):
            s[at + k] = cell.standardised(s[at + k], mean[k], scale[k])
        s[_OUTPUT] = bound * math.tanh(cell.lstm_step(weights, len(mean), units, s, h))
        s[_LAST] = x
        s[_SINCE] = 0.0
    s[_SINCE] += 1.0
    return s[_OUTPUT]


@kernel
def _play_operators(values, widths, shares):
    """``values`` (n,) relative to play operators, as shares of their widths, (n, K)."""
    for k in range(len(widths)):
        p = values[0]
        for n in range(len(values)):
            p = min(max(p, values[n] - 0.5 * widths[k]), values[n] + 0.5 * widths[k])
            shares[n, k] = (values[n] - p) / widths[k]
