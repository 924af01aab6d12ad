"""Who arms, stops and resets: a person at a terminal, or, on machines without people, a script."""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Sequence
from typing import Protocol

from sysid.runner.cycle import State
from sysid.runner.transport import Settable

#: What may be said.
WORDS = ("arm", "disarm", "stop", "reset", "quit")


class Operator(Protocol):
    """Asked in every turn; never blocks."""

    #: Stays after a stop or a fault, for somebody to arm or reset; else the run is over then.
    stays: bool

    def words(self, state: State, now_ns: int) -> Sequence[str]:
        """What was said since the last turn."""
        ...

    def told(self, text: str) -> None:
        """One line for whoever stands there."""
        ...


class Terminal:
    """Lines of standard input."""

    stays = True

    def __init__(self) -> None:
        self._half = ""

    def words(self, state: State, now_ns: int) -> Sequence[str]:
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return ()
        fresh = os.read(sys.stdin.fileno(), 4096).decode("utf-8", "replace")
        if not fresh:
            return ("quit",)  # whoever could stop it is gone
        *lines, self._half = (self._half + fresh).split("\n")
        return [line.strip().lower() for line in lines if line.strip()]

    def told(self, text: str) -> None:
        sys.stderr.write(text + "\n")
        sys.stderr.flush()


class Unattended:
    """Arms a machine as soon as it is ready, and then holds its dead-man switch: for machines that nobody stands at.

    Args:
        machine: whose switches a program holds.
        script: (seconds since the first turn, word) to say besides.
    """

    stays = False

    def __init__(self, machine: Settable, script: Sequence[tuple[float, str]] = ()) -> None:
        self.machine = machine
        self._script = sorted(script)
        self._first_ns: int | None = None
        self._armed = False
        self.lines: list[str] = []

    def words(self, state: State, now_ns: int) -> Sequence[str]:
        if self._first_ns is None:
            self._first_ns = now_ns
            self.machine.set_inputs(dead_man=False)
        said = []
        while self._script and now_ns - self._first_ns >= 1e9 * self._script[0][0]:
            said.append(self._script.pop(0)[1])
        if state == "ready" and not self._armed:
            self._armed = True
            said.append("arm")
        elif state == "armed":
            self.machine.set_inputs(dead_man=True)
        return said

    def told(self, text: str) -> None:
        self.lines.append(text)


class Interruptible:
    """An operator, and Ctrl-C: the first one stops within the limits and ends the run, the second one ends it at once.

    Args:
        operator: who else is asked.
    """

    def __init__(self, operator: Operator) -> None:
        self.operator, self.stays = operator, operator.stays
        self._interrupted, self._said = False, False

    def words(self, state: State, now_ns: int) -> Sequence[str]:
        said = list(self.operator.words(state, now_ns))
        if self._interrupted and not self._said:
            self._said = True
            said.append("quit")
        return said

    def told(self, text: str) -> None:
        self.operator.told(text)

    def __enter__(self) -> Interruptible:
        self._before = signal.signal(signal.SIGINT, self._on)
        return self

    def __exit__(self, *error: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _on(self, number: int, frame: object) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True


class Nobody:
    """Says nothing: for runs that never move anything."""

    stays = False

    def words(self, state: State, now_ns: int) -> Sequence[str]:
        return ()

    def told(self, text: str) -> None:
        """Nobody listens."""
