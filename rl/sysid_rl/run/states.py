"""The states of a run and the transitions by events; there are no others than those in the table.

idle → ready → armed → running → stopping → ready        any → fault → (a person's reset) → idle
"""

from __future__ import annotations

from typing import Literal, get_args

from sysid.errors import InputError
from sysid_rl.run.cycle import State

#: ``healthy``/``unhealthy``: everything required is present and valid, or not. ``hold``: the dead-man switch is pressed.
#: ``rest``: the machine is at rest with neutral valves.
Event = Literal["healthy", "unhealthy", "arm", "disarm", "hold", "stop", "rest", "fault", "reset"]
#: Events that only a person can cause.
PERSONAL: tuple[Event, ...] = ("arm", "disarm", "hold", "reset")
STATES: tuple[State, ...] = get_args(State)

TABLE: dict[tuple[State, Event], State] = {
    ("idle", "healthy"): "ready",
    ("ready", "unhealthy"): "idle",
    ("ready", "arm"): "armed",
    ("armed", "disarm"): "ready",
    ("armed", "stop"): "ready",
    ("armed", "unhealthy"): "idle",
    ("armed", "hold"): "running",
    ("running", "stop"): "stopping",
    ("stopping", "rest"): "ready",
    ("fault", "reset"): "idle",
    **{(state, "fault"): "fault" for state in STATES},
}
#: In these the valves may move.
MOVING: tuple[State, ...] = ("running", "stopping")


class States:
    """The state of one run. A fault and its reason stay until a person's ``reset``."""

    def __init__(self) -> None:
        self.state: State = "idle"
        #: Reason of the fault, or of the last stop.
        self.why = ""
        self.entered_ns = 0

    @property
    def moving(self) -> bool:
        """Whether valves may move."""
        return self.state in MOVING

    def on(self, event: Event, now_ns: int, why: str = "") -> bool:
        """Apply ``event``; whether the state has changed. Events without a transition have no effect.

        A second fault does not replace the reason of the first.
        """
        found = TABLE.get((self.state, event))
        if found is None or found == self.state:
            return False
        self.state, self.entered_ns = found, now_ns
        if event in ("fault", "stop", "unhealthy"):
            self.why = why or event
        elif event in ("reset", "hold"):
            self.why = ""
        return True

    def demand(self, event: Event, now_ns: int) -> None:
        """Apply a person's event.

        Raises:
            InputError: there is no transition from the present state.
        """
        if not self.on(event, now_ns):
            possible = sorted(name for state, name in TABLE if state == self.state and name in (*PERSONAL, "stop"))
            found = f"{event!r} while {self.state}" + (f" ({self.why})" if self.state == "fault" else "")
            raise InputError("runner", found, " or ".join(possible) or "nothing: it must become ready by itself")
