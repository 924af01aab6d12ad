"""Errors that all recordings share, so that no residual shows them: zeros of joints and mounts of bodies.

Both come from one reference pose, whose frames are averaged when logs are ingested. Every signal may have an offset equal to
the noise of such a mean; to first order it moves the values of a fit as it moves its residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.gap.intervals.criterion import Criterion
from sysid.gap.intervals.curvature import Curvature
from sysid.signals import split_signal

Array = npt.NDArray[np.float64]

#: Frames of a reference pose: a second of it.
FRAMES = 100
#: Stages between joints and bodies. Elsewhere a run starts at the measurement and includes its offset.
AFFECTED = ("joint", "end_effector")


def shared_offsets(criterion: Criterion, curvature: Curvature, values: Array, noise: Mapping[str, float]) -> Array:
    """Standard deviation (k,) of a fit at ``values`` (k,) caused by offsets of the signals.

    Args:
        noise: standard deviation of every measured signal.
    """
    problem, recordings = criterion.data.problem, criterion.data.recordings
    squares = np.zeros(len(values))
    if problem.stage not in AFFECTED:
        return squares
    made = criterion.predicted(values, recordings)
    gain = curvature.inverse @ (curvature.slopes * criterion.weights(curvature.errors)[:, None]).T
    for name, level in noise.items():
        off = level / FRAMES**0.5
        if name in problem.signals:
            moved = [part + off * (np.array(problem.signals) == name) for part in made]
        elif split_signal(name)[1] != "command":
            shifted = [
                replace(r, table=r.table.assign(**{name: r.table[name] + off})) if name in r.table else r for r in recordings
            ]
            moved = criterion.predicted(values, shifted)
        else:
            continue
        squares += (gain @ criterion.between(made, moved)) ** 2
    return np.sqrt(squares)
