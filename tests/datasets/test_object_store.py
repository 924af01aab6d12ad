"""Dataset versions in an S3-compatible object store, on a real server."""

from __future__ import annotations

import multiprocessing
import signal
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fleet_logs import MACHINE, recorded
from object_store import BUCKET, object_store
from version_content import content

from sysid.datasets import Store, append, ingest, vacuum
from sysid.errors import StorageError, StoreError
from sysid.execution import LocalExecutor
from sysid.workspace import open_workspace


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[bytes]]:
    with object_store(tmp_path_factory.mktemp("moto")) as (_, process):
        yield process


@pytest.fixture
def place(server: subprocess.Popen[bytes], request: pytest.FixtureRequest) -> str:
    return f"s3://{BUCKET}/{abs(hash(request.node.name))}"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("logs")
    (root / "machine.toml").write_text(MACHINE)
    for k in range(3):
        (root / f"run-{k}").mkdir()
        recorded(0.08, k).to_csv(root / f"run-{k}" / "log.csv", index=False)
    return root


def test_a_version_in_a_store_is_that_of_a_folder(place: str, logs: Path, tmp_path: Path) -> None:
    ingest([logs / "run-0", logs / "run-1"], place, logs / "machine.toml")
    ingest([logs / "run-0", logs / "run-1"], tmp_path, logs / "machine.toml")
    append(logs, place, "lift")
    append(logs, tmp_path, "lift")
    for version in ("lift@1", "lift@2"):
        assert content(Store(place), version) == content(Store(tmp_path), version)
    for mine, theirs in zip(Store(place).load("lift").recordings, Store(tmp_path).load("lift").recordings, strict=True):
        assert mine.table.equals(theirs.table)
    assert [entry.version for entry in Store(place).list()] == [1, 2]
    assert ingest([logs / "run-0", logs / "run-1"], place, logs / "machine.toml").version == 1
    assert open_workspace(place).dataset("lift@1").reference == "lift@1"


def test_tasks_write_to_the_store_themselves(place: str, logs: Path, tmp_path: Path) -> None:
    ingest(logs, tmp_path)
    found = ingest(logs, place, executor=LocalExecutor(2))
    assert content(Store(place), found.reference) == content(Store(tmp_path), "lift@1")
    assert list(Store(place).leftovers("lift")) == []


def test_two_writers_at_once_get_two_whole_versions(place: str, logs: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        work = [pool.submit(_ingested, place, str(logs), f"run-{k}") for k in range(2)]
        assert sorted(job.result() for job in work) == [1, 2]
    names = {Store(place).load(f"lift@{k}").recordings[0].name.partition("#")[0] for k in (1, 2)}
    assert names == {"run-0", "run-1"}


def _ingested(place: str, logs: str, name: str) -> int:
    """The version that another process makes of one recording."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        return pool.apply(_version, (place, logs, name))


def _version(place: str, logs: str, name: str) -> int:
    return ingest(Path(logs) / name, place, Path(logs) / "machine.toml").version


def test_what_a_killed_writer_left_is_kept_for_a_day(place: str, logs: Path) -> None:
    ingest(logs, place)
    store = Store(place)
    with store.files.replaced("datasets/lift/data/left/samples/part-00000.zstd.parquet") as file:
        file.write(b"half")
    result = vacuum(store, lambda *_: [])
    assert [item.reason for item in result.kept] == ["younger than a day: a writer may be at work on it"]
    assert store.load("lift").version == 1


def test_a_store_that_does_not_answer_is_reported(monkeypatch: pytest.MonkeyPatch, place: str, logs: Path) -> None:
    ingest(logs, place)
    with monkeypatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
        for read in (lambda: Store(place).list(), lambda: Store(place).load("lift"), lambda: ingest(logs, place)):
            with pytest.raises(StorageError, match=r"does not answer.*Nothing was changed"):
                read()
    assert [entry.version for entry in Store(place).list()] == [1]


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("seconds", [10.0, 62.0])
def test_an_ingest_outlasts_a_store_that_stands_still(
    server: subprocess.Popen[bytes], place: str, logs: Path, seconds: float
) -> None:
    """Requests wait and are repeated; the version is whole, and there is one."""

    def progress(share: float, text: str) -> None:
        if share > 0.3 and not stopped:
            stopped.append(time.monotonic())
            server.send_signal(signal.SIGSTOP)
            pool.submit(_continue_later, server, seconds)

    stopped: list[float] = []
    with ThreadPoolExecutor(1) as pool:
        try:
            found = ingest(logs, place, progress=progress, executor=LocalExecutor())
        finally:
            server.send_signal(signal.SIGCONT)
    assert stopped
    assert time.monotonic() - stopped[0] > seconds
    assert found.version == 1
    assert [entry.damage for entry in Store(place).list()] == [""]


def _continue_later(server: subprocess.Popen[bytes], seconds: float) -> None:
    time.sleep(seconds)
    server.send_signal(signal.SIGCONT)


def test_a_missing_version_is_reported_as_in_a_folder(place: str, logs: Path) -> None:
    ingest(logs, place)
    with pytest.raises(StoreError, match="no version '2'"):
        Store(place).load("lift@2")
