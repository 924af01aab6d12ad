"""The list of versions: lines of an earlier list stand for manifests that are the same files, and for no others."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from stored import small_dataset

from sysid.datasets import Store
from sysid.datasets.versions import index
from sysid.datasets.versions.index import VersionIndex
from sysid.datasets.versions.manifest import PartRecord

MANIFEST = "datasets/demo/versions/000001.json"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(index, "TICK_NS", -1)
    return tmp_path / "cache/sysid/versions"


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the versions whose manifests are read."""
    found: list[int] = []
    original = VersionIndex.read_manifest

    def counted(self: VersionIndex, name: str, version: int, removed: bool = False) -> index.Manifest:
        found.append(version)
        return original(self, name, version, removed)

    monkeypatch.setattr(VersionIndex, "read_manifest", counted)
    return found


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """``demo@1`` and ``demo@2``."""
    store = Store(tmp_path / "ws")
    store.save(*small_dataset(1), PartRecord(1))
    store.save(*small_dataset(2), PartRecord(1))
    return tmp_path / "ws"


def test_a_manifest_is_read_once(workspace: Path, cache: Path, read: list[int]) -> None:
    first = VersionIndex(workspace).list()
    assert [entry.reference for entry in first] == ["demo@1", "demo@2"]
    assert VersionIndex(workspace).list() == first
    assert read == [1, 2]
    Store(workspace).save(*small_dataset(3), PartRecord(1))
    read.clear()
    assert [entry.version for entry in VersionIndex(workspace).list()] == [1, 2, 3]
    assert read == [3]


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("how", ["in place", "replaced"])
def test_a_changed_manifest_is_read_again(workspace: Path, how: str) -> None:
    """Also if its size and its time of change are as before."""
    VersionIndex(workspace).list()
    path = workspace / MANIFEST
    state, text = path.stat(), path.read_text()
    if how == "replaced":
        path.rename(path.with_suffix(".old"))
    path.write_text(text.replace('"rate_hz": ', '"rate_hz" :'))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert path.stat().st_size == state.st_size
    assert not VersionIndex(workspace).list()[0].damage, "other spaces are the same content"
    path.write_text(text.replace("demo", "omed"))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert "its seal does not fit" in VersionIndex(workspace).list()[0].damage


def test_a_damaged_one_is_never_kept(workspace: Path, cache: Path, read: list[int]) -> None:
    (workspace / MANIFEST).write_text("{}")
    for _ in range(2):
        assert VersionIndex(workspace).list()[0].damage
    assert read == [1, 2, 1]


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", "[[1]]", "[[[1],[2]]]", '[[[1, 2], ["demo", 1, 1, "", "", 0, 0.0, ""]]]', "[" * 100_000, "\0"]
)
def test_a_damaged_cache_is_not_used(workspace: Path, cache: Path, content: str) -> None:
    first = VersionIndex(workspace).list()
    (kept,) = cache.iterdir()
    kept.write_text(content)
    assert VersionIndex(workspace).list() == first


def test_a_cache_that_cannot_be_written_is_done_without(workspace: Path, cache: Path) -> None:
    cache.parent.parent.write_text("a file")
    assert len(VersionIndex(workspace).list()) == 2


def test_a_manifest_of_just_now_is_not_kept(
    workspace: Path, cache: Path, read: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may change again within a tick of the system's clock."""
    monkeypatch.setattr(index, "TICK_NS", 60_000_000_000)
    VersionIndex(workspace).list()
    VersionIndex(workspace).list()
    assert read == [1, 2, 1, 2]
