"""One step of a small long short-term memory (LSTM) with one output, compiled, from flat arrays of weights.

Gates in the order input, forget, cell, output (Hochreiter & Schmidhuber, Neural Computation 9, 1997)::

    i, f, o = σ(W·x + U·h + b),  g = tanh(W·x + U·h + b),  c ← f·c + i·g,  h ← o·tanh(c),  r = w·h + w₀

Used by the residual network of a plant (:mod:`sysid.plant.residual`) and by actuator networks with history
(:mod:`sysid.networks.history_correction`); trained by :mod:`sysid.networks.recurrent`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from sysid.compiled import inlined

Array = npt.NDArray[np.float64]

#: Inputs are clipped to this many standard deviations, so that the output is constant beyond the recorded range.
REACH = 4.0
#: Arrays of a trained network: of the inputs (F,), then (4H, F), (4H, H), (4H,), (H,), (1,).
TENSORS = ("mean", "scale", "W", "U", "b", "w", "w0")


def flat_weights(weights: Mapping[str, Array]) -> Array:
    """W, U, b, w and w₀ as :func:`lstm_step` takes them, one after the other."""
    return np.concatenate([np.ravel(weights[name]) for name in TENSORS[2:]])


def state_size(inputs: int, units: int) -> int:
    """Size of the state: h, c, the next h, and the inputs."""
    return 3 * units + inputs


@inlined
def standardised(value, mean, scale):
    """An input in standard deviations, clipped to ±:data:`REACH`."""
    return min(max((value - mean) * scale, -REACH), REACH)


@inlined
def lstm_step(weights, inputs, units, s, h):
    """One step of the network; returns r.

    Args:
        weights: from :func:`flat_weights`.
        inputs, units: their numbers.
        s, h: array whose entries from index ``h`` on are the state (:func:`state_size`): h, c, the next h, standardised inputs.
    """
    c, new, x = h + units, h + 2 * units, h + 3 * units
    U, b = 4 * units * inputs, 4 * units * (inputs + units)
    w = b + 4 * units
    for k in range(units):
        gate_i = weights[b + k]
        gate_f = weights[b + units + k]
        gate_g = weights[b + 2 * units + k]
        gate_o = weights[b + 3 * units + k]
        for j in range(inputs):
            value = s[x + j]
            gate_i += weights[k * inputs + j] * value
            gate_f += weights[(units + k) * inputs + j] * value
            gate_g += weights[(2 * units + k) * inputs + j] * value
            gate_o += weights[(3 * units + k) * inputs + j] * value
        for j in range(units):
            value = s[h + j]
            gate_i += weights[U + k * units + j] * value
            gate_f += weights[U + (units + k) * units + j] * value
            gate_g += weights[U + (2 * units + k) * units + j] * value
            gate_o += weights[U + (3 * units + k) * units + j] * value
        s[c + k] = _sigmoid(gate_f) * s[c + k] + _sigmoid(gate_i) * math.tanh(gate_g)
        s[new + k] = _sigmoid(gate_o) * math.tanh(s[c + k])
    total = weights[w + units]
    for k in range(units):
        s[h + k] = s[new + k]
        total += weights[w + k] * s[new + k]
    return total


@inlined
def _sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))
