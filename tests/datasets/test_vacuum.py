"""Vacuum: what it removes, what it never removes, and what a kill in between leaves."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
from killed import killed_at_every_step
from stored import small_dataset

from sysid.datasets import Store, lineage, vacuum
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import SettingsError, StoreError


def nobody(reference: str, digest: str) -> Sequence[str]:
    return ()


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """``demo@1``, ``demo@2`` (1 and one recording more), ``demo@3`` of its own, and tables that no version names."""
    store = Store(tmp_path / "ws")
    store.save(*small_dataset(1), PartRecord(1))
    store.append("demo@1", *small_dataset(2, recordings=1), PartRecord(1))
    store.save(*small_dataset(3), PartRecord(1))
    data = tmp_path / "ws/datasets/demo/data"
    shutil.copytree(next(data.iterdir()), data / "0123456789abcdef-dead")
    (tmp_path / "ws/datasets/demo/versions/.000004.json.abc").write_text("half")
    return store


def folders(store: Store) -> set[str]:
    return set(store.files.folders("datasets/demo/data"))


def test_left_overs_go_and_versions_stay(store: Store) -> None:
    before = folders(store)
    looked = vacuum(store, nobody, dry_run=True)
    assert folders(store) == before
    assert {item.what.rpartition("/")[2] for item in looked.removed} == {"0123456789abcdef-dead", ".000004.json.abc"}
    done = vacuum(store, nobody)
    assert done.removed == looked.removed
    assert done.size > 1000
    assert folders(store) == before - {"0123456789abcdef-dead"}
    assert [entry.reference for entry in store.list()] == ["demo@1", "demo@2", "demo@3"]
    assert vacuum(store, nobody).removed == ()


def test_a_named_version_goes_and_its_number_is_not_given_again(store: Store) -> None:
    vacuum(store, nobody, ["demo@3"])
    assert [entry.reference for entry in store.list()] == ["demo@1", "demo@2"]
    with pytest.raises(
        StoreError, match=r"version 3 was removed by vacuum; expected one of: 1, 2\. Ingest the same logs again"
    ):
        store.load("demo@3")
    assert store.save(*small_dataset(3), PartRecord(1)).reference == "demo@4"


def test_tables_that_another_version_needs_stay(store: Store) -> None:
    done = vacuum(store, nobody, ["demo@1"])
    assert done.removed[0].size == 0, "its tables are those of demo@2 as well"
    assert len(store.load("demo@2").recordings) == 3
    (step,) = lineage(store, "demo@2").steps
    assert (step.reference, step.there) == ("demo@1", False)
    assert vacuum(store, nobody, ["demo@2"]).size > 0
    assert len(folders(store)) == 1


def test_the_newest_stay(store: Store) -> None:
    vacuum(store, nobody, keep=1)
    assert [entry.reference for entry in store.list()] == ["demo@3"]
    assert len(folders(store)) == 1
    with pytest.raises(SettingsError, match="keep: 0; expected at least 1"):
        vacuum(store, nobody, keep=0)
    vacuum(store, nobody, ["demo@3"])
    with pytest.raises(StoreError, match="no version ''; expected one of: none is left"):
        store.load("demo")


def test_what_has_users_stays(store: Store) -> None:
    digest = store.load("demo@1").digest
    done = vacuum(store, lambda reference, own: ["plant a@1", "actuator b@2"] if own == digest else [], keep=1)
    assert [entry.reference for entry in store.list()] == ["demo@1", "demo@3"]
    assert [(kept.what, kept.reason) for kept in done.kept] == [("demo@1", "plant a@1, actuator b@2 was made from it")]
    assert len(store.load("demo@1").recordings) == 2


def test_nothing_goes_where_a_manifest_cannot_be_read(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "ws/datasets/demo/versions/000003.json"
    path.write_text(path.read_text()[:200])
    before = folders(store)
    done = vacuum(store, nobody, keep=2)
    assert folders(store) == before
    assert any("cannot be read, and may refer to data" in kept.reason for kept in done.kept)
    assert [entry.damage[:6] for entry in store.list()] == ["", "datase"], "demo@1 went, its tables are those of demo@2"
    vacuum(store, nobody, ["demo@3"])
    assert len(folders(store)) == 2


def test_where_nothing_is_locked_young_tables_stay(tmp_path: Path) -> None:
    (tmp_path / "bucket").mkdir()
    store = Store(f"file://{tmp_path}/bucket")
    store.save(*small_dataset(1), PartRecord(1))
    data = tmp_path / "bucket/datasets/demo/data"
    shutil.copytree(next(data.iterdir()), data / "half")
    done = vacuum(store, nobody)
    assert [kept.reason for kept in done.kept] == ["younger than a day: a writer may be at work on it"]
    assert (data / "half").is_dir()
    vacuum(store, nobody, ["demo@1"])
    assert store.list() == ()
    assert store.save(*small_dataset(1), PartRecord(1)).reference == "demo@2"


def test_mistakes_are_named(store: Store) -> None:
    with pytest.raises(StoreError, match=r"no dataset 'dmo'; expected 'demo'\?"):
        vacuum(store, nobody, ["dmo@1"])
    with pytest.raises(StoreError, match="no version '9'; expected one of: 1, 2, 3"):
        vacuum(store, nobody, ["demo@9"])


def _vacuum(workspace: Path) -> None:
    vacuum(Store(workspace), nobody, keep=1)


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_a_vacuum_killed_at_any_step_is_finished_by_the_next(store: Store, tmp_path: Path, every: int) -> None:
    for _ in killed_at_every_step(_vacuum, tmp_path / "ws", every=every):
        for entry in store.list():
            assert len(store.load(entry.reference).recordings) in (2, 3), "what is visible is whole"
        assert store.list()[-1].reference == "demo@3"
    assert [entry.reference for entry in store.list()] == ["demo@3"]
    assert len(folders(store)) == 1
