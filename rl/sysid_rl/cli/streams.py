"""Standard streams of a process that moves a machine: open from the start, and no reason to stop where a reader has gone."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator


def open_standard_streams() -> None:
    """Open closed standard streams on the null device; else a device would get their descriptor and receive printed text."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - as long as the process


@contextlib.contextmanager
def closed_stdout_ignored(ignore: bool = True) -> Iterator[None]:
    """Printing within to a closed stdout does not change the exit status, unless ``ignore`` is false."""
    try:
        yield
        sys.stdout.flush()
    except (OSError, SystemExit):  # rich raises SystemExit on a broken pipe
        if not ignore:
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
                continue
            with contextlib.suppress(OSError, ValueError):
                os.dup2(nowhere, stream.fileno())
