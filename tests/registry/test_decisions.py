"""Champion, candidate, decisions that stay with a version; what a disk or another process refuses leaves nothing half done."""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sysid.errors import StorageError, StoreError
from sysid.registry import Check, PromotionDecision, Registry, decide

FILES = {"plant.json": b"{}"}
PASSED, FAILED = (
    Check("rmse", "passed", "boom.joint: rmse 1 mrad"),
    Check("max", "failed", "boom.joint: max 9 mrad, 1 mrad above"),
)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two versions of ``arm``: the tables of a registry take a while to make."""
    workspace = tmp_path_factory.mktemp("template")
    for number in (1, 2):
        Registry(workspace).register("arm", "plant", FILES, {"n": number})
    return workspace


@pytest.fixture
def workspace(template: Path, tmp_path: Path) -> Path:
    return shutil.copytree(template, tmp_path / "ws")


def aliases(registry: Registry) -> list[tuple[str, ...]]:
    return [version.aliases for version in registry.list()]


def test_the_newest_is_the_candidate_until_it_is_the_champion(workspace: Path) -> None:
    registry = Registry(workspace)
    assert aliases(registry) == [(), ("candidate",)]
    assert decide(registry, "arm@2", None, [PASSED]).promoted
    assert aliases(registry) == [(), ("champion",)]
    registry.register("arm", "plant", FILES, {"n": 3})
    assert aliases(registry) == [(), ("champion",), ("candidate",)]
    assert registry.find("arm").version == 2
    assert registry.find("arm@candidate").version == 3
    registry.register("arm", "plant", FILES, {"n": 1})
    assert aliases(registry) == [(), ("champion",), ("candidate",)], "what was there already is no new candidate"


def test_a_decision_stays_with_its_version(workspace: Path) -> None:
    registry = Registry(workspace)
    first = decide(registry, "arm@1", None, [PASSED], {"policy": "p.toml"})
    assert (first.promoted, first.current, first.previous) == (True, "arm@1", "")
    refused = decide(registry, "arm@2", registry.promoted("arm"), [PASSED, FAILED])
    assert (refused.promoted, refused.current, refused.reason) == (False, "arm@1", FAILED.text)
    assert registry.find("arm").version == 1
    decide(registry, "arm@2", registry.promoted("arm"), [PASSED, FAILED])
    assert len(registry.find("arm@2").decisions) == 1, "the same decision again says nothing new"
    spoken = decide(registry, "arm@2", registry.promoted("arm"), [PASSED, FAILED], word="the old sensor is gone")
    assert (spoken.promoted, spoken.current, spoken.previous, spoken.reason) == (True, "arm@2", "arm@1", "")
    one, two = Registry(workspace).find("arm@2").decisions
    assert (one.promoted, one.word, one.checks, one.instead_of) == (False, "", (PASSED, FAILED), "arm@1")
    assert (two.promoted, two.word, two.reason) == (True, "the old sensor is gone", FAILED.text)
    assert one.decided_ms <= two.decided_ms <= time.time_ns() // 1_000_000
    assert registry.find("arm@1").decisions[0].judged == {"policy": "p.toml"}
    assert registry.find("arm@2").to_json()["decisions"][0]["checks"][1]["status"] == "failed"


def test_a_decision_about_what_is_no_more_is_not_carried_out(workspace: Path) -> None:
    registry = Registry(workspace)
    decide(registry, "arm@1", None, [PASSED])
    found = decide(registry, "arm@2", None, [PASSED])
    assert not found.promoted
    assert "means arm@1; expected no version" in found.reason
    assert registry.find("arm@2").decisions == (), "what was not done is not recorded as done"


@pytest.mark.parametrize("text", ["[]", "{", '{"promoted": true}', '{"checks": [1]}', '{"checks": [], "colour": 1}'])
def test_a_decision_that_was_edited_is_refused(workspace: Path, text: str) -> None:
    registry = Registry(workspace)
    decide(registry, "arm@1", None, [PASSED])
    with sqlite3.connect(workspace / "registry.db") as connection:
        connection.execute("UPDATE model_version_tags SET value = ? WHERE key LIKE 'sysid.decision%'", (text,))
    connection.close()
    with pytest.raises(StoreError, match=r"arm@1: sysid\.decision\..*: not a decision"):
        Registry(workspace).find("arm")


def test_a_decision_survives_as_text() -> None:
    decision = PromotionDecision(True, "arm@1", (PASSED, FAILED), "r", "w", {"rules": {"margin": 0.05}}, 5)
    assert PromotionDecision.from_text(decision.to_text(), "x") == decision
    assert decision.same(PromotionDecision(True, "arm@1", (PASSED, FAILED), "r", "w", {"rules": {"margin": 0.05}}, 9))


def test_a_manifest_that_names_a_path_is_refused(workspace: Path) -> None:
    """A foreign registry may hold anything, a consistent digest too."""
    import hashlib

    text = '{"files":{"../../secrets.json":"00"},"kind":"plant","lineage":{}}'
    digest = hashlib.sha256(text.encode()).hexdigest()
    with sqlite3.connect(workspace / "registry.db") as connection:
        for key, value in (("sysid.manifest", text), ("sysid.digest", digest)):
            connection.execute("UPDATE model_version_tags SET value = ? WHERE key = ? AND version = 2", (value, key))
    connection.close()
    with pytest.raises(StoreError, match=r"arm@2: manifest: not a manifest of sysid .*'\.\./\.\./secrets\.json'"):
        Registry(workspace).load("arm")


HOLD = """
    import sqlite3, sys, time
    connection = sqlite3.connect(sys.argv[1], isolation_level=None)
    connection.execute("BEGIN EXCLUSIVE")
    print("held", flush=True)
    sys.stdin.read()
