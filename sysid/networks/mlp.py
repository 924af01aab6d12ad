"""A multi-layer perceptron as arrays, with its normalisation: inference in NumPy without torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import ExcitationError, InputError

Array = npt.NDArray[np.float64]

#: Activation between two layers: ``relu`` is max(0, x); ``smooth`` is squareplus less one, (x + √(x² + 4))/2 − 1 (Barron 2021,
#: arXiv:2112.11687), so that f(0) = 0. It has no exponential, so its bits are the same on every platform.
Rectifier = Literal["relu", "smooth"]


@dataclass(frozen=True)
class Normalisation:
    """``normalised = (value − mean) / scale``, with mean and scale of each column, (d,), in its SI unit."""

    mean: Array
    scale: Array

    @staticmethod
    def of(values: Array, names: Sequence[str], where: object) -> Normalisation:
        """Mean and standard deviation of the columns of ``values`` (n, d).

        Raises:
            ExcitationError: a column is constant.
        """
        mean, scale = values.mean(axis=0), values.std(axis=0)
        for name, centre, spread in zip(names, mean, scale, strict=True):
            if not spread > 1e-9 * max(1.0, abs(centre)):
                raise ExcitationError(
                    where, f"{name} is constant ({centre:.6g})", "a signal that varies", "Record data in which it moves."
                )
        return Normalisation(mean, scale)

    def apply(self, values: Array) -> Array:
        return np.asarray((values - self.mean) / self.scale)

    def invert(self, normalised: Array) -> Array:
        return np.asarray(normalised * self.scale + self.mean)


@dataclass(frozen=True)
class Mlp:
    """Layers ``h ← f(h·W + b)``, f a rectifier, the last one linear, between normalised inputs and outputs.

    Args:
        weights: (in, out) per layer, held in float64 with float32 resolution.
        biases: (out,) per layer.
        inputs, outputs: from and to SI units.
        rectifier: f.
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    inputs: Normalisation
    outputs: Normalisation
    rectifier: Rectifier = "relu"

    @property
    def hidden(self) -> tuple[int, ...]:
        """Units of the hidden layers."""
        return tuple(int(weight.shape[1]) for weight in self.weights[:-1])

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return sum(array.size for array in (*self.weights, *self.biases))

    def predict(self, values: npt.ArrayLike) -> Array:
        """Outputs (n, n_out) [SI] at ``values`` (n, n_in) [SI]; a row with NaN gives NaN.

        Raises:
            InputError: the number of columns is not the one the network was trained with.
        """
        h = np.asarray(values, dtype=np.float64)
        if h.ndim < 2:
            h = np.atleast_2d(h)
        weights, biases = self._folded
        if h.ndim != 2 or h.shape[1] != len(weights[0]):
            raise InputError("network input", f"shape {h.shape}", f"(n, {len(weights[0])})")
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            h = h.dot(weight)
            h += bias
            if self.rectifier == "relu":
                np.maximum(h, 0.0, out=h)
            else:
                root = h * h
                root += 4.0
                np.sqrt(root, out=root)
                h += root  # the factor ½ and the −1 are in the next layer
        h = h.dot(weights[-1])
        h += biases[-1]
        return np.asarray(h)

    @cached_property
    def _folded(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Weights and biases that include both normalisations and the linear part of the rectifier."""
        weights, biases = list(self.weights), list(self.biases)
        if self.rectifier == "smooth":
            biases[1:] = [bias - weight.sum(axis=0) for weight, bias in zip(weights[1:], biases[1:], strict=True)]
            weights[1:] = [0.5 * weight for weight in weights[1:]]
        weights[0] = weights[0] / self.inputs.scale[:, None]
        biases[0] = biases[0] - self.inputs.mean @ weights[0]
        weights[-1] = weights[-1] * self.outputs.scale
        biases[-1] = biases[-1] * self.outputs.scale + self.outputs.mean
        return tuple(weights), tuple(biases)
