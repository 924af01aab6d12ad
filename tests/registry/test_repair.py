"""What another hand changes in the registry is noticed, and what is old, broken or lost is mended or said."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from sysid.cli import main
from sysid.errors import StorageError, StoreError
from sysid.registry import Check, DamagedModel, Registry, decide
from sysid.registry.schema import empty_registry
from sysid.registry.stored import ModelChange
from sysid.registry.tables import apply

FILES = {"plant.json": b"{}"}
PASSED = Check("rmse", "passed", "boom.joint: rmse 1 mrad")


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``arm@1`` (champion), ``arm@2`` (candidate), ``leg@1``."""
    workspace = tmp_path_factory.mktemp("template")
    registry = Registry(workspace)
    for name, number in (("arm", 1), ("arm", 2), ("leg", 1)):
        registry.register(name, "plant", FILES, {"name": name, "n": number}, {"rmse": 0.5 * number})
    decide(registry, "arm@1", None, [PASSED])
    return workspace


@pytest.fixture
def workspace(template: Path, tmp_path: Path) -> Path:
    return shutil.copytree(template, tmp_path / "ws")


def execute(workspace: Path, *statements: str) -> None:
    with closing(sqlite3.connect(workspace / "registry.db")) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def state(workspace: Path) -> list[tuple[object, ...]]:
    return [
        (version.reference, version.aliases, dict(version.metrics), len(version.decisions), version.created_ms)
        for version in Registry(workspace).list()
    ]


METRICS = "UPDATE model_version_tags SET value = '{\"rmse\": 0.1}' WHERE key = 'sysid.metrics' AND name = 'arm' AND version = 2"
ALIAS = "UPDATE registered_model_aliases SET version = 2 WHERE alias = 'champion'"
OTHER_ALIAS = "INSERT INTO registered_model_aliases (alias, version, name) VALUES ('best', 2, 'arm')"
DECISION = "DELETE FROM model_version_tags WHERE key LIKE 'sysid.decision%'"
SEAL = "DELETE FROM model_version_tags WHERE key = 'sysid.seal' AND name = 'arm' AND version = 2"
MODEL_SEAL = "DELETE FROM registered_model_tags WHERE key = 'sysid.seal' AND name = 'arm'"
TIME = "UPDATE model_versions SET creation_time = 5 WHERE name = 'arm' AND version = 1"


