"""New recordings behind those of a version, other roles over the same tables: nothing that is there is touched."""

from __future__ import annotations

import shutil
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from one_axis_logs import MACHINE, record

from sysid.datasets import Store, append, frame_of, ingest, load
from sysid.datasets.channels import read_channels
from sysid.errors import InputError, SettingsError, StoreError
from sysid.root import Root

AUTOLOG = Path(__file__).parents[2] / "datasets/autolog"


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    root = tmp_path / "logs"
    for index in range(3):
        record(root / f"r{index}", index)
    (root / "machine.toml").write_text(MACHINE)
    return root


def content(workspace: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in (workspace / "datasets").rglob("*") if path.is_file()}


def test_four_that_append_at_once_all_add_theirs(logs: Path, tmp_path: Path) -> None:
    """Each reads ``demo@1`` as the newest before any of them stores; the others then go on from what was stored."""
    workspace = tmp_path / "ws"
    first = ingest(logs, workspace)
    for index in range(3, 7):
        record(tmp_path / f"more{index}" / f"r{index}", index)
    together = threading.Barrier(4, timeout=60)
    repeated = []

    def add(index: int) -> str:
        waited: list[float] = []

        def report(share: float, text: str) -> None:
            if text == "storing" and not waited:
                waited.append(share)
                together.wait()
            if "repeated" in text:
                repeated.append(text)

        return append(tmp_path / f"more{index}", workspace, "demo", progress=report).reference

    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(add, range(3, 7)))
    assert first.reference == "demo@1"
    assert sorted(made) == [f"demo@{number}" for number in range(2, 6)]
    assert len(repeated) >= 3
    assert sorted({r.name.partition("#")[0] for r in Store(workspace).load("demo").recordings}) == [
        f"r{index}" for index in range(7)
    ]


