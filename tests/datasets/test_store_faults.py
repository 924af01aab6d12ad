"""What goes wrong under a store: full and read-only disks, damaged files, two writers, kills. No half version, nothing lost."""

from __future__ import annotations

import errno
import io
import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.fs
import pytest
from killed import PRELOAD, killed_at_every_step
from stored import small_dataset

from sysid.datasets import Store, vacuum
from sysid.datasets.versions.files import LocalFiles, ObjectFiles
from sysid.datasets.versions.manifest import PartRecord, to_text
from sysid.errors import StorageError, StoreError

BETWEEN = multiprocessing.get_context("forkserver")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "ws")
    store.save(*small_dataset(1), PartRecord(1))
    return store


def files(store: Store) -> dict[str, bytes]:
    root = Path(store.workspace) / "datasets"
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


class FullFile(io.RawIOBase):
    """A file on a disk with room for so many bytes more."""

    def __init__(self, path: Path, room: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.file, self.room = path.open("xb"), room

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.room -= len(data)
        if self.room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), self.file.name)
        return self.file.write(data)

    def close(self) -> None:
        self.file.close()
        super().close()


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def full_delta(*_: object, **__: object) -> None:
    from deltalake.exceptions import DeltaError

    raise DeltaError("Generic LocalFileSystem error: Unable to copy data to file: No space left on device (os error 28)")


DISKS: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "no room at all": lambda m: m.setattr(LocalFiles, "create", lambda self, path: FullFile(self.folder / path, 0)),
    "room for some rows": lambda m: m.setattr(LocalFiles, "create", lambda self, path: FullFile(self.folder / path, 900)),
    "no room for the Delta log": lambda m: m.setattr("deltalake.convert_to_deltalake", full_delta),
    "no room when it is settled": lambda m: m.setattr("os.fsync", full),
    "no room for the manifest": lambda m: m.setattr(LocalFiles, "publish", full),
}


@pytest.mark.parametrize("work", ["save", "append"])
@pytest.mark.parametrize("disk", DISKS)
def test_a_full_disk_leaves_what_was_there_and_nothing_else(
    store: Store, monkeypatch: pytest.MonkeyPatch, disk: str, work: str
) -> None:
    before = files(store)

    def write() -> str:
        if work == "save":
            return store.save(*small_dataset(2), PartRecord(1)).reference
        return f"demo@{store.append('demo@1', *small_dataset(2, recordings=1), PartRecord(1))}"

    with monkeypatch.context() as patch:
        DISKS[disk](patch)
        message = "No space left on device.*no version was made, existing ones are complete.*Make room"
        with pytest.raises(StorageError, match=message):
            write()
    assert files(store) == before
    assert write() == "demo@2"


