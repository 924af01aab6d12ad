"""Work for another process that loads nothing heavy."""

from __future__ import annotations

from sysid.errors import SettingsError
from sysid.progress import Progress


def squared(number: int, progress: Progress) -> int:
    if number == 1:
        raise SettingsError("seed 1", "failed", "luck")
    progress(0.5, "half")
    return number**2
