"""Which kind of storage a workspace lies on."""

from __future__ import annotations

from pathlib import Path

from sysid.datasets.versions.files import Files
from sysid.datasets.versions.local_files import LocalFiles
from sysid.datasets.versions.object_files import ObjectFiles


def open_files(workspace: str | Path) -> Files:
    """Files of a local workspace, or of an object store where ``workspace`` is a URL."""
    if "://" not in str(workspace):
        return LocalFiles(Path(workspace))
    return ObjectFiles(str(workspace).rstrip("/"))