def test_only_what_is_new_is_read_and_written(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace = tmp_path / "ws"
    first = ingest(logs, workspace)
    before = content(workspace)
    record(logs / "r3", 3)
    read: list[str] = []
    module = sys.modules["sysid.datasets.ingestion"]
    monkeypatch.setattr(module, "read_channels", lambda f, *a: (read.append(f.name), read_channels(f, *a))[1])
    second = append(logs, workspace, "demo")
    assert read == ["r3"]
    assert second.reference == "demo@2"
    after = content(workspace)
    assert {path: after[path] for path in before} == before, "not one byte of what was there is another one"
    assert second.splits == {**first.splits, "r3": "fit"}
    store = Store(workspace)
    loaded = store.load("demo@2")
    for recording in first.recordings:
        pd.testing.assert_frame_equal(recording.table, loaded.recording(recording.name).table)
    alone = ingest(logs, tmp_path / "whole").recording("r3")
    pd.testing.assert_frame_equal(alone.table, loaded.recording("r3").table)
    assert [source.path for source in loaded.sources] == [f"r{index}/log.csv" for index in range(4)]
    assert set(loaded.quality["recordings"]) == {"r0", "r1", "r2", "r3"}
    assert set(store.channels("demo@2")["recording"]) == {"r0", "r1", "r2", "r3"}
    assert set(store.channels("demo@1")["recording"]) == {"r0", "r1", "r2"}
    assert [part.recordings for part in store.tables("demo@2")] == [("r0", "r1", "r2"), ("r3",)]


def test_the_same_on_the_same_is_the_same_version(logs: Path, tmp_path: Path) -> None:
    ingest(logs, tmp_path / "ws")
    record(logs / "r3", 3)
    second = append(logs, tmp_path / "ws", "demo@1")
    files = content(tmp_path / "ws")
    assert append(logs / "r3", tmp_path / "ws", "demo@1").reference == "demo@2", "the new folder alone is the same"
    assert append(logs, tmp_path / "ws", "demo").reference == "demo@2", "nothing is new"
    assert content(tmp_path / "ws") == files
    other = tmp_path / "other"
    for index in range(3):
        shutil.copytree(logs / f"r{index}", tmp_path / "three" / f"r{index}")
    shutil.copy(logs / "machine.toml", tmp_path / "three")
    ingest(tmp_path / "three", other)
    assert append(logs, other, "demo").digest == second.digest, "the same content and history elsewhere"
    third = append(logs, tmp_path / "ws", "demo@1", role="held_out")
    assert (third.reference, third.splits["r3"]) == ("demo@3", "held_out")
    assert third.digest != second.digest


def test_roles_by_argument_by_recipe_or_to_fit(logs: Path, tmp_path: Path) -> None:
    ingest(logs, tmp_path / "ws")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text('schema = 1\n[splits]\nselect = ["r*"]\nheld_out = ["elsewhere"]\n')
    new = tmp_path / "new"
    record(new / "r7", 7)
    assert append(new, tmp_path / "ws", "demo@1", recipe=recipe).splits["r7"] == "select"
    assert append(new, tmp_path / "ws", "demo@1", recipe=recipe, role="held_out").splits["r7"] == "held_out"
    assert append(new, tmp_path / "ws", "demo@1").splits["r7"] == "fit"
    with pytest.raises(SettingsError, match=r"role: 'proof'; expected one of: fit, held_out, select"):
        append(new, tmp_path / "ws", "demo@1", role="proof")  # type: ignore[arg-type]


def test_a_signal_that_is_new_is_missing_before(logs: Path, tmp_path: Path) -> None:
    ingest(logs, tmp_path / "ws")
    new = tmp_path / "new"
    record(new / "r3", 3, joint=True)
    dataset = append(new, tmp_path / "ws", "demo")
    assert dataset.units["a.joint"] == "rad"
    assert np.isnan(dataset.recording("r0").values("a.joint")).all()
    assert np.isfinite(dataset.recording("r3").values("a.joint")).all()
    frame = frame_of(dataset)
    assert frame.loc[frame["recording"] != "r3", "a.joint"].isna().all()
    assert frame.loc[frame["recording"] == "r3", "a.joint"].notna().all()


def test_what_cannot_be_appended_is_refused_and_leaves_nothing(logs: Path, tmp_path: Path) -> None:
    workspace = tmp_path / "ws"
    ingest(logs, workspace)
    files = content(workspace)
    shutil.copytree(logs / "r1", tmp_path / "twice" / "again")
    with pytest.raises(InputError, match=r"recording again: the same files as recording 'r1' of demo@1.*count twice"):
        append(tmp_path / "twice", workspace, "demo")
    record(tmp_path / "other" / "r1", 9)
    with pytest.raises(InputError, match=r"recording r1: other content than in demo@1.*another name"):
        append(tmp_path / "other", workspace, "demo")
    record(tmp_path / "new" / "r9", 9)
    (tmp_path / "new" / "machine.toml").write_text(MACHINE.replace("0.05", "0.06"))
    with pytest.raises(SettingsError, match=r"machine\.toml: another machine than in demo@1: '- gain = 0\.05'"):
        append(tmp_path / "new", workspace, "demo")
    with pytest.raises(StoreError, match="no version '4'"):
        append(tmp_path / "new", workspace, "demo@4")
    assert content(workspace) == files


def test_other_roles_are_a_version_without_a_copy(logs: Path, tmp_path: Path) -> None:
    store = Store(tmp_path / "ws")
    first = ingest(logs, tmp_path / "ws")
    files = content(tmp_path / "ws")
    second = store.resplit("demo@1", {**first.splits, "r0": "held_out", "r2": "fit"})
    assert second.reference == "demo@2"
    assert second.splits["r0"] == "held_out"
    assert store.load("demo@1").splits == first.splits, "the roles of a version never change"
    new = {path for path in content(tmp_path / "ws") if path not in files}
    assert {path.name for path in new} == {"000002.json"}
    assert store.resplit("demo@2", first.splits).reference == "demo@1", "the way back is the version there was"
    assert store.resplit("demo@1", second.splits).reference == "demo@2"
    record(logs / "r3", 3)
    third = append(logs, tmp_path / "ws", "demo@2")
    assert third.splits == {**second.splits, "r3": "fit"}
    assert len(store.tables("demo@3")) == 2


def test_one_table_with_units(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sysid

    made = ingest(logs, tmp_path / "ws")
    frame = sysid.load("demo@1", tmp_path / "ws")
    assert list(frame.columns) == ["recording", "role", "time", "a.command", "a.cylinder"]
    assert frame.attrs["units"] == {"time": "s", "a.command": "1", "a.cylinder": "m"}
    assert frame.attrs["dataset"] == "demo@1"
    for recording in made.recordings:
        own = frame[frame["recording"] == recording.name]
        np.testing.assert_array_equal(own["a.cylinder"], recording.values("a.cylinder"))
        assert set(own["role"]) == {made.splits[recording.name]}
    monkeypatch.setenv("SYSID_WORKSPACE", str(tmp_path / "ws"))
    pd.testing.assert_frame_equal(load("demo"), frame)


def test_other_tools_read_the_same_tables(logs: Path, tmp_path: Path) -> None:
    """What the guide says of the paths: plain Parquet under a Delta log, names in ``recording``, units in the columns."""
    import pyarrow.dataset as ds
    from deltalake import DeltaTable

    ingest(logs, tmp_path / "ws")
    record(logs / "r3", 3, joint=True)
    dataset = append(logs, tmp_path / "ws", "demo")
    parts = Store(tmp_path / "ws").tables("demo@2")
    by_delta = pd.concat([DeltaTable(part.samples).to_pandas() for part in parts])
    by_parquet = pd.concat([ds.dataset(part.samples, exclude_invalid_files=True).to_table().to_pandas() for part in parts])
    for table in (by_delta, by_parquet):
        own = table[table["recording"] == "r3"].sort_values("row")
        np.testing.assert_array_equal(own["a.joint"], dataset.recording("r3").values("a.joint"))
        np.testing.assert_array_equal(own["stamp_ns"], np.rint(own["time"] * 1e9))
    import pyarrow as pa

    schema = pa.schema(DeltaTable(parts[0].samples).schema().to_arrow())
    assert schema.field("a.cylinder").metadata[b"unit"] == b"m"
    assert {f.name for f in pa.schema(DeltaTable(parts[0].channels).schema().to_arrow())} >= {"recording", "domain", "stamp_ns"}


def test_devices_are_known_from_the_version_before(tmp_path: Path) -> None:
    """One recording of the crane behind two: mounts and skew of the cameras are those that the two have shown."""
    logs = tmp_path / "logs"
    for name in ("manual-01", "manual-02"):
        shutil.copytree(AUTOLOG / "logs" / name, logs / name)
    for name in ("machine.toml", "autolog.urdf"):
        shutil.copy(AUTOLOG / name, logs)
    recipe = tmp_path / "recipe.toml"
    text = (AUTOLOG / "recipe.toml").read_text().replace('logs = "logs"', "").replace('machine = "machine.toml"', "")
    text = text.replace('held_out = ["manual-06"]', 'held_out = ["manual-02"]\nfit = ["manual-01"]')
    recipe.write_text(text.replace('recording = "manual-*"', 'recording = "manual-0[12]"'))
    workspace = tmp_path / "ws"
    base = ingest(logs, workspace, recipe=recipe)
    new = tmp_path / "new" / "manual-03"
    shutil.copytree(AUTOLOG / "logs/manual-03", new)
    dataset = append(new.parent, workspace, "autolog")  # recipe, machine and the reference pose of the bodies: the version's
    (record_,) = [clock for clock in dataset.clocks if clock.recording == "manual-03"]
    assert "common to 3 recordings" in record_.reason
    half = 0.5 * (record_.skew_interval95[1] - record_.skew_interval95[0])
    before, added = (part["made"]["mounts"] for part in Store(workspace).manifest("autolog@2")["parts"])
    assert added == before
    recording = dataset.recording("manual-03")
    parked = (recording.values("time") > 0.3) & (recording.values("time") < 1.0)
    assert np.nanmean(recording.values("boom.joint")[parked]) == pytest.approx(0.5, abs=2e-3)
    assert half < 8.0
    assert [clock for clock in dataset.clocks if clock.recording != "manual-03"] == list(base.clocks)


def test_files_that_vanish_do_not_empty_a_listing(tmp_path: Path) -> None:
    """Temporary files of another process come and go while a folder is listed."""
    (tmp_path / "kept.json").write_text("{}")
    stopped = threading.Event()

    def busy() -> None:
        while not stopped.is_set():
            for k in range(20):
                (tmp_path / f".half{k}").touch()
            for k in range(20):
                (tmp_path / f".half{k}").unlink()

    with ThreadPoolExecutor(2) as pool:
        running = [pool.submit(busy)]
        try:
            listings = [Root(tmp_path).entries("") for _ in range(2000)]
        finally:
            stopped.set()
        assert all(each.result() is None for each in running)
    assert all("kept.json" in listing for listing in listings)
