"""Rate of a sampled position: the speed that a device measures at each sample."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def rate_of(positions: Array, rate_hz: float) -> Array:
    """Rate of positions (…, n) at their samples [1/s times their unit], (…, n).

    The mean of the rates of the steps before and after the sample; one of them at the ends of a stretch and beside missing
    values, NaN where the position is missing. Valve, servo and force axis alike: a plant moves an axis in each step with the
    mean speed of that step, the state of a servo has no speed, and a speed before the end stop is not that of the cylinder. The
    mean of both steps has no delay and is exact for a constant acceleration; a backward difference would lag half a sample.
    """
    steps = np.diff(positions, axis=-1) * rate_hz
    missing = np.full((*positions.shape[:-1], 1), np.nan)
    before, after = np.concatenate([missing, steps], axis=-1), np.concatenate([steps, missing], axis=-1)
    both = 0.5 * (before + after)
    return np.where(np.isnan(both), np.where(np.isnan(before), after, before), both)
