"""Free runs that were asked for already: a search fits the same sets of effects again, under other variances."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Most samples that are kept of a recording, 16 MB.
KEPT = 2_000_000


class KnownRuns:
    """The latest free runs (n,) of the axes in one recording.

    They are known by their parameters ``theta`` (N,), and by ``inputs``: whatever else a run depends on.
    """

    def __init__(self, samples: int) -> None:
        self._most, self._lock = KEPT // max(samples, 1), threading.Lock()
        self._runs = OrderedDict[tuple[Hashable, bytes], Array]()

    def read(self, inputs: Hashable, theta: Array, out: Array) -> bool:
        """Write a run into ``out`` (n,), if it is known."""
        key = inputs, theta.tobytes()
        with self._lock:
            known = self._runs.get(key)
            if known is None:
                return False
            self._runs.move_to_end(key)
        out[:] = known
        return True

    def keep(self, inputs: Hashable, theta: Array, run: Array) -> None:
        """Keep a run (n,); the one that was not asked for the longest time leaves."""
        with self._lock:
            self._runs[inputs, theta.tobytes()] = run.copy()
            while len(self._runs) > self._most:
                self._runs.popitem(last=False)
