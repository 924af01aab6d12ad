"""The command line in this process."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.cli import main


def run(*args: str | Path) -> int:
    """Exit status of ``sysid ARGS``."""
    with pytest.raises(SystemExit) as stop:
        main([str(arg) for arg in args])
    assert isinstance(stop.value.code, int)
    return stop.value.code