"""
LOCK = """
    import sys
    from filelock import FileLock
    with FileLock(sys.argv[1]):
        print("held", flush=True)
        sys.stdin.read()
"""


@pytest.mark.parametrize(("script", "file"), [(HOLD, "registry.db"), (LOCK, "registry.lock")])
def test_a_registry_that_another_process_holds(workspace: Path, script: str, file: str) -> None:
    command = [sys.executable, "-c", textwrap.dedent(script), str(workspace / file)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        registry = Registry(workspace, wait_s=0.3)
        begin = time.monotonic()
        with pytest.raises(StoreError, match=r"in use by another process; expected a free registry\. Try again") as caught:
            registry.register("arm", "plant", FILES, {"n": 9})
        assert 0.25 < time.monotonic() - begin < 5.0, "it waits as long as it was told to, and no longer"
        assert not isinstance(caught.value, StorageError)
        holder.communicate("")
    assert [version.version for version in Registry(workspace).list()] == [1, 2]
    assert registry.register("arm", "plant", FILES, {"n": 9}).version == 3


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def full_table(*_: object, **__: object) -> None:
    raise sqlite3.OperationalError("database or disk is full")


DISKS: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "no room for a folder": lambda m: m.setattr("os.mkdir", full),
    "no room for a file": lambda m: m.setattr("sysid.root.Root.create", full),
    "no room when it is settled": lambda m: m.setattr("os.fsync", full),
    "no room for a row": lambda m: m.setattr("sysid.registry.tables.insert_version", full_table),
}


@pytest.mark.parametrize("disk", DISKS)
def test_a_full_disk_registers_nothing(workspace: Path, monkeypatch: pytest.MonkeyPatch, disk: str) -> None:
    registry = Registry(workspace)
    assert len(registry.list()) == 2
    with monkeypatch.context() as patch:
        DISKS[disk](patch)
        message = "cannot be written .*; nothing was registered, existing versions are unchanged.*Free disk space"
        with pytest.raises(StorageError, match=message):
            registry.register("arm", "plant", {"plant.json": b"[1]"}, {"n": 9})
    assert [version.version for version in Registry(workspace).list()] == [1, 2]
    assert not list((workspace / "models").glob(".partial-*"))
    assert registry.register("arm", "plant", {"plant.json": b"[1]"}, {"n": 9}).version == 3
    assert registry.load("arm@3").files == {"plant.json": b"[1]"}


def test_a_database_that_may_not_grow(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A real refusal of sqlite, half-way through the rows of a version."""
    from sysid.registry import tables

    begin = tables.insert_version

    def capped(connection: sqlite3.Connection, *rest: Any) -> None:
        connection.execute("PRAGMA max_page_count = 1")  # sqlite keeps what is there and takes no page more
        begin(connection, *rest)

    monkeypatch.setattr(tables, "insert_version", capped)
    registry = Registry(workspace)
    with pytest.raises(StorageError, match="database or disk is full"):
        registry.register("arm", "plant", FILES, {"long": "x" * 90_000})
    assert [version.version for version in Registry(workspace).list()] == [1, 2]
