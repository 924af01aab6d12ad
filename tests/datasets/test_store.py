"""The store: names, versions, damage, concurrent writers, and a process that is killed while it writes."""

from __future__ import annotations

import multiprocessing
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Store, ingest
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
    manifest.write_text(text.replace('"rows": 2000', '"rows": 1999', 1))
    with pytest.raises(StoreError, match="recording r0: 2000 rows; expected 1999 rows"):
        Store(tmp_path / "ws").load("demo")
    manifest.write_text(text)
    for path in (tmp_path / "ws/datasets/demo/data").rglob("*.parquet"):
        path.unlink()
    with pytest.raises(StoreError, match="demo@1: samples: not readable"):
        Store(tmp_path / "ws").load("demo")


def _ingest_one(arguments: tuple[str, str]) -> str:
    return ingest(*arguments).reference


def test_concurrent_writers_get_versions_of_their_own(tmp_path: Path) -> None:
    folders = [str(make_logs(tmp_path / f"logs{seed}", seed)) for seed in range(3)]
    jobs = [(folder, str(tmp_path / "ws")) for folder in (*folders, folders[0])]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        references = pool.map(_ingest_one, jobs)
    assert sorted(set(references)) == ["demo@1", "demo@2", "demo@3"]
    assert references[0] == references[3]
    digests = [entry.digest for entry in Store(tmp_path / "ws").list()]
    assert len(set(digests)) == 3


PAUSED = """
import sys, time
from sysid.datasets import files, ingest, store

def pause(*_, **__):
    print("here", flush=True)
    time.sleep(600)

point = sys.argv[3]
if point == "before data":
    store.Store._write_table = pause
elif point == "between tables":
    write, seen = store.Store._write_table, []
    def second(self, path, frame):
        if seen:
            pause()
        seen.append(path)
        write(self, path, frame)
    store.Store._write_table = second
elif point == "before manifest":
    files.LocalFiles.publish = pause
elif point == "manifest written, not published":
    files.os.link = pause
ingest(sys.argv[1], sys.argv[2])
print("here", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize(
    "point", ["before data", "between tables", "before manifest", "manifest written, not published", "at the end"]
)
def test_a_killed_ingest_leaves_a_whole_version_or_none(tmp_path: Path, point: str) -> None:
    logs, workspace = make_logs(tmp_path / "logs", rows=500), tmp_path / "ws"
    script = tmp_path / "killed.py"
    script.write_text(textwrap.dedent(PAUSED))
    with subprocess.Popen([sys.executable, script, logs, workspace, point], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "here\n"
        process.send_signal(signal.SIGKILL)
        process.wait()
    store = Store(workspace)
    seen = [entry.reference for entry in store.list()]
    assert seen == (["demo@1"] if point == "at the end" else [])
    again = ingest(logs, workspace)  # the lock of the dead process does not block, what it left does no harm
    assert again.reference == "demo@1"
    assert len(store.load("demo@1").recordings) == 3
    assert [entry.reference for entry in store.list()] == ["demo@1"]


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
