"""Ornstein–Uhlenbeck noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class OrnsteinUhlenbeck:
    """Independent processes ``x ← x − θ·x·dt + σ·√dt·n`` (Euler–Maruyama), n standard normal; stationary standard deviation
    ``σ/√(2θ − θ²·dt)``. With the same σ and θ, dt = 0.01 gives a tenth of the increments of dt = 1 and a hundred times its
    correlation time.

    Args:
        shape: of the processes, the first axis the copies of an environment.
        theta, sigma, time_step: θ, σ, dt.
    """

    def __init__(self, shape: tuple[int, ...], theta: float, sigma: float, time_step: float, rng: np.random.Generator) -> None:
        self.theta, self.sigma, self.time_step = theta, sigma, time_step
        self.value = np.zeros(shape)
        self._rng = rng

    def step(self, share: float = 1.0) -> Array:
        """The next values, with ``share`` of σ."""
        drawn = self._rng.standard_normal(self.value.shape)
        kept = 1.0 - self.theta * self.time_step
        self.value = kept * self.value + share * self.sigma * np.sqrt(self.time_step) * drawn
        return self.value

    def begin(self, copies: Flags) -> None:
        """A new episode of these copies: their processes begin at zero."""
        self.value[copies] = 0.0

    def state(self) -> dict[str, Any]:
        return {"value": self.value.copy(), "generator": self._rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        self.value = np.array(state["value"], dtype=np.float64)
        self._rng.bit_generator.state = state["generator"]
