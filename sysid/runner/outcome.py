"""How a run went."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

from sysid.runner.histogram import Histogram

Ended = Literal["done", "stopped", "fault", "quit", "time"]


@dataclass
class RunOutcome:
    """How a run went.

    Args:
        ended: why it is over; ``state``, ``why``: of the machine of states then.
        cycles: made; ``missed``: deadlines that passed before their cycle began.
        lateness, latency: of all cycles.
        verdicts: check → cycles in which it objected.
        notes: what the operating system refused, and what the operator was told.
        error: where the runner itself failed, for whoever mends it; "" where it did not.
    """

    ended: Ended = "time"
    state: str = "idle"
    why: str = ""
    turns: int = 0
    missed: int = 0
    lateness: Histogram = field(default_factory=Histogram)
    latency: Histogram = field(default_factory=Histogram)
    verdicts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    error: str = ""
