"""Several perceptrons of equal shape as one batch of matrix products, with an explicit gradient.

For layers ``h_l = f(h_{l−1} W_l + b_l)``, f a rectifier, and the error ``e = h_L − y`` of n rows, with ``D_L = 2e/(n·d_out)``:
``∂W_l = h_{l−1}ᵀ D_l``, ``∂b_l = Σ D_l`` and ``D_{l−1} = (D_l W_lᵀ) ∘ f′``. The slope f′ follows from the rectifier's output
alone: [h > 0], or 1 − 1/((h + 1)² + 1) of the smooth one. For layers this small it takes two thirds of the time of autograd.

Every width is padded with zeros to a multiple of :data:`LANE`. Padding units start at zero, have no gradient, since f(0) = 0,
and stay at zero. All matrices then have the same alignment and none is a vector, so on a CPU a member's result has the same
bits whatever else is in the batch (tested).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from sysid.networks.mlp import Rectifier

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

#: Widths are multiples of this.
LANE = 8


def padded(sizes: Sequence[int]) -> tuple[int, ...]:
    """``sizes`` (d_in, hidden…, d_out) rounded up to multiples of :data:`LANE`."""
    return tuple(-(-size // LANE) * LANE for size in sizes)


def parameters(sizes: Sequence[int]) -> int:
    """Weights and biases of one member of padded ``sizes``."""
    return sum((d_in + 1) * d_out for d_in, d_out in itertools.pairwise(sizes))


@dataclass(frozen=True)
class Stack:
    """Parameters of m members, one contiguous block per layer, into which products can write.

    Args:
        flat: all parameters, (m·P,).
        layers: views of ``flat``, the weights (m, in, out) and biases (m, 1, out) of each layer in turn.
    """

    flat: torch.Tensor
    layers: tuple[torch.Tensor, ...]

    @staticmethod
    def zeros(sizes: tuple[int, ...], members: int, device: torch.device | str = "cpu") -> Stack:
        import torch

        return Stack.over(sizes, members, torch.zeros(members * parameters(sizes), device=device))

    @staticmethod
    def over(sizes: tuple[int, ...], members: int, flat: torch.Tensor) -> Stack:
        layers, offset = [], 0
        for d_in, d_out in itertools.pairwise(sizes):
            for rows in (d_in, 1):
                count = members * rows * d_out
                layers.append(flat[offset : offset + count].view(members, rows, d_out))
                offset += count
        return Stack(flat, tuple(layers))

    @staticmethod
    def of_rows(sizes: tuple[int, ...], rows: Sequence[Floats], device: torch.device | str = "cpu") -> Stack:
        """From the parameters of each member, (P,) each."""
        import torch

        stack = Stack.zeros(sizes, len(rows), device)
        table, offset = torch.from_numpy(np.stack(rows)), 0
        for layer in stack.layers:
            count = layer.shape[1] * layer.shape[2]
            layer.copy_(table[:, offset : offset + count].view(layer.shape))
            offset += count
        return stack

    def row(self, member: int) -> Floats:
        """Parameters of one member, (P,): weights and biases, layer by layer."""
        return np.concatenate([layer[member].reshape(-1).cpu().numpy() for layer in self.layers])

    def kept(self, sizes: tuple[int, ...], members: Sequence[int]) -> Stack:
        """A copy with these members only."""
        import torch

        return Stack.over(sizes, len(members), torch.cat([layer[list(members)].reshape(-1) for layer in self.layers]))


@dataclass(frozen=True)
class BatchedMlp:
    """Parameters and gradients of m perceptrons of padded ``sizes`` (d_in, hidden…, d_out)."""

    sizes: tuple[int, ...]
    parameters: Stack
    gradients: Stack
    rectifier: Rectifier = "relu"
    _buffers: dict[int, tuple[list[torch.Tensor], list[torch.Tensor]]] = field(default_factory=dict, repr=False)

    @staticmethod
    def of_rows(
        sizes: tuple[int, ...], rows: Sequence[Floats], device: torch.device | str = "cpu", rectifier: Rectifier = "relu"
    ) -> BatchedMlp:
        return BatchedMlp(sizes, Stack.of_rows(sizes, rows, device), Stack.zeros(sizes, len(rows), device), rectifier)

    def predict(self, x: torch.Tensor, members: Sequence[int] | None = None) -> torch.Tensor:
        """(m, n, d_in) → (m, n, d_out), of all or of ``members``."""
        import torch

        layers = self.parameters.layers if members is None else tuple(layer[list(members)] for layer in self.parameters.layers)
        for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
            x = torch.baddbmm(bias, x, weight)
            x = x.relu_() if self.rectifier == "relu" else _squareplus(x, torch.empty_like(x))
        return torch.baddbmm(layers[-1], x, layers[-2])

    def accumulate(self, x: torch.Tensor, y: torch.Tensor, outputs: torch.Tensor) -> torch.Tensor:
        """Write the gradients of each member's mean squared error on (m, n, d); returns the errors, (m,).

        Args:
            outputs: number of columns of ``y`` that are no padding, (m, 1, 1).
        """
        import torch

        rows = x.shape[1]
        out = self.forward(x)
        delta = torch.sub(out, y, out=self._buffers_for(rows)[1][-1])
        share = 1.0 / (outputs * rows)
        losses = torch.mul(delta, delta, out=out).sum(dim=1).sum(dim=1).mul_(share[:, 0, 0])
        self.backward(x, delta.mul_(2.0 * share))
        return losses

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Like :meth:`predict`, in buffers that :meth:`backward` uses; the next call with as many rows overwrites them."""
        import torch

        weights, biases = self.parameters.layers[::2], self.parameters.layers[1::2]
        outs, buffers = self._buffers_for(x.shape[1])
        for weight, bias, out, buffer in zip(weights, biases, outs, buffers, strict=True):
            x = torch.baddbmm(bias, x, weight, out=out)
            if out is not outs[-1]:
                x = out.relu_() if self.rectifier == "relu" else _squareplus(out, buffer)
        return x

    def backward(
        self, x: torch.Tensor, delta: torch.Tensor, of: Literal["parameters", "inputs"] = "parameters"
    ) -> torch.Tensor:
        """Back-propagate the gradient with respect to the outputs of the last :meth:`forward`: to the parameters, into
        ``gradients``, or to the inputs, returned, (m, n, d_in).

        Args:
            x: the inputs of that call.
            delta: gradient with respect to the outputs, (m, n, d_out).
        """
        import torch

        weights = self.parameters.layers[::2]
        outs, deltas = self._buffers_for(x.shape[1])
        for layer in range(len(weights) - 1, -1, -1):
            before = outs[layer - 1] if layer else x
            if of == "parameters":
                torch.bmm(before.transpose(1, 2), delta, out=self.gradients.layers[2 * layer])
                torch.sum(delta, dim=1, keepdim=True, out=self.gradients.layers[2 * layer + 1])
            if layer:
                delta = torch.bmm(delta, weights[layer].transpose(1, 2), out=deltas[layer - 1])
                if self.rectifier == "relu":
                    torch.ops.aten.threshold_backward.grad_input(delta, before, 0.0, grad_input=delta)
                else:
                    delta.mul_(before.add(1.0).square_().add_(1.0).reciprocal_().neg_().add_(1.0))
        return delta if of == "parameters" else torch.bmm(delta, weights[0].transpose(1, 2))

    def _buffers_for(self, rows: int) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Buffers of the layers' outputs and their gradients, allocated once: allocation takes a sixth of an update."""
        import torch

        if rows not in self._buffers:
            like = self.parameters.flat
            shapes = [(len(self.parameters.layers[0]), rows, size) for size in self.sizes[1:]]
            made = [[torch.empty(shape, dtype=like.dtype, device=like.device) for shape in shapes] for _ in range(2)]
            self._buffers[rows] = (made[0], made[1])
        return self._buffers[rows]


