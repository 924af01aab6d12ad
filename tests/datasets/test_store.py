"""The store: names, versions, damage, concurrent writers, and a process that is killed while it writes."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from killed import killed_at_every_step

from sysid.datasets import Dataset, Store, ingest
from sysid.datasets.channel import Channel
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import StoreError

MACHINE = """schema = 1
name = "demo"
rate_hz = 100.0
[[axes]]
name = "a"
actuation = "velocity"
drives = "joint"
"""


def make_logs(root: Path, seed: int = 0, rows: int = 2000) -> Path:
    rng = np.random.default_rng(seed)
    for index in range(3):
        (root / f"r{index}").mkdir(parents=True, exist_ok=True)
        table = pd.DataFrame(
            {"time": np.arange(rows) / 100, "a.command": rng.uniform(-1, 1, rows), "a.joint": rng.normal(size=rows)}
        )
        table.to_csv(root / f"r{index}" / "log.csv", index=False)
    (root / "machine.toml").write_text(MACHINE)
    return root


def test_unknown_names_and_versions_suggest_what_is_there(tmp_path: Path) -> None:
    ingest(make_logs(tmp_path / "logs"), tmp_path / "ws")
    store = Store(tmp_path / "ws")
    with pytest.raises(StoreError, match=r"no dataset 'dmo'; expected 'demo'\?"):
        store.load("dmo")
    with pytest.raises(StoreError, match="dataset demo: no version '7'; expected one of: 1"):
        store.load("demo@7")
    with pytest.raises(StoreError, match="no version 'new'"):
        store.load("demo@new")
    assert Store(tmp_path / "nowhere").list() == ()


def test_damage_is_reported(tmp_path: Path) -> None:
    ingest(make_logs(tmp_path / "logs"), tmp_path / "ws")
    manifest = tmp_path / "ws/datasets/demo/versions/000001.json"
    text = manifest.read_text()
    manifest.write_text(text[:100])
    with pytest.raises(StoreError, match=r"000001\.json: damaged"):
        Store(tmp_path / "ws").load("demo")
    manifest.write_text(text.replace('"r1": "select"', '"r1": "fit"', 1))
    with pytest.raises(StoreError, match="changed after it was written: its seal does not fit"):
        Store(tmp_path / "ws").load("demo")
    manifest.write_text(text)
    for path in (tmp_path / "ws/datasets/demo/data").rglob("*.parquet"):
        path.unlink()
    with pytest.raises(StoreError, match="demo@1: samples: not readable"):
        Store(tmp_path / "ws").load("demo")


def _ingest_one(arguments: tuple[str, str]) -> str:
    return ingest(*arguments).reference


@pytest.mark.slow
def test_concurrent_writers_get_versions_of_their_own(tmp_path: Path) -> None:
    folders = [str(make_logs(tmp_path / f"logs{seed}", seed)) for seed in range(3)]
    jobs = [(folder, str(tmp_path / "ws")) for folder in (*folders, folders[0])]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        references = pool.map(_ingest_one, jobs)
    assert sorted(set(references)) == ["demo@1", "demo@2", "demo@3"]
    assert references[0] == references[3]
    digests = [entry.digest for entry in Store(tmp_path / "ws").list()]
    assert len(set(digests)) == 3


def _save(workspace: Path, dataset: Dataset, channels: dict[str, tuple[Channel, ...]]) -> str:
    return Store(workspace).save(dataset, channels, PartRecord(1)).reference


@pytest.mark.slow
def test_a_writer_killed_at_any_step_leaves_a_whole_version_or_none(tmp_path: Path) -> None:
    made = ingest(make_logs(tmp_path / "logs", rows=100), tmp_path / "made")
    channels = {r.name: (Channel("a.joint", "log.csv", "machine", np.arange(5), np.zeros(5)),) for r in made.recordings}
    workspace = tmp_path / "ws"
    store = Store(workspace)
    seen = []
    for _ in killed_at_every_step(_save, workspace, made, channels):
        seen.append(len(store.list()))
        assert all(len(store.load(entry.reference).recordings) == 3 for entry in store.list())
    assert seen.count(0) > 5
    assert set(seen) <= {0, 1}
    assert _save(workspace, made, channels) == "demo@1"  # the locks of the dead do not block, what they left does no harm
    assert [entry.reference for entry in store.list()] == ["demo@1"]
    assert len(list((workspace / "datasets/demo/data").iterdir())) == 1, "what the dead left is gone"


@pytest.mark.slow
def test_kills_at_random_moments(tmp_path: Path) -> None:
    logs, workspace = make_logs(tmp_path / "logs", rows=3000), tmp_path / "ws"
    code = f"from sysid.datasets import ingest; print('go', flush=True); ingest({str(logs)!r}, {str(workspace)!r})"
    for delay in (0.02, 0.1, 0.2, 0.3, 0.45):
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(delay)
            process.kill()
        for entry in Store(workspace).list():
            assert len(Store(workspace).load(entry.reference).recordings) == 3
    assert ingest(logs, workspace).reference == "demo@1"
