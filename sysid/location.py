"""The location of a workspace (a folder, or the URL of an object store for its datasets), and that of the user's cache."""

from __future__ import annotations

import os
from pathlib import Path

from sysid.errors import SettingsError

#: Folder of models and results where the datasets are in an object store.
LOCAL = Path("./workspace")


def default_location() -> str:
    """The location of the workspace that is not named: ``SYSID_WORKSPACE``, else ``./workspace``."""
    return os.environ.get("SYSID_WORKSPACE", "./workspace")


def checked_location(location: str | os.PathLike[str]) -> str:
    """``location`` as text; the folder need not exist.

    Raises:
        SettingsError: it is a file.
    """
    text = os.fspath(location)
    if "://" not in text and Path(text).exists() and not Path(text).is_dir():
        raise SettingsError(f"--workspace {text}", "is a file", "a folder")
    return text


def local_folder(location: str | os.PathLike[str], local: Path = LOCAL) -> Path:
    """The folder of models, results and reports: ``local`` where ``location`` is a URL."""
    return local if "://" in os.fspath(location) else Path(location)


def absolute_location(location: str | os.PathLike[str]) -> str:
    """``location`` for processes with another current folder."""
    text = os.fspath(location)
    return text if "://" in text else str(Path(text).absolute())


def cache_home() -> Path:
    """The folder of files that save computation and may be deleted at any time; it need not exist."""
    return Path(os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache") / "sysid"
