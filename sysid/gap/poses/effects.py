"""Which effects static poses can show."""

from __future__ import annotations

from sysid.gap.candidates import Candidate


def shown_by_poses(candidate: Candidate) -> bool:
    """Whether static poses can show an effect: it has no memory of the motion and is not one of a clock."""
    effect = candidate.effect
    return effect.target != "stream" and not effect.memory(1.0) and effect.stage in ("joint", "end_effector", "sensor")
