"""Stationary bootstrap of the mean of a series that is correlated in time.

Source: stationary bootstrap: Politis & Romano, JASA 89 (1994); length of the blocks: Politis & White, Econometric Reviews 23
(2004), corrected 28 (2009).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.current_folder import without_matplotlib

Array = npt.NDArray[np.float64]


def bootstrap_means(series: Array, seed: int, draws: int = 1000, least: int = 5) -> Array:
    """Means of ``draws`` stationary-bootstrap samples of ``series`` (n,), (draws,).

    Args:
        least: lower bound of the mean block length; 1 for independent rows.
    """
    with without_matplotlib():
        from arch.bootstrap import StationaryBootstrap, optimal_block_length

    length = float(np.nan_to_num(optimal_block_length(series)["stationary"].iloc[0], nan=1.0))
    block = int(np.clip(round(length), least, max(least, len(series) // 10)))
    bootstrap = StationaryBootstrap(block, series, seed=np.random.default_rng(seed))
    return np.asarray(bootstrap.apply(lambda x: np.mean(x, axis=0), draws), dtype=np.float64).ravel()
