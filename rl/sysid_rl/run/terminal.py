"""The terminal of the runner: threads read and write, so that a stopped, slow or closed terminal does not delay the loop.

A terminal may stop its output for any time (Ctrl-S, a frozen ssh). Lines wait in a queue; lines beyond its capacity are counted
and lost. The end of the terminal (end of file, an error) ends the run.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
import threading
from collections.abc import Iterator, Sequence
from queue import Empty, SimpleQueue

from sysid_rl.run.cycle import State

#: Most waiting lines.
WAITING = 2000
#: Longest wait for the last lines at the end of a run [s].
FLUSH_S = 1.0
#: Longest typed line [characters].
LONGEST = 256


class Console:
    """Writes to a file descriptor in a thread; :meth:`write` never waits.

    Args:
        descriptor: of the terminal, pipe or file; standard error by default.
    """

    def __init__(self, descriptor: int = 2) -> None:
        self._descriptor = descriptor
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        #: The error that ended the writing, or ""; number of lost lines.
        self.error, self.lost = "", 0
        self._thread = threading.Thread(target=self._write, name="console", daemon=True)
        self._thread.start()

    def write(self, text: str) -> None:
        """Queue ``text`` unchanged."""
        if self.error or self._queue.qsize() >= WAITING:
            self.lost += 1
        else:
            self._queue.put(text)

    def close(self) -> None:
        """Wait for the queue, at most :data:`FLUSH_S`. May be called again."""
        self._queue.put(None)
        self._thread.join(FLUSH_S)

    def _write(self) -> None:
        while (text := self._queue.get()) is not None:
            data = text.encode("utf-8", "replace")
            while data:
                try:
                    data = data[os.write(self._descriptor, data) :]
                except BlockingIOError:  # a shell has made it non-blocking
                    select.select([], [self._descriptor], [], 1.0)
                except OSError as error:
                    self.error = error.strerror or str(error)
                    return


class _Stream(io.TextIOBase):
    """Output of libraries, written to a console."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        self._console.write(text)
        return len(text)


@contextlib.contextmanager
def redirected_output(console: Console) -> Iterator[None]:
    """Redirect ``sys.stdout`` and ``sys.stderr`` to ``console``, so that output of libraries does not wait for a terminal."""
    stream = _Stream(console)
    with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
        yield


class Terminal:
    """An operator at a terminal.

    Args:
        console: for output.
        descriptor: for input, standard input by default.
    """

    stays = True

    def __init__(self, console: Console, descriptor: int = 0) -> None:
        self.console, self._descriptor = console, descriptor
        self._typed: SimpleQueue[str] = SimpleQueue()
        self._left = False
        threading.Thread(target=self._read, name="terminal", daemon=True).start()

    def commands(self, state: State, now_ns: int) -> Sequence[str]:
        commands: list[str] = []
        with contextlib.suppress(Empty):
            while len(commands) < 16:
                commands.append(self._typed.get_nowait())
        if self.console.error and not self._left:
            self._left = True
            commands.append(f"quit: the terminal is closed ({self.console.error})")
        return commands

    def notify(self, text: str) -> None:
        self.console.write(text + "\n")

    def _read(self) -> None:
        half, why = "", "end of file"
        while True:
            try:
                fresh = os.read(self._descriptor, 4096).decode("utf-8", "replace")
            except BlockingIOError:  # a shell has made it non-blocking
                select.select([self._descriptor], [], [], 1.0)
                continue
            except OSError as error:
                why, fresh = error.strerror or str(error), ""
            if not fresh:
                break
            *lines, half = (half + fresh).split("\n")
            half = half[-LONGEST:]
            for line in lines:
                if (word := line.strip().lower()) and self._typed.qsize() < WAITING:
                    self._typed.put(word[:LONGEST])
        # Without input nobody can stop the run.
        self._typed.put(f"quit: the terminal is closed ({why})")
