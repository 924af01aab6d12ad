"""A copy of a package in which model files can be edited, so that relative paths keep their meaning."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Mirror:
    """``root``: the folder of a package; ``copy``: its mirror of hard links; edited files are files of their own."""

    root: Path
    copy: Path

    def editable(self, file: str) -> Path:
        """The path of a file of the package in the mirror, where it may be written."""
        if not self.copy.exists():
            shutil.copytree(self.root.resolve(), self.copy, copy_function=os.link)
        place = self.copy / file
        if place.stat().st_nlink > 1:
            place.unlink()
            shutil.copyfile(self.root / file, place)
        return place
