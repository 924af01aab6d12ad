"""One cycle of the loop, as the flight log stores it: inputs, estimate, decision and output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from sysid_rl.run.transport import MachineInputs, Measurement

Array = npt.NDArray[np.float64]

#: Reactions to a violation, mildest first.
Reaction = Literal["clamp", "hold", "stop", "fault"]
REACTIONS: tuple[Reaction, ...] = ("clamp", "hold", "stop", "fault")
#: States of a run; transitions in :mod:`sysid_rl.run.states`.
State = Literal["idle", "ready", "armed", "running", "stopping", "fault"]


@dataclass(frozen=True, slots=True)
class Violation:
    """A rule of the supervisor that was broken.

    Args:
        check: its name, as in ``[checks]`` of the recipe.
        target: axis, signal or "machine".
        reaction: to it.
        found, limit: SI; NaN if there is no number.
        text: one line.
    """

    check: str
    target: str
    reaction: Reaction
    found: float
    limit: float
    text: str


@dataclass(frozen=True, slots=True)
class Cycle:
    """One cycle of the loop. It owns its arrays; NaN marks unknown values.

    Args:
        number: of the cycle, from 0.
        at_ns, due_ns: actual and planned beginning, on the transport's clock.
        state: of the run after this cycle.
        inputs: switches and faults of the machine.
        readings: newest of each signal.
        joints: estimate, (A,) [rad or m].
        ee: estimate of the end effector, (3,) [m].
        target: of the end effector, (3,) [m].
        asked: requested joint setpoints, (A,) [rad or m].
        setpoints: after the supervisor, (A,).
        drive_setpoints: of what the commands drive, cylinder [m] or joint, (A,).
        commands_asked: of the cylinder controller, (A,).
        commands: sent, as the line carries them, (A,).
        enabled: whether the valves were enabled.
        verdicts: violations found by the supervisor.
        source: of the setpoints: policy, fallback, hold, stop, none …
        lateness_ns: delay of the beginning.
        latency_ns: from the beginning until the commands were sent.
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
    requested: Array
    setpoints: Array
    drive_setpoints: Array
    requested_commands: Array
    commands: Array
    enabled: bool
    verdicts: tuple[Violation, ...]
    source: str
    lateness_ns: int
    latency_ns: int


class Recorder(Protocol):
    """Records cycles without delaying the loop."""

    def record(self, cycle: Cycle) -> None: ...

    @property
    def fault(self) -> str:
        """Why it cannot record (disk full, queue overflow); "" while it records."""
        ...
