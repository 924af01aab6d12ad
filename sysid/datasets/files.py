"""The few file operations that the store needs, on a local folder and on an object store alike."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from sysid.errors import StoreError


class Files(Protocol):
    """Paths are relative to the workspace and use ``/``."""

    def uri(self, path: str) -> str: ...

    def names(self, folder: str) -> list[str]:
        """Names of the files in ``folder``, sorted; empty where there is none."""
        ...

    def folders(self, folder: str) -> list[str]:
        """Names of the folders in ``folder``, sorted."""
        ...

    def read(self, path: str) -> str: ...

    def publish(self, path: str, text: str) -> None:
        """Write a file that did not exist: whole, or not at all."""
        ...

    def remove(self, folder: str) -> None:
        """Remove ``folder`` with all it holds, if it is there."""
        ...

    def lock(self, folder: str) -> Any:
        """A context that one writer at a time can enter."""
        ...


def open_files(workspace: str | Path) -> Files:
    """Files of a local workspace, or of an object store where ``workspace`` is a URL."""
    if "://" not in str(workspace):
        return LocalFiles(Path(workspace))
    return ObjectFiles(str(workspace).rstrip("/"))


@dataclass(frozen=True)
class LocalFiles:
    """A folder on this machine."""

    root: Path

    def uri(self, path: str) -> str:
        return str((self.root / path).resolve())

    def names(self, folder: str) -> list[str]:
        place = self.root / folder
        return sorted(entry.name for entry in place.iterdir() if entry.is_file()) if place.is_dir() else []

    def folders(self, folder: str) -> list[str]:
        place = self.root / folder
        return sorted(entry.name for entry in place.iterdir() if entry.is_dir()) if place.is_dir() else []

    def read(self, path: str) -> str:
        return (self.root / path).read_text("utf-8")

    def publish(self, path: str, text: str) -> None:
        final = self.root / path
        final.parent.mkdir(parents=True, exist_ok=True)
        draft = final.parent / f".{final.name}.{uuid.uuid4().hex}"
        with draft.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(draft, final)  # unlike a rename it fails where another writer was first
        except FileExistsError:
            raise StoreError(final, "another writer has just published this version", remedy="Run the command again.") from None
        finally:
            draft.unlink()

    def remove(self, folder: str) -> None:
        shutil.rmtree(self.root / folder, ignore_errors=True)

    @contextmanager
    def lock(self, folder: str) -> Iterator[None]:
        from filelock import FileLock, Timeout

        place = self.root / folder
        place.mkdir(parents=True, exist_ok=True)
        try:
            with FileLock(place / ".lock", timeout=300):
                yield
        except Timeout:
            raise StoreError(place, "locked by another process for five minutes", remedy="Wait for it, or end it.") from None


@dataclass(frozen=True)
class ObjectFiles:
    """An object store. A put is atomic there; two writers of one dataset at once are not kept apart, so let one write."""

    url: str

    def _open(self) -> tuple[Any, str]:
        from pyarrow.fs import FileSystem

        system, root = FileSystem.from_uri(self.url)
        return system, str(root).rstrip("/")

    def uri(self, path: str) -> str:
        return f"{self.url}/{path}"

    def _entries(self, folder: str, kind: str) -> list[str]:
        from pyarrow.fs import FileSelector

        system, root = self._open()
        selector = FileSelector(f"{root}/{folder}", allow_not_found=True)
        return sorted(entry.base_name for entry in system.get_file_info(selector) if entry.type.name == kind)

    def names(self, folder: str) -> list[str]:
        return self._entries(folder, "File")

    def folders(self, folder: str) -> list[str]:
        return self._entries(folder, "Directory")

    def read(self, path: str) -> str:
        system, root = self._open()
        with system.open_input_stream(f"{root}/{path}") as file:
            return bytes(file.read()).decode("utf-8")

    def publish(self, path: str, text: str) -> None:
        system, root = self._open()
        final = f"{root}/{path}"
        if system.get_file_info(final).type.name == "File":
            raise StoreError(self.uri(path), "another writer has just published this version", remedy="Run the command again.")
        system.create_dir(final.rpartition("/")[0], recursive=True)
        with system.open_output_stream(final) as file:
            file.write(text.encode("utf-8"))

    def remove(self, folder: str) -> None:
        system, root = self._open()
        if system.get_file_info(f"{root}/{folder}").type.name == "Directory":
            system.delete_dir(f"{root}/{folder}")

    @contextmanager
    def lock(self, folder: str) -> Iterator[None]:
        yield
