"""A registry that several workspaces share: what is killed between two requests is finished by the next command."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from sysid.errors import SettingsError, StoreError
from sysid.registry import Check, Registry, decide
from sysid.registry.schema import empty_registry

FILES = {"plant.json": b"{}"}
PASSED = Check("rmse", "passed", "boom.joint: rmse 1 mrad")
REQUESTS = (
    "create_registered_model",
    "create_model_version",
    "set_model_version_tag",
    "set_registered_model_alias",
    "delete_registered_model_alias",
)


class Dead(BaseException):
    """The process is killed."""


@pytest.fixture
def uri(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)  # MLflow puts artifacts of a sqlite store into ./mlruns
    (tmp_path / "server.db").write_bytes(empty_registry())
    return f"sqlite:///{tmp_path / 'server.db'}"


def die(registry: Registry, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    """Let the process die before its request ``at``."""
    client: Any = registry.server.client  # type: ignore[union-attr]
    made = 0

    def counted(name: str) -> None:
        original = getattr(client, name)

        def request(*args: Any, **more: Any) -> Any:
            nonlocal made
            made += 1
            if made == at:
                raise Dead
            return original(*args, **more)

        monkeypatch.setattr(client, name, request)

    for name in REQUESTS:
        counted(name)


def state(registry: Registry) -> list[tuple[object, ...]]:
    return [(version.reference, version.aliases, len(version.decisions)) for version in registry.list()]


@pytest.mark.parametrize("at", [1, 2, 3])
def test_a_registration_is_finished(uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    registry = Registry(tmp_path / "mine", uri=uri)
    die(registry, monkeypatch, at)
    with pytest.raises(Dead):
        registry.register("arm", "plant", FILES, {"n": 1}, {"rmse": 0.5})
    (journal,) = (tmp_path / "mine").glob("registry-*.journal")
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    again = Registry(tmp_path / "mine", uri=uri)
    assert state(again) == [("arm@1", ("candidate",), 0)]
    assert not journal.exists()
    assert again.register("arm", "plant", FILES, {"n": 1}).version == 1
    assert again.load("arm").metrics == {"rmse": 0.5}


@pytest.mark.parametrize("at", [1, 2, 3, 4])
def test_a_promotion_is_finished(uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    registry = Registry(tmp_path / "mine", uri=uri)
    registry.register("arm", "plant", FILES, {"n": 1})
    die(registry, monkeypatch, at)
    with pytest.raises(Dead):
        decide(registry, "arm@1", None, [PASSED])
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    again = Registry(tmp_path / "mine", uri=uri)
    assert again.register("arm", "plant", FILES, {"n": 2}).reference == "arm@2", "the next command, also one that changes"
    assert state(again) == [("arm@1", ("champion",), 1), ("arm@2", ("candidate",), 0)]


def test_a_journal_that_is_damaged_is_named(uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    registry = Registry(tmp_path / "mine", uri=uri)
    registry.register("arm", "plant", FILES, {"n": 1})
    (tmp_path / "mine" / registry.server.journal).write_text("{")  # type: ignore[union-attr]
    with pytest.raises(StoreError, match=r"registry-.*\.journal: not readable .*Delete it"):
        registry.list()


def test_figures_changed_on_the_server_are_noticed_and_aliases_are_its_users_own(uri: str, tmp_path: Path) -> None:
    registry = Registry(tmp_path / "mine", uri=uri)
    registry.register("arm", "plant", FILES, {"n": 1}, {"rmse": 0.5})
    registry.server.client.set_registered_model_alias("arm", "best", "1")  # type: ignore[union-attr]
    assert registry.find("arm@best").aliases == ("best", "candidate")
    with closing(sqlite3.connect(tmp_path / "server.db")) as connection, connection:
        connection.execute("UPDATE model_version_tags SET value = '{\"rmse\": 0.1}' WHERE key = 'sysid.metrics'")
    with pytest.raises(StoreError, match="arm@1: its figures or decisions were changed"):
        registry.find("arm")
    with pytest.raises(SettingsError, match="on a server"):
        registry.repair()
