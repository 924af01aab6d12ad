"""Versions go in once, come out checked, and never half."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load, save

from sysid.errors import SettingsError, StoreError
from sysid.registry import Registry

LINEAGE = {"dataset": {"name": "crane", "version": 3, "digest": "ab12"}, "seed": 0}


def files(value: float = 1.0) -> dict[str, bytes]:
    return {
        "model.json": json.dumps({"activation": "relu"}).encode(),
        "weights.safetensors": save({"w": np.full((2, 3), value)}),
    }


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with one version: creating the tables takes a second, copying them does not."""
    workspace = tmp_path_factory.mktemp("template")
    Registry(workspace).register("crane-actuator", "actuator", files(), LINEAGE, {"rmse": 1e-4})
    return workspace


@pytest.fixture
def workspace(template: Path, tmp_path: Path) -> Path:
    return shutil.copytree(template, tmp_path / "workspace")


def test_round_trip(workspace: Path) -> None:
    version = Registry(workspace).load("crane-actuator")
    assert version.reference == "crane-actuator@1"
    assert version.kind == "actuator"
    assert dict(version.files) == files()
    assert version.lineage == LINEAGE
    assert version.metrics == {"rmse": 1e-4}
    np.testing.assert_array_equal(load(version.files["weights.safetensors"])["w"], np.ones((2, 3)))
    assert json.loads(json.dumps(version.to_json()))["sha256"].keys() == files().keys()


def test_a_moved_workspace_still_loads(workspace: Path) -> None:
    moved = workspace.rename(workspace.with_name("elsewhere"))
    assert Registry(moved).load("crane-actuator@1").files == files()


def test_same_content_and_lineage_is_the_same_version(workspace: Path) -> None:
    registry = Registry(workspace)
    assert registry.register("crane-actuator", "actuator", files(), LINEAGE, {"rmse": 9.9}).version == 1
    assert registry.register("crane-actuator", "actuator", files(2.0), LINEAGE).version == 2
    assert registry.register("crane-actuator", "actuator", files(), {**LINEAGE, "seed": 1}).version == 3
    assert registry.register("crane-actuator", "actuator", files(), LINEAGE).metrics == {"rmse": 1e-4}
    assert [version.version for version in registry.list()] == [1, 2, 3]


def test_references(workspace: Path) -> None:
    registry = Registry(workspace)
    registry.register("crane-actuator", "actuator", files(2.0), LINEAGE)
    assert registry.find("crane-actuator").version == 2
    assert registry.promote("crane-actuator@1").aliases == ("champion",)
    assert registry.load("crane-actuator@champion").version == 1
    registry.promote("crane-actuator@2")
    assert registry.find("crane-actuator@champion").lineage == LINEAGE
    assert [version.aliases for version in registry.list()] == [(), ("champion",)]


@pytest.mark.parametrize(
    ("reference", "error", "message"),
    [
        ("crane-aktuator", StoreError, r"no model 'crane-aktuator'; expected 'crane-actuator'\?"),
        ("crane-actuator@7", StoreError, r"no version or alias '7'; expected version 1"),
        ("crane-actuator@champio", StoreError, r"no version or alias 'champio'; expected .*'champion'\?"),
        ("crane-actuator@", SettingsError, r"expected name, name@3 or name@champion"),
        ("a@b@c", SettingsError, r"expected name, name@3 or name@champion"),
        ("../secrets", SettingsError, r"model name: '\.\./secrets'"),
        ("x' OR '1'='1", SettingsError, r"letters, digits"),
    ],
)
def test_wrong_references_are_explained(workspace: Path, reference: str, error: type[Exception], message: str) -> None:
    registry = Registry(workspace)
    registry.promote("crane-actuator@1")
    with pytest.raises(error, match=message):
        registry.load(reference)


