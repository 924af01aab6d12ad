"""How two versions differ, where one comes from, and manifests of an older schema."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stored import MACHINE, small_dataset

from sysid.datasets import ClockRecord, Recording, Store, diff, lineage
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import StoreError
from sysid.machine import machine_from_files

MADE = PartRecord(1, 'schema = 1\nname = "demo"\n', {"rate_hz": 100.0, "hold_s": 0.5})
CLOCK = ClockRecord("s1-r0", "mocap.csv", 0.25, 40.0, (0.249, 0.251), (38.0, 42.0), 1.0, ("a.joint",), True)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """``demo@1``, and ``demo@2`` in which a bit of everything is another."""
    store = Store(tmp_path)
    dataset, channels = small_dataset(1)
    store.save(replace(dataset, clocks=(CLOCK,)), channels, MADE)
    first, second = dataset.recordings
    table = first.table.copy()
    table.loc[10:19, "a.joint"] += 0.002
    table.loc[20, "a.joint"] = np.nan
    third = Recording("new", second.table, 100.0)
    changed = replace(
        dataset,
        digest="f" * 64,
        machine=machine_from_files({"machine.toml": MACHINE.replace('name = "a"', 'name = "a"\ngain = 0.5')}, "test"),
        recordings=(replace(first, table=table), third),
        splits={"s1-r0": "select", "new": "fit"},
        sources=(replace(dataset.sources[0], sha256="0" * 64), replace(dataset.sources[1], path="new/log.csv")),
        clocks=(replace(CLOCK, offset_s=0.251, skew_ppm=30.0),),
        quality={"recordings": {"s1-r0": {"seconds": 0.5, "signals": {"a.joint": {"noise": 0.1}}}}},
    )
    more = PartRecord(2, 'schema = 1\nname = "other"\n', {"rate_hz": 100.0, "hold_s": 0.2})
    store.save(changed, {"new": channels["s1-r1"], "s1-r0": channels["s1-r0"]}, more)
    return store


def test_everything_that_differs_is_said(store: Store) -> None:
    found = diff(store, "demo@1", "demo@2")
    assert (found.before, found.after, found.same_content, found.empty) == ("demo@1", "demo@2", False, False)
    assert (found.recordings.added, found.recordings.removed) == (("new",), ("s1-r1",))
    assert found.sources.changed == ("s1-r0/log.csv",)
    assert (found.sources.added, found.sources.removed) == (("new/log.csv",), ("s1-r1/log.csv",))
    assert "+gain = 0.5" in found.texts["machine.toml"].splitlines()
    assert {"--- demo@1/recipe.toml", '-name = "demo"', '+name = "other"'} <= {*found.texts["recipe.toml"].splitlines()}
    assert {(c.what, c.before, c.after) for c in found.splits} == {
        ("s1-r0", "fit", "select"), ("s1-r1", "held_out", None), ("new", None, "fit"),
    }  # fmt: skip
    assert {(c.what, c.before, c.after) for c in found.settings} == {("ingest", 1, 2), ("hold_s", 0.5, 0.2)}
    (clock,) = found.clocks
    assert clock.mid_shift_s == pytest.approx(1e-3 - 10e-6 * 0.25)
    (table,) = found.tables
    assert (table.recording, table.signal, table.unit) == ("s1-r0", "a.joint", "rad")
    assert (table.rows, table.missing, table.compared) == ((50, 50), (1, 2), 48)
    assert table.largest == pytest.approx(0.002)
    assert table.rms == pytest.approx(0.002 * np.sqrt(10 / 48))
    assert {(c.what, c.after) for c in found.quality} == {("recordings/s1-r0/signals/a.joint/noise", 0.1)}
    json.dumps(found.to_json())


def test_a_version_is_like_itself(store: Store) -> None:
    assert diff(store, "demo@1", "demo@1").empty
    assert diff(store, "demo@2", "demo").same_content


def test_versions_over_the_same_tables_differ_in_roles_alone(store: Store) -> None:
    store.resplit("demo@1", {"s1-r0": "held_out", "s1-r1": "fit"})
    found = diff(store, "demo@1", "demo@3")
    assert [change.what for change in found.splits] == ["s1-r0", "s1-r1"]
    assert replace(found, splits=()).empty


def test_the_chain_from_raw_files_to_tables(store: Store) -> None:
    addition, channels = small_dataset(5, recordings=1)
    store.append("demo@1", addition, channels, PartRecord(2, "", {"rate_hz": 100.0}))
    store.resplit("demo@3", {**store.load("demo@3").splits, "s5-r0": "held_out"})
    found = lineage(store, "demo@4")
    assert [(step.reference, step.by, step.there) for step in found.steps] == [
        ("demo@3", "split", True), ("demo@1", "append", True),
    ]  # fmt: skip
    old, new = found.parts
    assert (old.recordings, new.recordings) == (("s1-r0", "s1-r1"), ("s5-r0",))
    assert [source.path for source in new.sources] == ["s5-r0/log.csv"]
    assert old.clocks == (CLOCK,)
    assert (old.ingest, new.ingest, old.settings["hold_s"], new.recipe_sha256) == (1, 2, 0.5, "")
    assert {"numpy", "pandas", "pyarrow", "deltalake"} <= {*old.software}
    assert all(len(digest) == 64 for part in found.parts for own in part.tables.values() for digest in own)
    json.dumps(found.to_json())


def test_a_manifest_of_the_first_schema_is_read(tmp_path: Path) -> None:
    """Written as the first version of the store wrote it: numbered recordings, one folder of tables, no seal."""
    import pandas as pd
    import pyarrow as pa
    from deltalake import write_deltalake

    dataset, channels = small_dataset(1)
    store = Store(tmp_path)
    store.save(dataset, channels, MADE)
    path = tmp_path / "datasets/demo/versions/000001.json"
    new = json.loads(path.read_text())
    frames = []
    for number, recording in enumerate(dataset.recordings):
        head = {"recording": np.int32(number), "row": np.arange(len(recording)), "stamp_ns": recording.start_ns}
        frames.append(pd.concat([pd.DataFrame(head), recording.table], axis=1))
    samples = pd.concat(frames, ignore_index=True)
    samples.attrs = {}
    folder = "datasets/demo/data/0000000000000000"
    write_deltalake(str(tmp_path / folder / "samples"), pa.Table.from_pandas(samples, preserve_index=False))
    raw = store.channels("demo@1").drop(columns="unit")
    write_deltalake(str(tmp_path / folder / "channels"), pa.Table.from_pandas(raw, preserve_index=False))
    keep = {key: value for key, value in new.items() if key not in ("seal", "parts", "base")}
    for item in keep["recordings"]:
        del item["part"], item["key"]
    path.write_text(json.dumps({**keep, "schema": 1, "folder": folder, "recipe": MADE.recipe}))
    loaded = store.load("demo@1")
    for recording in dataset.recordings:
        pd.testing.assert_frame_equal(loaded.recording(recording.name).table, recording.table)
    assert len(store.channels("demo@1")) == len(raw)
    addition, more = small_dataset(2, recordings=1)
    store.append("demo@1", addition, more, MADE)
    assert [recording.name for recording in store.load("demo@2").recordings] == ["s1-r0", "s1-r1", "s2-r0"]
    assert set(store.channels("demo@2")["unit"].dropna()) == {"rad"}
    assert diff(store, "demo@1", "demo@2").tables == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"schema": 3, "sysid": "9.1"},
            r"schema 3, written by sysid 9\.1; expected schema 1 to 2\. Use the sysid that wrote it",
        ),
        ({"splits": {"s1-r0": "fit", "s1-r1": "fit"}}, "changed after it was written: its seal does not fit"),
        ({"schema": 1}, r"damaged \(without 'folder'\)"),
    ],
)
def test_other_manifests_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    store = Store(tmp_path)
    store.save(*small_dataset(1), MADE)
    path = tmp_path / "datasets/demo/versions/000001.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(StoreError, match=message):
        store.load("demo@1")
