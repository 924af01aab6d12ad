"""``[loop]`` of a recipe: how long a run waits, rests and lasts, and what the operating system is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sysid.config import STRICT


@dataclass(frozen=True)
class LoopSettings:
    """``[loop]``.

    Args:
        settle_s: everything is sound for so long before the machine counts as ready.
        ready_within_s: unattended runs end where it does not become ready within this.
        rest_s: valves are neutral for so long before a stop counts as done; ``rest_within_s``: else it is a fault.
        seconds: the run ends after so long at the latest; None: never.
        priority: SCHED_FIFO, 1 … 99; 0: none is asked for.
        lock_memory: ask for it.
        fallback: what sets where the policy is not trusted.
    """

    __pydantic_config__ = STRICT

    settle_s: float = 0.5
    ready_within_s: float = 10.0
    rest_s: float = 0.3
    rest_within_s: float = 3.0
    seconds: float | None = None
    priority: int = 50
    lock_memory: bool = True
    fallback: Literal["ik", "hold"] = "ik"