def _limited(workspace: Path) -> None:
    """A file may not grow beyond 2 kB: a real write that fails half-way."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
    try:
        Store(workspace).save(*small_dataset(2, rows=5000), PartRecord(1))
    except StorageError as error:
        os._exit(7 if "File too large" in str(error) else 1)


def test_a_write_that_the_system_cuts_off(store: Store) -> None:
    BETWEEN.set_forkserver_preload(PRELOAD)
    before = files(store)
    process = BETWEEN.Process(target=_limited, args=(store.workspace,))
    process.start()
    process.join()
    assert process.exitcode == 7
    assert files(store) == before


def _as_nobody(workspace: Path) -> None:
    import pyarrow.parquet  # noqa: F401  # whoever may not read the interpreter's folder cannot import any more

    if os.geteuid() == 0:
        os.setresuid(65534, 65534, 65534)
    store = Store(workspace)
    assert len(store.load("demo@1").recordings) == 2
    try:
        store.save(*small_dataset(2), PartRecord(1))
    except StorageError as error:
        told = "Permission denied" in str(error) and "Versions that are there can be read" in str(error)
        os._exit(7 if told else 1)


def test_a_workspace_that_may_only_be_read() -> None:
    place = Path(tempfile.mkdtemp())
    try:
        store = Store(place / "ws")
        store.save(*small_dataset(1), PartRecord(1))
        (place / "ws/datasets/demo/.lock").unlink(missing_ok=True)
        for path in (place, *place.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        before = files(store)
        BETWEEN.set_forkserver_preload(PRELOAD)
        process = BETWEEN.Process(target=_as_nobody, args=(place / "ws",))
        process.start()
        process.join()
        assert process.exitcode == 7
        assert files(store) == before
    finally:
        for path in (place, *place.rglob("*")):
            path.chmod(0o755)
        shutil.rmtree(place)


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "one bit": (flipped, "was changed after it was written"),
    "cut off": (lambda path: os.truncate(path, 100), "has 100 bytes"),
    "gone": (lambda path: path.unlink(), "is gone"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_tables_are_noticed_and_the_same_content_can_be_stored_again(store: Store, damage: str) -> None:
    spoil, message = DAMAGE[damage]
    store.append("demo@1", *small_dataset(2, recordings=1), PartRecord(1))
    manifest = store.manifest("demo@1")
    table, _ = sorted((Path(store.workspace) / manifest["parts"][0]["folder"] / "samples").glob("*.parquet"))
    spoil(table)
    for reference in ("demo@1", "demo@2"):
        with pytest.raises(StoreError, match=f"{reference}: samples: not readable.*{message}.*ingest the same logs again"):
            store.load(reference)
    again = store.save(*small_dataset(1), PartRecord(1))
    assert again.reference == "demo@3"
    assert store.load("demo@3").digest == store.manifest("demo@1")["digest"]
    assert len(store.channels("demo@1")) == 100, "what is whole of a damaged version can be read"


def test_a_cut_off_manifest_hides_one_version_alone(store: Store) -> None:
    store.save(*small_dataset(2), PartRecord(1))
    path = Path(store.workspace) / "datasets/demo/versions/000002.json"
    path.write_text(path.read_text()[:500])
    assert [(entry.reference, bool(entry.damage)) for entry in store.list()] == [("demo@1", False), ("demo@2", True)]
    with pytest.raises(StoreError, match=r"000002\.json: damaged.*The tables are untouched"):
        store.load("demo")
    assert len(store.load("demo@1").recordings) == 2
    assert store.save(*small_dataset(2), PartRecord(1)).reference == "demo@3"


def test_an_interrupt_after_the_version_is_visible_leaves_it_whole(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    publish = LocalFiles.publish

    def interrupted(self: LocalFiles, path: str, text: str) -> None:
        publish(self, path, text)
        raise KeyboardInterrupt

    monkeypatch.setattr(LocalFiles, "publish", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.save(*small_dataset(2), PartRecord(1))
    assert len(store.load("demo@2").recordings) == 2


def test_who_adds_to_the_newest_adds_to_the_newest(store: Store) -> None:
    """Two that read ``demo@1`` as the newest: the second would hide what the first added."""
    store.append("demo@1", *small_dataset(2, recordings=1), PartRecord(1), newest=True)
    before = files(store)
    with pytest.raises(StoreError, match=r"demo@2 was stored in the meantime; expected demo@1 to be the newest.*again"):
        store.append("demo@1", *small_dataset(3, recordings=1), PartRecord(1), newest=True)
    assert files(store) == before
    assert store.append("demo@1", *small_dataset(3, recordings=1), PartRecord(1)) == 3, "a number is what it says"


def test_a_version_that_is_gone_is_not_built_on(store: Store) -> None:
    vacuum(store, lambda reference, digest: (), ["demo@1"])
    for work in (
        lambda: store.append("demo@1", *small_dataset(2, recordings=1), PartRecord(1)),
        lambda: store.resplit("demo@1", {"s1-r0": "fit"}),
    ):
        with pytest.raises(StoreError, match="version 1 was removed by vacuum"):
            work()
    assert store.files.folders("datasets/demo/data") == []


def test_a_manifest_does_not_lead_out_of_its_dataset(store: Store) -> None:
    path = Path(store.workspace) / "datasets/demo/versions/000001.json"
    manifest = store.manifest("demo@1")
    manifest["parts"][0]["folder"] = "datasets/demo/data/../../../elsewhere"
    path.write_text(to_text(manifest))
    with pytest.raises(StoreError, match=r"names the folder .* which is not of this dataset"):
        store.load("demo@1")


def _append(workspace: Path) -> str:
    return f"demo@{Store(workspace).append('demo@1', *small_dataset(2, recordings=1), PartRecord(1))}"


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_an_append_killed_at_any_step_leaves_the_version_before(store: Store, every: int) -> None:
    before = files(store)
    seen = set()
    for _ in killed_at_every_step(_append, store.workspace, every=every):
        now = files(store)
        assert {name: now.get(name) for name in before} == before
        seen.add(tuple(entry.reference for entry in store.list()))
        assert all(store.load(entry.reference) for entry in store.list())
    assert ("demo@1",) in seen
    assert _append(Path(store.workspace)) == "demo@2"
    assert len(store.files.folders("datasets/demo/data")) == 2, "what the dead left is gone"


def _write(workspace: str, seed: int, start: Any, results: Any) -> None:
    dataset, channels = small_dataset(seed)
    start.wait()
    results.put((seed, Store(workspace).save(dataset, channels, PartRecord(1)).reference))


def test_a_folder_that_another_writer_makes_while_it_is_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrow finds no folder, looks whether it is there, and by then it is: an error that is none."""
    (tmp_path / "versions").mkdir()
    (tmp_path / "versions" / "000001.json").write_text("{}")
    files = ObjectFiles(f"file://{tmp_path}")
    system, root = pyarrow.fs.FileSystem.from_uri(files.url)
    looks = iter([FileNotFoundError(2, "Cannot list directory")])

    class Late:
        @staticmethod
        def from_uri(url: str) -> tuple[object, str]:
            return Late(), root

        def get_file_info(self, selector: object) -> object:
            for error in looks:
                raise error
            return system.get_file_info(selector)

    monkeypatch.setattr("pyarrow.fs.FileSystem", Late)
    assert files.names("versions") == ["000001.json"]
    assert files.names("nowhere") == []


@pytest.mark.parametrize("scheme", ["", "file://"])
def test_writers_at_once_get_a_number_each(tmp_path: Path, scheme: str) -> None:
    """Three contents, one of them twice; on the object store nothing is locked and numbers are claimed."""
    workspace = f"{scheme}{tmp_path}"
    BETWEEN.set_forkserver_preload(PRELOAD)
    seeds = (1, 2, 3, 3)
    start, results = BETWEEN.Barrier(len(seeds)), BETWEEN.Queue()
    writers = [BETWEEN.Process(target=_write, args=(workspace, seed, start, results)) for seed in seeds]
    for writer in writers:
        writer.start()
    told = [results.get(timeout=60) for _ in seeds]
    for writer in writers:
        writer.join()
    store = Store(workspace)
    by_reference = {entry.reference: entry.digest for entry in store.list()}
    assert {int(digest, 16) for digest in by_reference.values()} == {1, 2, 3}
    if not scheme:
        assert sorted(by_reference) == ["demo@1", "demo@2", "demo@3"]
    for seed, reference in told:
        assert int(by_reference[reference], 16) == seed, "the number a writer was given is its own"
        loaded = store.load(reference)
        for made in small_dataset(seed)[0].recordings:
            np.testing.assert_array_equal(loaded.recording(made.name).values("a.joint"), made.values("a.joint"))
