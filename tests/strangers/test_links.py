"""A workspace from a stranger with links in it: nothing outside is read, written, listed or deleted."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
from sample_crane import sample_dataset, sample_gap
from stored import small_dataset

from sysid.datasets import Dataset, Store, vacuum
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import StoreError
from sysid.gap.stored_result import load_gap, save_gap
from sysid.registry import Registry
from sysid.registry.artifacts import FolderArtifacts
from sysid.registry.stored import Record
from sysid.root import Root
from sysid.workspace import Workspace

MADE = PartRecord(1)


def nobody(reference: str, digest: str) -> Sequence[str]:
    return ()


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """Somebody's own files: all that a dataset folder could be taken for."""
    folder = tmp_path / "outside"
    for name in ("data/photos", "versions", "photos", "demo/data/photos", "demo/versions"):
        (folder / name).mkdir(parents=True)
        (folder / name / "one.jpg").write_bytes(b"mine")
        (folder / name / ".hidden").write_bytes(b"mine")
    return folder


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    Store(tmp_path / "ws").save(*small_dataset(1), MADE)
    return tmp_path / "ws"


#: Path of the link in the workspace → what it leads to outside.
LAYOUTS = {
    "datasets": "",
    "datasets/other": "demo",
    "datasets/demo/data": "data",
    "datasets/demo/versions": "versions",
    "datasets/demo/data/0123456789abcdef-dead": "photos",
    "datasets/demo/versions/.000009.json.abc": "photos/one.jpg",
}


