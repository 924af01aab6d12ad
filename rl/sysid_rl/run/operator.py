"""The operator, who arms, stops and resets: a person at a terminal, or a program on simulated machines."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Sequence
from types import FrameType
from typing import Any, Protocol

from sysid_rl.run.cycle import State
from sysid_rl.run.transport import Settable

#: ``quit`` stops within the limits and ends the run; ``abort`` ends it with neutral valves at once.
OPERATOR_COMMANDS = ("arm", "disarm", "stop", "reset", "quit", "abort")
#: Signals that act as ``quit``: a process that moves a machine must not be ended or suspended in any other way.
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGXCPU", "SIGUSR1", "SIGUSR2", "SIGALRM")
#: Ignored: reading a terminal in the background is then an error and does not suspend the process.
IGNORED = ("SIGTTIN", "SIGTTOU", "SIGPIPE", "SIGXFSZ")


class Operator(Protocol):
    """Polled in every cycle; no method may wait for a person, a terminal or a file."""

    #: Whether the run continues after a stop or a fault, until the operator arms or resets.
    stays: bool

    def commands(self, state: State, now_ns: int) -> Sequence[str]:
        """Commands since the last cycle, of :data:`OPERATOR_COMMANDS`; a reason may follow after a colon."""
        ...

    def notify(self, text: str) -> None:
        """Show one line."""
        ...


class Unattended:
    """Arms a simulated machine as soon as it is ready, and then holds its dead-man switch.

    Args:
        machine: with switches that a program can set.
        script: further commands, (seconds since the first cycle, command).
    """

    stays = False

    def __init__(self, machine: Settable, script: Sequence[tuple[float, str]] = ()) -> None:
        self.machine = machine
        self._script = sorted(script)
        self._first_ns: int | None = None
        self._armed = False
        self.lines: list[str] = []

    def commands(self, state: State, now_ns: int) -> Sequence[str]:
        if self._first_ns is None:
            self._first_ns = now_ns
            self.machine.set_inputs(dead_man=False)
        commands = []
        while self._script and now_ns - self._first_ns >= 1e9 * self._script[0][0]:
            commands.append(self._script.pop(0)[1])
        if state == "ready" and not self._armed:
            self._armed = True
            commands.append("arm")
        elif state == "armed":
            self.machine.set_inputs(dead_man=True)
        return commands

    def notify(self, text: str) -> None:
        self.lines.append(text)


class Interruptible:
    """An operator with signal handling: the first signal is ``quit``, the second one ``abort``.

    A third one raises KeyboardInterrupt, for a loop that does not continue. A context manager.

    Args:
        operator: for all other commands.
    """

    def __init__(self, operator: Operator) -> None:
        self.operator, self.stays = operator, operator.stays
        self._came: list[str] = []
        self._said = 0
        self._before: dict[int, Any] = {}

    def commands(self, state: State, now_ns: int) -> Sequence[str]:
        commands = list(self.operator.commands(state, now_ns))
        for name in self._came[self._said :]:
            commands.append(f"{'quit' if self._said == 0 else 'abort'}: {name}")
            self._said += 1
        return commands

    def notify(self, text: str) -> None:
        self.operator.notify(text)

    def __enter__(self) -> Interruptible:
        # Signals that this system does not have, or that cannot be handled, are skipped.
        for names, handler in ((SIGNALS, self._on), (IGNORED, signal.SIG_IGN)):
            for name in names:
                number = getattr(signal, name, None)
                if number is not None:
                    with contextlib.suppress(OSError, ValueError):
                        self._before[number] = signal.signal(number, handler)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    def _on(self, number: int, frame: FrameType | None) -> None:
        self._came.append(signal.Signals(number).name)
        if len(self._came) > 2:
            raise KeyboardInterrupt
