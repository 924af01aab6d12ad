"""Everything that one cycle of the loop saw, decided and did: what the flight log keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from sysid.runner.transport import MachineInputs, Measurement

Array = npt.NDArray[np.float64]

#: What a verdict makes of a cycle, mildest first.
Reaction = Literal["clamp", "hold", "stop", "fault"]
REACTIONS: tuple[Reaction, ...] = ("clamp", "hold", "stop", "fault")
#: States of a run; transitions in :mod:`sysid.runner.states`.
State = Literal["idle", "ready", "armed", "running", "stopping", "fault"]


@dataclass(frozen=True, slots=True)
class Violation:
    """A rule of the supervisor that was broken.

    Args:
        check: its name, as in ``[checks]`` of the recipe.
        target: axis, signal or "machine".
        reaction: what follows.
        found, limit: SI; NaN where there is no number.
        text: one line for people.
    """

    check: str
    target: str
    reaction: Reaction
    found: float
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class Cycle:
    """One cycle of the loop. Arrays belong to it; NaN where something is not known.

    Args:
        number: of the cycle, from 0.
        at_ns: when it began, on the transport's clock; ``due_ns`` when it should have.
        state: of the machine of states after this cycle.
        inputs: switches and faults of the machine's side.
        readings: newest of each signal.
        joints: as believed, (A,) [rad or m].
        ee: end effector as believed, (3,) [m].
        target: where it should be, (3,) [m].
        asked: joint setpoints of the policy, (A,) [rad or m].
        setpoints: those that the supervisor let through, (A,).
        drive_setpoints: of what the commands drive, cylinder [m] or joint, (A,).
        commands_asked: of the cylinder controller, (A,).
        commands: sent, (A,).
        enabled: whether the valves were let move.
        verdicts: what the supervisor found.
        source: whose setpoints these were: policy, fallback, hold, stop, none …
        lateness_ns: how much later than due the cycle began.
        latency_ns: from its beginning until the commands were out.
    """

    number: int
    at_ns: int
    due_ns: int
    state: State
    inputs: MachineInputs
    readings: Mapping[str, Measurement]
    joints: Array
    ee: Array
    target: Array
    asked: Array
    setpoints: Array
    drive_setpoints: Array
    commands_asked: Array
    commands: Array
    enabled: bool
    verdicts: tuple[Violation, ...]
    source: str
    lateness_ns: int
    latency_ns: int


class Recorder(Protocol):
    """Takes cycles without ever holding up the loop."""

    def record(self, cycle: Cycle) -> None: ...

    @property
    def fault(self) -> str:
        """What keeps it from recording (disk full, queue overflown); "" while it records."""
        ...
