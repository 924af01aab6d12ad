"""Random numbers of a member: initial weights and shuffle order.

Both follow from the seed and the member's name by a counter-based generator (Philox; Salmon et al. 2011), so any part of the
order is available without the previous ones: a checkpoint holds no generator state, and the order is the same on every device.
"""

from __future__ import annotations

import hashlib
import itertools
import math

import numpy as np
import numpy.typing as npt

from sysid.networks.batch import Floats, pack


def generator(seed: int, name: str, pass_: int) -> np.random.Generator:
    """Generator of one member and one pass over its rows; pass 0 is for the initial weights."""
    # Python's hash() differs between processes.
    key = int.from_bytes(hashlib.blake2b(f"{seed} {name}".encode(), digest_size=16).digest(), "little")
    return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, pass_]))


def initial_row(seed: int, name: str, sizes: tuple[int, ...]) -> Floats:
    """Initial weights and biases, uniform in ±1/√in as in ``torch.nn.Linear``, (P,) with padding."""
    rng = generator(seed, name, 0)
    weights, biases = [], []
    for d_in, d_out in itertools.pairwise(sizes):
        drawn = (rng.random((d_in + 1, d_out), dtype=np.float32) * 2.0 - 1.0) / np.float32(math.sqrt(d_in))
        weights.append(drawn[:-1])
        biases.append(drawn[-1])
    return pack(sizes, weights, biases)


class ShuffleOrder:
    """The endless shuffled sequence of a member's rows: one permutation per pass."""

    def __init__(self, seed: int, name: str, rows: int) -> None:
        self._seed, self._name, self._rows = seed, name, rows
        self._pass, self._permutation = 0, np.empty(0, dtype=np.int64)

    def take(self, begin: int, end: int) -> npt.NDArray[np.int64]:
        """The row numbers at positions ``begin`` to ``end`` (excluded) of the sequence."""
        parts = []
        for pass_ in range(begin // self._rows, -(-end // self._rows)):
            first = pass_ * self._rows
            parts.append(self._permutation_of(pass_ + 1)[max(begin - first, 0) : end - first])
        return np.concatenate(parts)

    def _permutation_of(self, pass_: int) -> npt.NDArray[np.int64]:
        if pass_ != self._pass:
            self._pass, self._permutation = pass_, generator(self._seed, self._name, pass_).permutation(self._rows)
        return self._permutation