def _squareplus(x: torch.Tensor, buffer: torch.Tensor) -> torch.Tensor:
    """The smooth rectifier, in place: one rounding per operation, whatever the memory alignment."""
    import torch

    torch.mul(x, x, out=buffer).add_(4.0).sqrt_()
    return x.add_(buffer).mul_(0.5).sub_(1.0)


class BatchedAdam:
    """Adam (Kingma & Ba 2015) on a :class:`BatchedMlp`, with one learning rate per member.

    Args:
        first, second: estimates of the first and second moments of the gradients.
        steps: updates made so far. Their number is kept on the device only, so that an update can be part of a CUDA graph.
    """

    def __init__(self, first: Stack, second: Stack, steps: int) -> None:
        import torch

        self.first, self.second = first, second
        self._steps = torch.tensor(float(steps), device=first.flat.device)

    def step(self, model: BatchedMlp, rates: Sequence[float | torch.Tensor]) -> None:
        """One update from the gradients of the model, with the learning rate of each member."""
        from torch.optim.adam import adam

        begin = 0
        for rate, run in itertools.groupby(rates):
            end = begin + len(list(run))
            weights, gradients, first, second = (
                self._part(stack, begin, end) for stack in (model.parameters, model.gradients, self.first, self.second)
            )
            counts = [self._steps.clone() for _ in weights]  # adam() increments them
            adam(
                weights, gradients, first, second, [], counts, fused=True, amsgrad=False, maximize=False,
                lr=rate, beta1=0.9, beta2=0.999, eps=1e-8, weight_decay=0.0,
            )  # fmt: skip
            begin = end
        self._steps += 1

    @staticmethod
    def _part(stack: Stack, begin: int, end: int) -> list[torch.Tensor]:
        """The members ``begin`` to ``end`` (excluded) as views."""
        if (begin, end) == (0, len(stack.layers[0])):
            return [stack.flat]
        return [layer[begin:end] for layer in stack.layers]


def pack(sizes: tuple[int, ...], weights: Sequence[Floats], biases: Sequence[Floats]) -> Floats:
    """Weights (in, out) and biases (out,) of one member → padded parameters (P,)."""
    parts = []
    for (d_in, d_out), weight, bias in zip(itertools.pairwise(padded(sizes)), weights, biases, strict=True):
        whole = np.zeros((d_in + 1, d_out), dtype=np.float32)
        whole[: weight.shape[0], : weight.shape[1]], whole[-1, : len(bias)] = weight, bias
        parts.append(whole.reshape(-1))
    return np.concatenate(parts)


def unpack(sizes: tuple[int, ...], row: Floats) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Inverse of :func:`pack`."""
    weights, biases, offset = [], [], 0
    for (d_in, d_out), (rows, columns) in zip(itertools.pairwise(sizes), itertools.pairwise(padded(sizes)), strict=True):
        whole = row[offset : offset + (rows + 1) * columns].reshape(rows + 1, columns).astype(np.float64)
        weights.append(np.ascontiguousarray(whole[:d_in, :d_out]))
        biases.append(whole[-1, :d_out].copy())
        offset += (rows + 1) * columns
    return tuple(weights), tuple(biases)
