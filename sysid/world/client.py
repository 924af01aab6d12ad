"""Import of PyBullet without its start-up output, and one client per world."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sysid.errors import SettingsError
from sysid.extras import install_remedy


def pybullet() -> Any:
    """The module, imported late.

    Raises:
        SettingsError: it is not installed.
    """
    if sys.modules.get("pybullet") is not None:
        return sys.modules["pybullet"]
    try:
        with _quiet():
            return importlib.import_module("pybullet")
    except ImportError:
        version = ".".join(str(n) for n in sys.version_info[:2])
        remedy = (
            f"With Python 3.11, {install_remedy('pybullet')} "
            "It has no builds for later ones: step the compiled plant without a world there."
        )
        raise SettingsError(
            "PyBullet world", f"pybullet is not installed (Python {version})", "pybullet 3.2.7", remedy
        ) from None


def connect(window: bool) -> int:
    """A new client.

    Raises:
        SettingsError: a window without a display, or no further client available.
    """
    p = pybullet()
    if window and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        # Without a display PyBullet would end the whole process.
        raise SettingsError("PyBullet world", "no display for a window", "DISPLAY", "Leave `window` out and take pictures.")
    client = int(p.connect(p.GUI if window else p.DIRECT))
    if client < 0:
        raise SettingsError("PyBullet world", "no further client", "worlds that are closed", "Use `with World(…) as world:`.")
    return client


def disconnect(client: int) -> None:
    """End a client; repeated calls have no effect."""
    p = pybullet()
    if p.isConnected(client):
        p.disconnect(client)


@contextmanager
def _quiet() -> Iterator[None]:
    """Redirect the start-up message that PyBullet prints in C."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        for number in (nowhere, *kept):
            os.close(number)
