"""A residual network of a plant, fitted to the free run itself: least squares with a normal prior on the weights.

``sysid gap --carry`` trains a residual network on the error that its stage has at measured motion. In a free run its mean error
integrates, and its inputs are those of the simulation. Here the weights z minimise

    Σ (simulated − measured)² / (κ·s)² + Σ z²

over one record, s the error without the network (Levenberg–Marquardt, differences for the derivatives). The noise level κ and
the random first weights are those with the least error on blocks of the record that were left out of the sum: the input drives
the free run through all blocks, so that none needs a start of its own. Where none lowers this error there is no network.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.plant import Plant
from sysid.plant.residual import Residual, ResidualStage
from sysid.progress import Progress, silent

Array = npt.NDArray[np.float64]
#: Differences of a plant from one record (n,).
Differences = Callable[[Plant], Array]

UNITS = 4
#: Noise levels that are compared, over the error without the network: large ones keep the weights near zero.
NOISE_LEVELS = (2.0, 4.0, 8.0)
#: Blocks that are left out in turn, and seeds of the first weights.
BLOCKS, SEEDS = 4, (0, 1, 2)
#: Standard deviation of the first weights, of those of the output relative to them, and bias of the forget gate (remembers).
FIRST, OUTPUT, REMEMBER = 0.3, 0.1, 1.0
STEP, ITERATIONS, ATTEMPTS, CONVERGED = 1e-4, 25, 8, 2e-3


@dataclass(frozen=True)
class Shape:
    """What a network is before it has weights; ``mean`` and ``scale`` (F,) of its inputs, a scale of zero leaves one out."""

    stage: ResidualStage
    target: str
    bound: float
    interval: float
    mean: Array
    scale: Array

    @property
    def size(self) -> int:
        """Number of weights."""
        return 4 * UNITS * (int(np.count_nonzero(self.scale)) + UNITS + 1) + UNITS + 1

    def first(self, seed: int) -> Array:
        """Random first weights (size,), with an output that is nearly zero."""
        weights = np.random.default_rng(seed).normal(0.0, FIRST, self.size)
        weights[-UNITS - 1 :] *= OUTPUT
        forget = self.size - (UNITS + 1) - 3 * UNITS
        weights[forget : forget + UNITS] += REMEMBER
        return weights

    def on(self, plant: Plant, weights: Array) -> Plant:
        """``plant`` with the network of these weights (size,)."""
        used = np.flatnonzero(self.scale)
        W, U, b, w, w0 = np.split(weights, np.cumsum([4 * UNITS * len(used), 4 * UNITS * UNITS, 4 * UNITS, UNITS]))
        wide = np.zeros((4 * UNITS, len(self.scale)))
        wide[:, used] = W.reshape(4 * UNITS, len(used))
        about = {"trained": "least squares of the free run"}
        gates = (wide, U.reshape(4 * UNITS, UNITS), b)
        made = Residual(self.stage, self.target, self.bound, self.interval, self.mean, self.scale, *gates, w, w0, about)
        return plant.with_residual(made)


@dataclass(frozen=True)
class FreeRunResidual:
    """A fitted network, or none.

    Args:
        plant: with the network; without one where none lowers the error on blocks left out.
        without: RMS on these blocks without a network; ``left_out``: the least with one, at ``noise_level`` and ``seed``.
    """

    plant: Plant
    without: float
    left_out: float
    noise_level: float
    seed: int

    @property
    def accepted(self) -> bool:
        return self.left_out < self.without


def fit_free_run(plant: Plant, shape: Shape, differences: Differences, progress: Progress = silent) -> FreeRunResidual:
    """Fit a residual network to the free run over one record.

    Args:
        differences: simulated − measured output of a plant (n,), without the rows from which the start is estimated.
    """
    before = differences(plant)
    edges = np.linspace(0, len(before), BLOCKS + 1).astype(int)
    error, left_out = _rms(before), dict[tuple[float, int], float]()
    tried = [(level, seed) for seed in SEEDS for level in NOISE_LEVELS]
    for number, (level, seed) in enumerate(tried):
        progress(number / (len(tried) + 1), f"noise level {level:g}, seed {seed}")
        parts = []
        for low, high in pairwise(edges):
            kept = np.ones(len(before), dtype=bool)
            kept[low:high] = False
            parts.append(differences(_most_probable(plant, shape, differences, kept, level * error, seed))[low:high])
        left_out[level, seed] = _rms(np.concatenate(parts))
    level, seed = min(left_out, key=lambda key: left_out[key])
    result = FreeRunResidual(plant, error, left_out[level, seed], level, seed)
    if not result.accepted:
        return result
    every = np.ones(len(before), dtype=bool)
    return replace(result, plant=_most_probable(plant, shape, differences, every, level * error, seed))


def _most_probable(
    plant: Plant, shape: Shape, differences: Differences, kept: npt.NDArray[np.bool_], noise: float, seed: int
) -> Plant:
    """The plant with the most probable weights for the rows that are ``kept``."""

    def misfit(weights: Array) -> Array:
        return differences(shape.on(plant, weights))[kept] / noise

    weights, damping = shape.first(seed), 1.0
    rest = misfit(weights)
    cost = rest @ rest + weights @ weights
    for _ in range(ITERATIONS):
        columns = []
        for k in range(shape.size):
            moved = weights.copy()
            moved[k] += STEP
            columns.append((misfit(moved) - rest) / STEP)
        jacobian = np.column_stack(columns)
        normal = jacobian.T @ jacobian + np.eye(shape.size)
        gradient = jacobian.T @ rest + weights
        gained = 0.0
        for _ in range(ATTEMPTS):
            tried = weights - np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
            found = misfit(tried)
            total = found @ found + tried @ tried
            if total < cost:  # false for NaN
                gained, weights, rest, cost, damping = cost - total, tried, found, total, max(damping / 5.0, 1e-6)
                break
            damping *= 4.0
        if gained < CONVERGED * cost:
            break
    return shape.on(plant, weights)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
