"""Play between a drive and the structure it moves: the structure stands still while the drive crosses the play."""

from __future__ import annotations

from sysid.bench.compiled import compiled


@compiled
def follow_with_play(structure: float, drive: float, width: float) -> float:
    """Structure position after the drive has moved to ``drive``; ``width`` is the full play [m or rad]."""
    half = 0.5 * width
    if drive - structure > half:
        return drive - half
    if drive - structure < -half:
        return drive + half
    return structure
