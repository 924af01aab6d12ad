"""Ctrl-C: acknowledged at once, and the process ends within a fixed time.

Python runs a signal handler in the main thread between two instructions, so that a long call of a compiled library, or the wait
for worker threads, would delay it. The wake-up descriptor of :mod:`signal` is written by the C handler itself; a thread reads
it, prints, and ends the process if the main thread has not ended it after :data:`GRACE_S`. Results are published by renaming
complete files, so that an end at any moment leaves nothing half-written (``tests/faults``).
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

from sysid.children import end_children

#: Exit status of an interrupted command (128 + SIGINT).
INTERRUPTED = 130
#: Time for the main thread to remove temporary files, write checkpoints and end [s].
GRACE_S = 1.0
STOPPING = b"sysid: stopping; press Ctrl-C again to end at once\n"
ENDED = b"sysid: interrupted; nothing half-written is visible; the command can be repeated\n"
#: Return to the start of the line and clear it: the terminal has printed ``^C`` there, or a progress bar is there.
_CLEAR = b"\r\x1b[K"

_active: Interruption | None = None


class Interruption:
    """Watches for SIGINT while it is open; only the handler that it installed counts."""

    def __init__(self) -> None:
        self.seen = threading.Event()
        self._first = threading.Lock()
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._wakeup_before = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        self._handler_before = signal.signal(signal.SIGINT, self._handle)
        self._closed = self._raised = False
        threading.Thread(target=self._watch, name="interruption", daemon=True).start()

    def close(self) -> None:
        """Restore the handler of before; after an interrupt the thread goes on, and ends the process if nothing else does."""
        if self._closed:
            return
        self._closed = True
        signal.signal(signal.SIGINT, self._handler_before)
        if not self.seen.is_set():
            signal.set_wakeup_fd(self._wakeup_before)
            os.close(self._writer)  # ends the thread

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.seen.is_set() and self._raised:
            end_now()
        self._raised = True
        self._acknowledge()
        raise KeyboardInterrupt

    def _acknowledge(self) -> None:
        """Print it once: in the main thread or in the other one, whichever runs first."""
        self.seen.set()
        if self._first.acquire(blocking=False):
            _say(STOPPING)

    def _watch(self) -> None:
        deadline: float | None = None
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            ready, _, _ = select.select([self._reader], [], [], left)
            if not ready:
                end_now()
            received = os.read(self._reader, 64)
            if not received:
                os.close(self._reader)
                return
            interrupts = received.count(signal.SIGINT) if self._owns_signal() else 0
            if interrupts and deadline is not None:
                end_now()
            if interrupts:
                self._acknowledge()
                deadline = time.monotonic() + GRACE_S
            if interrupts > 1:
                end_now()

    def _owns_signal(self) -> bool:
        """Whether nobody else has installed a handler, as the runner of a machine does; after an interrupt always."""
        return self.seen.is_set() or signal.getsignal(signal.SIGINT) == self._handle


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Within, SIGINT is acknowledged at once and ends the process in time; not where a program ignores or handles it itself."""
    global _active
    here = threading.current_thread() is threading.main_thread()
    if not here or _active is not None or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    _active = Interruption()
    try:
        yield
    finally:
        _active.close()
        _active = None


def leave_interrupts() -> None:
    """From here on SIGINT is handled as Python does: for a verb that has to end in its own way and time."""
    if _active is not None:
        _active.close()


def leave_interrupted() -> NoReturn:
    """End the process after a KeyboardInterrupt: of a SIGINT without waiting for threads that still compute."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    if _active is not None and _active.seen.is_set():
        end_now()
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(ENDED.decode())
    sys.exit(INTERRUPTED)


def end_now() -> NoReturn:
    """End this process and its children without unwinding."""
    _say(ENDED)
    end_children()
    os._exit(INTERRUPTED)


def _say(text: bytes) -> None:
    """Write to stderr below its buffers, which another thread may have locked."""
    with contextlib.suppress(OSError):
        os.write(2, (_CLEAR if os.isatty(2) else b"") + text)
