"""Real-time settings of the operating system; the loop also runs without those that are refused."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Iterator

_CURRENT, _FUTURE = 1, 2
#: Switch interval of the interpreter between threads [s].
_SWITCH = 0.0005


@contextlib.contextmanager
def real_time(priority: int, lock: bool) -> Iterator[tuple[str, ...]]:
    """Real-time priority (SCHED_FIFO), locked memory and no garbage collection inside the context.

    Other threads of this process hold the interpreter for at most half a millisecond while the loop waits for it.

    Args:
        priority: 1 … 99; 0: not requested.
        lock: request locked memory.

    Yields:
        Refusals, one sentence each.
    """
    refused: list[str] = []
    scheduled = priority > 0 and _request_priority(priority, refused)
    locked = lock and _lock_memory(refused)
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    switch = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    try:
        yield tuple(refused)
    finally:
        sys.setswitchinterval(switch)
        gc.unfreeze()
        if collecting:
            gc.enable()
        if locked:
            ctypes.CDLL(None, use_errno=True).munlockall()
        if scheduled:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _request_priority(priority: int, refused: list[str]) -> bool:
    if not hasattr(os, "sched_setscheduler"):
        refused.append("real-time priority: this system has no SCHED_FIFO")
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        refused.append(f"real-time priority was refused ({error.strerror}): other processes can delay the loop; allow rtprio")
        return False
    return True


def _lock_memory(refused: list[str]) -> bool:
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "mlockall"):
        refused.append("locked memory: this system has no mlockall")
        return False
    if libc.mlockall(_CURRENT | _FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        refused.append(f"locked memory was refused ({reason}): a page fault can delay the loop; allow memlock")
        return False
    return True


def prioritise_thread(native_id: int | None, priority: int) -> None:
    """Give a thread that the loop waits for real-time priority just below the loop's, if permitted."""
    if native_id is not None and priority > 1 and hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(native_id, os.SCHED_FIFO, os.sched_param(priority - 1))
