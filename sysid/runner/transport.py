"""What connects the runner to a machine: newest readings in, commands out, and the clock that both go by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measurement:
    """The newest value of one signal.

    Args:
        value: SI.
        measured_ns: when it was measured, on the machine's clock where the machine says so; else when it came.
        received_ns: when the runner got it, on the transport's clock.
        count: how many came so far; one that stands still says that nothing comes any more.
    """

    value: float
    measured_ns: int
    received_ns: int
    count: int


@dataclass(frozen=True, slots=True)
class MachineInputs:
    """What a person, or the machine itself, says besides signals.

    Args:
        dead_man: somebody holds the dead-man switch.
        emergency_stop: the emergency stop is pressed.
        fault: what the machine's side or the line to it reports; "" where all is well.
    """

    dead_man: bool
    emergency_stop: bool
    fault: str = ""


#: Nobody there: as safe as it gets.
RELEASED_INPUTS = MachineInputs(dead_man=False, emergency_stop=False)


class Transport(Protocol):
    """A machine within reach. Valves are neutral unless a fresh ``write`` with ``enabled`` says otherwise."""

    @property
    def signals(self) -> tuple[str, ...]:
        """Canonical names of the signals that are read."""
        ...

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes in the order of commands."""
        ...

    def open(self) -> None:
        """Connect.

        Raises:
            InputError, SettingsError: no such machine, or it speaks another language.
        """
        ...

    def read(self) -> tuple[Mapping[str, Measurement], MachineInputs]:
        """Newest readings and inputs; never blocks. A signal of which nothing came yet is missing."""
        ...

    def write(self, commands: Array, enabled: bool) -> None:
        """Commands (axes,) in [-1, 1]; with ``enabled`` false the fail-safe state: valves neutral whatever the commands.

        Raises:
            OSError: they cannot be sent. Whoever called has to take it that the machine does not hear him any more.
        """
        ...

    def close(self) -> None:
        """Leave the machine neutral and let go of it; may be called again."""
        ...

    def now_ns(self) -> int:
        """Monotonic clock of the loop; the simulated clock for a machine in process."""
        ...

    def wait_until(self, ns: int) -> None:
        """Return at ``ns`` on that clock, or at once where it is past; a simulated clock is brought there."""
        ...


@runtime_checkable
class Settable(Protocol):
    """A machine without people at it, whose switches a program holds: simulations."""

    def set_inputs(self, dead_man: bool | None = None, emergency_stop: bool | None = None) -> None:
        """Hold or release the dead-man switch, press or release the emergency stop; None leaves it."""
        ...
