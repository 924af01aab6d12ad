"""The interface between runner and machine: newest readings, commands, and their clock."""

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
        measured_ns: time of the measurement if the machine states it, else of the arrival, on the transport's clock.
        received_ns: time of the arrival, on the transport's clock.
        count: number of values so far; constant without new values.
    """

    value: float
    measured_ns: int
    received_ns: int
    count: int


@dataclass(frozen=True, slots=True)
class MachineInputs:
    """Switches and faults of the machine.

    Args:
        dead_man: the dead-man switch is held.
        emergency_stop: the emergency stop is pressed.
        fault: of the machine or the line; "" without one.
    """

    dead_man: bool
    emergency_stop: bool
    fault: str = ""


#: The safe state of the switches, without a person.
RELEASED_INPUTS = MachineInputs(dead_man=False, emergency_stop=False)


class Transport(Protocol):
    """A connected machine. Valves are neutral without a recent ``write`` with ``enabled``."""

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
            InputError, SettingsError: no machine, or one that does not fit the settings.
        """
        ...

    def read(self) -> tuple[Mapping[str, Measurement], MachineInputs]:
        """Newest readings and inputs; never blocks. A signal without a value so far is missing."""
        ...

    def write(self, commands: Array, enabled: bool) -> Array:
        """Commands (axes,) in [-1, 1]; with ``enabled`` false the fail-safe state: valves neutral whatever the commands.

        Returns:
            The commands as the line carries them, (axes,): limited and rounded to its resolution; zeros while not enabled.

        Raises:
            OSError: they cannot be sent; the machine may not receive any further ones.
        """
        ...

    def close(self) -> None:
        """Set the machine to neutral and disconnect; may be called again."""
        ...

    def now_ns(self) -> int:
        """Monotonic clock of the loop; simulated for a simulated machine."""
        ...

    def wait_until(self, ns: int) -> None:
        """Return at ``ns`` on that clock, or at once if it is past; a simulated clock advances to it."""
        ...


@runtime_checkable
class Settable(Protocol):
    """A simulated machine, whose switches a program can set."""

    def set_inputs(self, dead_man: bool | None = None, emergency_stop: bool | None = None) -> None:
        """Set the dead-man switch and the emergency stop; None leaves them unchanged."""
        ...
