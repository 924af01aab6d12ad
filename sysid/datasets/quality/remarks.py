"""What looks wrong with a drive at first sight, in words."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.datasets.in_pieces import known, stretches
from sysid.datasets.recording import Recording

#: A sensor that gives the very same value for this long while its axis is commanded may be stuck [s].
STUCK_S = 2.0


def axis_remarks(
    recording: Recording, axis: str, driven: str, moving: npt.NDArray[np.bool_], ends: tuple[float, float]
) -> list[str]:
    values = recording.values(driven)
    there = known(values)
    if not len(there):
        return []
    flags = []
    frozen = np.zeros(len(values), dtype=bool)
    frozen[1:] = (values[1:] == values[:-1]) & moving[1:] & moving[:-1]
    stuck = longest_run(frozen) / recording.rate_hz
    if stuck > STUCK_S:
        flags.append(
            f"{driven}: the very same value for {stuck:.1f} s while {axis} is commanded: stuck sensor, or a command too small"
        )
    if np.isfinite(ends).all():
        margin = 1e-3 * (ends[1] - ends[0])
        beyond = (there < ends[0] - margin) | (there > ends[1] + margin)
        if beyond.any():
            flags.append(
                f"{driven}: {100 * beyond.mean():.1f} % of the samples lie outside [{ends[0]:g}, {ends[1]:g}]: offset or unit?"
            )
    return flags


def longest_run(mask: npt.NDArray[np.bool_]) -> int:
    """Length of the longest stretch of True."""
    first, last = stretches(mask)
    return int((last - first).max(initial=0))
