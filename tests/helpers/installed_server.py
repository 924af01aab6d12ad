"""Commands of servers that are installed in an environment of their own by a target of `make`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def server_command(package: str, variable: str, place: str, target: str) -> str:
    """The command that ``variable`` names, or that in ``place`` of the checkout, where `make TARGET` installs it.

    Raises:
        Skipped: ``package`` is not installed.
    """
    installed = ROOT / place
    found = os.environ.get(variable) or (str(installed) if installed.exists() else None)
    if found is None:
        name = installed.name
        pytest.skip(f"{package} is not installed: `make {target}` installs it, or name its {name} in {variable}")
    return found
