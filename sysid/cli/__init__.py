"""The command line: one verb a file, each loaded when it is called."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from sysid.cli.interruption import interruptible, leave_interrupted

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit.

    Exit status: 0 done, 1 the computer failed (disk full, no permission), 2 a mistake of the user, 130 interrupted.
    """
    with interruptible():
        try:
            from sysid.cli.app import run_verb

            run_verb(argv)
        except KeyboardInterrupt:
            leave_interrupted()