@pytest.mark.parametrize(
    ("name", "kind", "content", "lineage", "message"),
    [
        ("m", "actuatr", files(), {}, r"model kind: 'actuatr'; expected 'actuator'\?"),
        ("m", "plant", {}, {}, r"no files; expected at least one"),
        ("m", "plant", {"model.pt": b""}, {}, r"'model.pt'; expected a file that ends in .safetensors, .json or .diff"),
        ("m", "plant", {"../x.json": b""}, {}, r"file name: '\.\./x.json'"),
        ("m", "plant", {"x.json": b""}, {"rmse": float("nan")}, r"model m: lineage: .*expected plain JSON values"),
        ("m", "plant", {"x.json": b""}, {"path": Path()}, r"model m: lineage: .*expected plain JSON values"),
        ("m", "plant", {"x.json": b""}, {"long": "x" * 100_001}, r"expected at most 100000"),
        ("a/b", "plant", {"x.json": b""}, {}, r"model name: 'a/b'"),
    ],
)
def test_what_cannot_be_stored_is_refused(
    tmp_path: Path, name: str, kind: str, content: dict[str, bytes], lineage: dict[str, object], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        Registry(tmp_path).register(name, kind, content, lineage)
    assert not list(tmp_path.iterdir())


def test_one_name_is_of_one_kind(workspace: Path) -> None:
    with pytest.raises(StoreError, match="already registered as kind 'actuator'; expected kind 'plant'"):
        Registry(workspace).register("crane-actuator", "plant", files(), LINEAGE)


def test_looking_creates_nothing(tmp_path: Path) -> None:
    registry = Registry(tmp_path / "workspace")
    assert registry.list() == ()
    with pytest.raises(StoreError, match=r"no model 'x'; expected one of: none"):
        registry.load("x")
    assert not (tmp_path / "workspace").exists()


def artifact(workspace: Path) -> Path:
    (path,) = (workspace / "models").glob("*/weights.safetensors")
    return path


def test_a_tampered_file_is_refused_and_registering_again_repairs_it(workspace: Path) -> None:
    path = artifact(workspace)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    registry = Registry(workspace)
    with pytest.raises(StoreError, match=r"crane-actuator@1: weights.safetensors: sha256 .* changed after registration"):
        registry.load("crane-actuator")
    assert registry.register("crane-actuator", "actuator", files(), LINEAGE).version == 1
    assert registry.load("crane-actuator").files == files()


def test_a_missing_file_is_refused(workspace: Path) -> None:
    artifact(workspace).unlink()
    with pytest.raises(StoreError, match=r"weights.safetensors: the file is gone"):
        Registry(workspace).load("crane-actuator")


def test_a_changed_manifest_is_refused(workspace: Path) -> None:
    with sqlite3.connect(workspace / "registry.db") as connection:
        connection.execute("UPDATE model_version_tags SET value = replace(value, 'ab12', 'cd34') WHERE key = 'sysid.manifest'")
    connection.close()
    with pytest.raises(StoreError, match=r"crane-actuator@1: manifest: sha256 .* changed after registration"):
        Registry(workspace).load("crane-actuator")


@pytest.mark.parametrize("write", [True, False])
def test_a_locked_database_is_reported_at_once(workspace: Path, write: bool) -> None:
    holder = sqlite3.connect(workspace / "registry.db", isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    registry = Registry(workspace, wait_s=0.1)
    try:
        with pytest.raises(StoreError, match=r"in use by another process; expected a free registry\. Try again"):
            registry.register("x", "plant", files(), {}) if write else registry.load("crane-actuator")
    finally:
        holder.rollback()
        holder.close()
    assert registry.load("crane-actuator").version == 1


def test_a_file_that_is_no_database_is_reported(tmp_path: Path) -> None:
    (tmp_path / "registry.db").write_bytes(b"not a database, but long enough to have a header" * 10)
    with pytest.raises(StoreError, match=r"registry.db: not a model registry"):
        Registry(tmp_path).list()


def test_a_server_that_does_not_answer_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    monkeypatch.setenv("SYSID_REGISTRY_URI", "http://127.0.0.1:9")
    with pytest.raises(StoreError, match=r"model registry http://127.0.0.1:9: .*expected a registry that answers"):
        Registry(tmp_path).list()


def test_a_registry_elsewhere_keeps_files_as_run_artifacts(
    template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MLflow puts artifacts of a sqlite store into ./mlruns
    (tmp_path / "server.db").write_bytes((template / "registry.db").read_bytes())
    uri = f"sqlite:///{tmp_path / 'server.db'}"
    first = Registry(tmp_path / "mine", uri=uri).register("arm", "forward", files(3.0), LINEAGE, {"rmse": 0.5})
    other = Registry(tmp_path / "theirs", uri=uri)
    assert other.load("arm@1").files == files(3.0)
    assert other.register("arm", "forward", files(3.0), LINEAGE).version == first.version
    (path,) = tmp_path.glob("mlruns/**/weights.safetensors")
    path.write_bytes(b"something else")
    with pytest.raises(StoreError, match="changed after registration"):
        other.load("arm")


def test_threads_that_register_together_get_consecutive_versions(workspace: Path) -> None:
    def register(value: int) -> int:
        return Registry(workspace).register("crane-actuator", "actuator", files(float(value // 2)), LINEAGE).version

    with ThreadPoolExecutor(4) as pool:
        versions = list(pool.map(register, range(2, 10)))
    assert sorted(set(versions)) == [1, 2, 3, 4]  # each content came twice; the first is there already
    assert len(Registry(workspace).list()) == 4


REGISTER = """
    import json, os, signal, sys
    from pathlib import Path
    from sysid.registry import Registry
    from sysid.registry import artifacts, tables
    crash = sys.argv[2]
    if crash == "before_registration":
        write = artifacts.FolderArtifacts.write
        def then_die(self, *arguments):
            write(self, *arguments)
            os.kill(os.getpid(), signal.SIGKILL)
        artifacts.FolderArtifacts.write = then_die
    elif crash == "between_files":
        artifacts.Root.sync = lambda self, folder: os.kill(os.getpid(), signal.SIGKILL)
    elif crash == "before_version":
        insert = tables.insert_version
        def then_die(*arguments):
            insert(*arguments)
            os.kill(os.getpid(), signal.SIGKILL)
        tables.insert_version = then_die
    version = Registry(Path(sys.argv[1])).register("new", "plant", {"plant.json": b"{}"}, {"n": sys.argv[3]})
    print(version.version)
"""


def start(workspace: Path, crash: str, label: str = "0") -> subprocess.Popen[str]:
    command = [sys.executable, "-W", "error", "-c", textwrap.dedent(REGISTER), str(workspace), crash, label]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
@pytest.mark.parametrize("crash", ["between_files", "before_registration", "before_version"])
def test_a_kill_leaves_nothing_half_registered(workspace: Path, crash: str) -> None:
    process = start(workspace, crash)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL, errors
    registry = Registry(workspace, wait_s=1.0)
    assert [version.reference for version in registry.list()] == ["crane-actuator@1"]
    with pytest.raises(StoreError, match="no model 'new'"):
        registry.load("new")
    assert registry.register("new", "plant", {"plant.json": b"{}"}, {"n": "0"}).version == 1
    assert registry.load("new@1").files == {"plant.json": b"{}"}
    assert not list((workspace / "models").glob(".partial-*"))


def test_two_processes_that_create_the_registry_together(tmp_path: Path) -> None:
    processes = [start(tmp_path, "never", label) for label in "ab"]
    outputs = [process.communicate(timeout=120) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], outputs
    assert sorted(out.strip() for out, _ in outputs) == ["1", "2"]
    assert [errors for _, errors in outputs] == ["", ""]


def test_a_name_alone_means_what_was_promoted(workspace: Path) -> None:
    registry = Registry(workspace)
    for value in (2.0, 3.0):
        registry.register("crane-actuator", "actuator", files(value), LINEAGE)
    assert registry.promoted("crane-actuator") is None
    assert registry.find("crane-actuator").version == 3, "the newest, as long as nothing was promoted"
    first = registry.promote("crane-actuator@1", instead_of=None)
    assert registry.load("crane-actuator").files == files(1.0)
    assert registry.promote("crane-actuator@2", instead_of=first).reference == "crane-actuator@2"
    assert registry.promoted("crane-actuator") == registry.find("crane-actuator") == registry.find("crane-actuator@champion")
    assert registry.promoted("crane") is None
    assert Registry(workspace / "nothing here").promoted("crane") is None
    assert not (workspace / "nothing here").exists()


def test_a_promotion_that_was_decided_on_what_is_no_more_is_refused(workspace: Path) -> None:
    registry = Registry(workspace)
    registry.register("crane-actuator", "actuator", files(2.0), LINEAGE)
    first = registry.promote("crane-actuator@1", instead_of=None)
    registry.promote("crane-actuator@2", instead_of=first)
    for stale in (first, None):
        with pytest.raises(StoreError, match=r"crane-actuator@champion: means crane-actuator@2; expected .*changed in the"):
            registry.promote("crane-actuator@1", instead_of=stale)
    assert registry.find("crane-actuator").version == 2