@pytest.mark.parametrize("scheme", ["", "file://"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_vacuum_follows_no_link(workspace: Path, outside: Path, layout: str, scheme: str) -> None:
    link = workspace / layout
    if link.exists():
        shutil.rmtree(link)
    link.symlink_to(outside / LAYOUTS[layout])
    before = tree(outside)
    os.utime(outside / "data/photos/one.jpg", (0, 0))  # old enough for a store without locks
    try:
        done = vacuum(Store(f"{scheme}{workspace}"), nobody)
        told = [item.what for item in done.kept if "is a link" in item.reason]
    except StoreError as error:
        told = [str(error)]
    assert tree(outside) == before
    assert link.is_symlink()
    assert any(layout in text for text in told), "who looks is told of the link"


def test_a_linked_folder_is_a_row_of_the_list(workspace: Path, outside: Path) -> None:
    (workspace / "datasets/other").symlink_to(outside / "demo")
    (workspace / "datasets/third").mkdir()
    (workspace / "datasets/third/versions").symlink_to(outside / "versions")
    rows = {entry.reference: entry.damage for entry in Store(workspace).list()}
    assert rows["demo@1"] == ""
    assert "is a link" in rows["other@0"]
    assert "is a link" in rows["third@0"]


@pytest.mark.parametrize("name", ["000002.json", "data"])
def test_a_linked_manifest_or_table_is_not_read(workspace: Path, tmp_path: Path, name: str) -> None:
    store = Store(workspace)
    versions = workspace / "datasets/demo/versions"
    if name == "data":
        shutil.move(workspace / "datasets/demo/data", tmp_path / "elsewhere")
        (workspace / "datasets/demo/data").symlink_to(tmp_path / "elsewhere")
        with pytest.raises(StoreError, match="is a link"):
            store.load("demo@1")
    else:
        shutil.copy(versions / "000001.json", tmp_path / "copy.json")
        (versions / name).symlink_to(tmp_path / "copy.json")
        assert store.versions("demo") == [1]


def test_a_lock_that_is_a_link_empties_no_file(workspace: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    lock = workspace / "datasets/demo/.lock"
    lock.unlink(missing_ok=True)
    lock.symlink_to(mine)
    (workspace / "registry.lock").symlink_to(mine)
    with pytest.raises(StoreError, match="is a link"):
        Store(workspace).save(*small_dataset(2), MADE)
    with pytest.raises(StoreError, match="is a link"):
        Registry(workspace).register("a", "plant", {"plant.json": b"{}"}, {})
    assert mine.read_text() == "mine"


@pytest.mark.parametrize(
    "link", ["results", "results/demo@1", "results/demo@1/report.html", "curves", "exports", "cards", "site"]
)
def test_nothing_is_written_through_a_link(workspace: Path, outside: Path, link: str) -> None:
    place = Workspace(workspace)
    path = workspace / link
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(outside / "photos/one.jpg" if path.suffix else outside)
    before = tree(outside)
    dataset = Store(workspace).load("demo")
    with pytest.raises(StoreError, match="is a link"):
        place.output("report.html", dataset) if link.startswith("results") else place.output(
            link if path.suffix else f"{link}/x.html"
        )
    assert tree(outside) == before


def test_artifacts_are_not_written_or_cleared_through_a_link(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "ws").mkdir()
    (outside / ".partial-1").mkdir()
    (tmp_path / "ws/models").symlink_to(outside)
    before = {*outside.rglob("*")}
    with pytest.raises(StoreError, match="is a link"):
        FolderArtifacts(tmp_path / "ws/models").write("ab", {"plant.json": b"{}"}, "{}", Record("a", 1, 0, "{}"))
    assert {*outside.rglob("*")} == before


@pytest.fixture(scope="module")
def crane() -> Dataset:
    return sample_dataset()


@pytest.mark.parametrize("link", ["gap", "gap.next", ".gap.part", ".gap.lock"])
def test_a_gap_result_is_not_filed_through_a_link(crane: Dataset, tmp_path: Path, outside: Path, link: str) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / link).symlink_to(outside / "photos/one.jpg" if link == ".gap.lock" else outside)
    before = tree(outside)
    with pytest.raises(StoreError, match="is a link"):
        save_gap(tmp_path / "results/gap", sample_gap(crane))
    assert tree(outside) == before


@pytest.mark.parametrize("name", ["result.json", "traces.parquet", "seal.json"])
def test_a_gap_result_is_not_read_through_a_link(crane: Dataset, tmp_path: Path, name: str) -> None:
    save_gap(tmp_path / "gap", sample_gap(crane))
    path = tmp_path / "gap" / name
    path.rename(tmp_path / name)
    path.symlink_to(tmp_path / name)
    with pytest.raises(StoreError, match=f"{name}: is a link"):
        load_gap(tmp_path / "gap")


@pytest.mark.parametrize("link", ["registry.db", "registry.lock", "models"])
def test_a_registry_is_not_read_or_written_through_a_link(tmp_path: Path, link: str) -> None:
    place = tmp_path / "ws"
    Registry(place).register("arm", "plant", {"plant.json": b"{}"}, {})
    (place / link).rename(tmp_path / link)
    (place / link).symlink_to(tmp_path / link)
    content = (tmp_path / "registry.db").read_bytes() if link == "registry.db" else b""
    for work in (
        lambda: Registry(place).register("arm", "plant", {"plant.json": b"[]"}, {}),
        lambda: Registry(place).repair() if link != "models" else Registry(place).load("arm"),
    ):
        with pytest.raises(StoreError, match="is a link"):
            work()
    assert link != "registry.db" or (tmp_path / link).read_bytes() == content


@pytest.mark.parametrize("path", ["../mine", "a/../../mine", "/etc/passwd", "a//b", "./a", "a\0b"])
def test_a_path_that_leaves_the_root_is_refused(tmp_path: Path, path: str) -> None:
    root = Root(tmp_path / "ws")
    root.make("a")
    (tmp_path / "mine").write_text("mine")
    for work in (root.read, root.create, root.remove, root.path, root.output, root.make, lambda p: root.write(p, b"x")):
        with pytest.raises(StoreError, match="leaves it; expected a path inside it"):
            work(path)
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_root_writes_reads_lists_and_removes(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "ws").symlink_to(tmp_path / "real")  # the root itself was named by whoever runs the command
    root = Root(tmp_path / "ws")
    root.write("a/b/one.txt", b"1")
    root.write("a/b/one.txt", b"22")
    assert root.read("a/b/one.txt") == b"22"
    assert root.entries("a/b") == {"one.txt": "file"}
    assert root.weight("a")[0] == 2
    with pytest.raises(FileExistsError):
        root.create("a/b/one.txt")
    with pytest.raises(FileNotFoundError) as missing:
        root.read("a/b/two.txt")
    assert missing.value.filename == str(tmp_path / "ws/a/b/two.txt")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/keep").write_text("mine")
    (tmp_path / "ws/a/link").symlink_to(tmp_path / "mine")
    root.settle("a")
    root.remove("a")
    assert root.kind("a") is None
    assert (tmp_path / "mine/keep").read_text() == "mine", "a link inside goes, what it leads to stays"


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StoreError, match="is no regular file"):
        Root(tmp_path).read("pipe")
