"""Several perceptrons of equal shape as one batch of matrix products, with their gradient written out.

All parameters of a member lie in one row, so that Adam is one fused operation and a finished member is one row less. For layers
``h_l = max(0, h_{l−1} W_l + b_l)`` and the error ``e = h_L − y`` of n rows, with ``D_L = 2e/(n·d_out)``:
``∂W_l = h_{l−1}ᵀ D_l``, ``∂b_l = Σ D_l`` and ``D_{l−1} = (D_l W_lᵀ) ∘ [h_{l−1} > 0]``. Written out it takes two thirds of the
time of autograd, since the layers are so small that bookkeeping counts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BatchedMlp:
    """Parameters and gradients of m perceptrons.

    Args:
        sizes: (d_in, hidden…, d_out).
        parameters, gradients: (m, P), weights and biases of the layers in turn.
        weights, biases, weight_gradients, bias_gradients: views of them a layer, (m, in, out) and (m, 1, out).
    """

    sizes: tuple[int, ...]
    parameters: torch.Tensor
    gradients: torch.Tensor
    weights: tuple[torch.Tensor, ...]
    biases: tuple[torch.Tensor, ...]
    weight_gradients: tuple[torch.Tensor, ...]
    bias_gradients: tuple[torch.Tensor, ...]

    @staticmethod
    def initial(sizes: tuple[int, ...], generators: Sequence[torch.Generator]) -> BatchedMlp:
        """One member a generator; uniform in ±1/√in, as ``torch.nn.Linear`` does."""
        import torch

        rows = []
        for generator in generators:
            parts = []
            for d_in, d_out in itertools.pairwise(sizes):
                drawn = torch.rand((d_in + 1) * d_out, generator=generator)
                parts.append((drawn * 2.0 - 1.0) / math.sqrt(d_in))
            rows.append(torch.cat(parts))
        return BatchedMlp.of(sizes, torch.stack(rows))

    @staticmethod
    def of(sizes: tuple[int, ...], parameters: torch.Tensor) -> BatchedMlp:
        """The batch whose parameters these are, (m, P)."""
        import torch

        gradients = torch.zeros_like(parameters)
        weights, biases = _views(sizes, parameters)
        weight_gradients, bias_gradients = _views(sizes, gradients)
        return BatchedMlp(sizes, parameters, gradients, weights, biases, weight_gradients, bias_gradients)

    def predict(self, x: torch.Tensor) -> torch.Tensor:
        """(m, n, d_in) → (m, n, d_out)."""
        import torch

        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = torch.baddbmm(bias, x, weight).relu_()
        return torch.baddbmm(self.biases[-1], x, self.weights[-1])

    def accumulate(self, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Fill ``gradients`` with those of each member's mean squared error on (m, n, d); returns the errors, (m,)."""
        import torch

        activations = [x]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            activations.append(torch.baddbmm(bias, activations[-1], weight).relu_())
        delta = torch.baddbmm(self.biases[-1], activations[-1], self.weights[-1]).sub_(y)
        losses = delta.square().mean(dim=(1, 2))
        delta.mul_(2.0 / (delta.shape[1] * delta.shape[2]))
        for layer in range(len(self.weights) - 1, -1, -1):
            self.weight_gradients[layer].copy_(torch.bmm(activations[layer].transpose(1, 2), delta))
            torch.sum(delta, dim=1, keepdim=True, out=self.bias_gradients[layer])
            if layer:
                delta = torch.bmm(delta, self.weights[layer].transpose(1, 2)).mul_(activations[layer] > 0)
        return losses


class FusedAdam:
    """Adam on the rows of a :class:`BatchedMlp`, of which some may be dropped on the way."""

    def __init__(self, model: BatchedMlp, learning_rate: float) -> None:
        import torch

        parameter = torch.nn.Parameter(model.parameters, requires_grad=True)
        parameter.grad = model.gradients
        self._parameter = parameter
        self._optimiser = torch.optim.Adam([parameter], lr=learning_rate, fused=True)

    def step(self, learning_rate: float) -> None:
        """One update from the gradients that lie in the model."""
        self._optimiser.param_groups[0]["lr"] = learning_rate
        self._optimiser.step()

    def kept(self, model: BatchedMlp, rows: Sequence[int]) -> tuple[BatchedMlp, FusedAdam]:
        """Model and optimiser of those members alone, which go on exactly as they would have."""
        smaller = BatchedMlp.of(model.sizes, model.parameters[list(rows)].clone())
        adam = FusedAdam(smaller, float(self._optimiser.param_groups[0]["lr"]))
        state = self._optimiser.state[self._parameter]
        adam._optimiser.state[adam._parameter] = {
            "step": state["step"].clone(),
            "exp_avg": state["exp_avg"][list(rows)].clone(),
            "exp_avg_sq": state["exp_avg_sq"][list(rows)].clone(),
        }
        return smaller, adam


def unpack(sizes: tuple[int, ...], parameters: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Weights (in, out) and biases (out,) of one member from its row (P,)."""
    weights, biases = [], []
    offset = 0
    for d_in, d_out in itertools.pairwise(sizes):
        weights.append(parameters[offset : offset + d_in * d_out].reshape(d_in, d_out))
        biases.append(parameters[offset + d_in * d_out : offset + (d_in + 1) * d_out])
        offset += (d_in + 1) * d_out
    return tuple(weights), tuple(biases)


def _views(sizes: tuple[int, ...], flat: torch.Tensor) -> tuple[tuple[torch.Tensor, ...], tuple[torch.Tensor, ...]]:
    members = flat.shape[0]
    weights, biases = [], []
    offset = 0
    for d_in, d_out in itertools.pairwise(sizes):
        weights.append(flat[:, offset : offset + d_in * d_out].view(members, d_in, d_out))
        biases.append(flat[:, offset + d_in * d_out : offset + (d_in + 1) * d_out].view(members, 1, d_out))
        offset += (d_in + 1) * d_out
    return tuple(weights), tuple(biases)