@pytest.mark.parametrize(
    ("change", "reference", "message"),
    [
        (METRICS, "arm@2", "arm@2: its figures or decisions were changed by hand.*sysid models repair"),
        (DECISION, "arm@1", "arm@1: its figures or decisions were changed"),
        (SEAL, "arm@2", "arm"),
        (
            ALIAS,
            "arm",
            "its aliases were changed by hand .candidate is version 2, champion is version 2.; .*champion is version 1",
        ),
        (OTHER_ALIAS, "arm@1", "its aliases were changed by hand .best is version 2"),
        (MODEL_SEAL, "arm@1", "the seal of its aliases is missing"),
        (TIME, "arm@1", "rows of its versions were changed or exchanged"),
    ],
)
def test_what_was_changed_by_hand_is_not_shown_as_true(
    workspace: Path, change: str, reference: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    execute(workspace, change)
    registry = Registry(workspace)
    with pytest.raises(StoreError, match=message):
        registry.load(reference)
    with pytest.raises(StoreError, match=message):
        registry.list()
    assert registry.load("leg").metrics == {"rmse": 0.5}, "another model is not concerned"
    assert any(isinstance(entry, DamagedModel) for entry in registry.survey())
    with pytest.raises(SystemExit, match="0"):
        main(["--workspace", str(workspace), "models"])
    told = capsys.readouterr().out
    assert "leg@1" in told
    assert "damaged: " in told


@pytest.mark.parametrize("change", [METRICS, ALIAS, OTHER_ALIAS])
def test_what_was_changed_by_hand_is_set_back(workspace: Path, change: str) -> None:
    before = state(workspace)
    execute(workspace, change)
    found = Registry(workspace).repair()
    assert (len(found.done), found.left) == (1, ())
    assert state(workspace) == before
    assert Registry(workspace).repair() == type(found)((), ())


@pytest.mark.parametrize("change", [DECISION, SEAL, MODEL_SEAL, TIME])
def test_what_cannot_be_set_back_is_said_and_may_be_accepted(workspace: Path, change: str) -> None:
    execute(workspace, change)
    with pytest.raises(SystemExit, match="2"):
        main(["--workspace", str(workspace), "models", "repair"])
    assert len(Registry(workspace).repair().left) >= 1
    with pytest.raises(SystemExit, match="0"):
        main(["--workspace", str(workspace), "models", "repair", "--accept"])
    assert len(Registry(workspace).list()) == 3
    assert Registry(workspace).repair().left == ()


def half_made(workspace: Path) -> None:
    """As left by a process that was killed while MLflow made the tables."""
    (workspace / "registry.db").unlink()
    execute(workspace, "CREATE TABLE experiments (name TEXT)", "CREATE TABLE spans (name TEXT)")


def cut(workspace: Path) -> None:
    content = (workspace / "registry.db").read_bytes()
    (workspace / "registry.db").write_bytes(content[: len(content) // 3])


def overwritten(workspace: Path) -> None:
    (workspace / "registry.db").write_bytes(b"not a database, but long enough to have a header" * 10)


@pytest.mark.parametrize("damage", [half_made, cut, overwritten])
def test_a_broken_registry_is_told_apart_and_made_anew_from_the_files(workspace: Path, damage: object) -> None:
    before = state(workspace)
    damage(workspace)  # type: ignore[operator]
    with pytest.raises(StoreError, match="sysid models repair") as caught:
        Registry(workspace).list()
    assert not isinstance(caught.value, StorageError)
    with pytest.raises(StoreError, match="sysid models repair"):
        Registry(workspace).register("arm", "plant", FILES, {"n": 9})
    found = Registry(workspace).repair()
    assert "rebuilt with 3 versions, 3 of them from the model files" in found.done[0]
    assert "Decisions of restored versions are lost" in found.left[0]
    after = state(workspace)
    assert [row[0] for row in after] == [row[0] for row in before]
    assert [row[2] for row in after] == [row[2] for row in before], "figures"
    assert [row[4] for row in after] == [row[4] for row in before], "time"
    assert [row[1] for row in after] == [(), ("candidate",), ("candidate",)]
    assert list(workspace.glob("registry.db.broken-*"))
    assert Registry(workspace).load("arm@2").files == FILES
    assert decide(Registry(workspace), "arm@1", None, [PASSED]).promoted
    assert Registry(workspace).register("arm", "plant", FILES, {"n": 9}).version == 3


def test_a_registry_that_is_gone_is_made_anew(workspace: Path) -> None:
    (workspace / "registry.db").unlink()
    assert Registry(workspace).list() == ()
    assert "registry.db was missing" in Registry(workspace).repair().done[0]
    assert len(Registry(workspace).list()) == 3


@pytest.mark.slow
def test_an_older_schema_is_read_and_migrated(workspace: Path) -> None:
    """Tables of an MLflow that was older, made by its own migrations."""
    before = state(workspace)
    models = Registry(workspace)._tables.models()
    older(workspace / "registry.db", "acf3f17fdcc7")

    with closing(sqlite3.connect(workspace / "registry.db")) as connection, connection:
        for model in models:
            for version in model.versions:
                apply(connection, model.name, ModelChange(new=version))
            apply(connection, model.name, ModelChange(aliases=model.aliases, tags=model.tags))
    assert state(workspace) == before
    (line,) = Registry(workspace).repair().done
    assert "was migrated" in line
    assert state(workspace) == before
    with closing(sqlite3.connect(workspace / "registry.db")) as connection:
        assert [row[1] for row in connection.execute("PRAGMA table_info(registered_models)")][-1] == "workspace"


def test_a_schema_that_is_too_old_is_told_apart_and_migrated(workspace: Path) -> None:
    older(workspace / "registry.db", "3500859a5d39")
    with pytest.raises(StoreError, match=r"no column storage_location: it is of an older MLflow.*sysid models repair"):
        Registry(workspace).list()
    assert "was migrated" in Registry(workspace).repair().done[0]
    assert Registry(workspace).list() == ()


@pytest.mark.slow
def test_a_migration_that_was_interrupted_is_made_anew_from_its_rows(tmp_path: Path) -> None:
    """As versions of before left it: a table is there, and the number of its migration is not."""
    (tmp_path / "registry.db").touch()
    older(tmp_path / "registry.db", "acf3f17fdcc7")
    execute(tmp_path, "CREATE TABLE spans (name TEXT)")
    assert Registry(tmp_path).list() == ()
    assert Registry(tmp_path).register("arm", "plant", FILES, {}).version == 1
    before = state(tmp_path)
    found = Registry(tmp_path).repair()
    assert "incomplete" in found.done[0]
    assert "1 versions, 0 of them from the model files" in found.done[0]
    assert state(tmp_path) == before
    assert Registry(tmp_path).repair().done == ()


def older(path: Path, revision: str) -> None:
    import sqlalchemy
    from alembic import command
    from mlflow.store.db.utils import _get_alembic_config
    from mlflow.store.tracking.dbmodels.initial_models import Base as InitialBase

    path.unlink()
    engine = sqlalchemy.create_engine(f"sqlite:///{path}")
    sqlalchemy.event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA synchronous = OFF"))
    InitialBase.metadata.create_all(engine)
    config = _get_alembic_config(f"sqlite:///{path}")
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
    engine.dispose()


def test_a_damaged_copy_of_the_tables_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = empty_registry()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("sysid.registry.schema.migrated_tables", lambda: content)
    assert empty_registry() == content
    (kept,) = (tmp_path / "sysid" / "registry").glob("*.db")
    kept.write_bytes(content[:-1])
    monkeypatch.setattr("sysid.registry.schema.migrated_tables", lambda: content + b"new")
    assert empty_registry() == content + b"new"


def test_the_copied_tables_are_those_that_mlflow_makes() -> None:
    """MLflow opens them without a migration, and reads what was written to them."""
    from mlflow.store.db.utils import _get_latest_schema_revision

    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(empty_registry())
        assert connection.execute("SELECT version_num FROM alembic_version").fetchone() == (_get_latest_schema_revision(),)
        assert connection.execute("SELECT count(*) FROM registered_models").fetchone() == (0,)


def test_mlflow_reads_what_was_written_without_it(workspace: Path) -> None:
    from sysid.registry.client import open_client

    before = (workspace / "registry.db").read_bytes()
    client = open_client(f"sqlite:///{workspace / 'registry.db'}")
    entry = client.get_model_version_by_alias("arm", "champion")
    assert (int(entry.version), entry.current_stage, entry.status) == (1, "None", "READY")
    assert json.loads(entry.tags["sysid.metrics"]) == {"rmse": 0.5}
    assert client.get_registered_model("arm").aliases == {"candidate": 2, "champion": 1}
    assert client.get_model_version_download_uri("arm", "2").startswith("file:///")
    assert (workspace / "registry.db").read_bytes() == before


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    modes = {path: path.stat().st_mode for path in (folder, folder / "registry.db")}
    try:
        for path, mode in modes.items():
            path.chmod(mode & ~0o222)
        yield
    finally:
        for path, mode in modes.items():
            path.chmod(mode)


def test_looking_changes_nothing(workspace: Path) -> None:
    names, content = sorted(workspace.rglob("*")), (workspace / "registry.db").read_bytes()
    with read_only(workspace):
        registry = Registry(workspace)
        registry.list()
        registry.load("arm")
        registry.promoted("arm")
    assert sorted(workspace.rglob("*")) == names
    assert (workspace / "registry.db").read_bytes() == content


def test_looking_imports_no_mlflow(workspace: Path) -> None:
    import subprocess
    import sys

    script = (
        "import sys; from pathlib import Path; from sysid.registry import Registry; r = Registry(Path(sys.argv[1]));"
        "r.list(); r.register('arm', 'plant', {'plant.json': b'{}'}, {'n': 7}); print('mlflow' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script, str(workspace)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
