"""The row with the largest error of a simulated signal, for the report and the Rerun recording."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def worst_row(simulated: npt.ArrayLike, measured: npt.ArrayLike) -> tuple[int, float] | None:
    """Row and error (simulated − measured) of the largest magnitude; None where no row has both.

    Args:
        simulated, measured: of one signal in the same rows, (n,) [SI]; NaN where it is unknown.
    """
    error = np.asarray(simulated, dtype=np.float64) - np.asarray(measured, dtype=np.float64)
    if not np.isfinite(error).any():
        return None
    row = int(np.nanargmax(np.abs(error)))
    return row, float(error[row])
