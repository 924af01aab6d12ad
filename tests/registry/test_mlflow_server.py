"""Models on a full MLflow server with a database, shared by several workspaces."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from pathlib import Path

import pytest
from mlflow_server import mlflow_server

from sysid.registry import Check, Registry, decide

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
PASSED = Check("rmse", "passed", "boom.joint: rmse 1 mrad")


@pytest.fixture(scope="module")
def uri(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with mlflow_server(tmp_path_factory.mktemp("mlflow")) as address:
        yield address


def files(number: int) -> dict[str, bytes]:
    return {"plant.json": f'{{"n": {number}}}'.encode(), "table.json": b"[" + b"1," * 20_000 + b"1]"}


def test_two_workspaces_share_versions_and_promotions(uri: str, tmp_path: Path) -> None:
    mine, theirs = (Registry(tmp_path / name, uri=uri) for name in ("mine", "theirs"))
    first = mine.register("crane", "plant", files(1), {"dataset": "lift@1"}, {"rmse": 0.5})
    assert first.reference == "crane@1"
    loaded = theirs.load("crane@1")
    assert dict(loaded.files) == files(1)
    assert (loaded.lineage["dataset"], loaded.metrics) == ("lift@1", {"rmse": 0.5})
    assert theirs.register("crane", "plant", files(1), {"dataset": "lift@1"}).version == 1, (
        "the same content is the same version"
    )
    assert theirs.register("crane", "plant", files(2), {"dataset": "lift@2"}).version == 2
    decide(theirs, "crane@2", None, [PASSED])
    promoted = mine.promoted("crane")
    assert promoted is not None
    assert promoted.reference == "crane@2"


def test_the_result_is_that_of_a_workspace_of_its_own(uri: str, tmp_path: Path) -> None:
    shared, own = Registry(tmp_path / "shared", uri=uri), Registry(tmp_path / "own")
    for registry in (shared, own):
        registry.register("arm", "plant", files(1), {"dataset": "arm@1"}, {"rmse": 0.25})
        registry.register("arm", "plant", files(2), {"dataset": "arm@2"}, {"rmse": 0.125})
        decide(registry, "arm@2", None, [PASSED])
    one, other = (registry.load("arm@2") for registry in (shared, own))
    assert dict(one.files) == dict(other.files)
    assert (one.lineage, one.metrics, one.digest) == (other.lineage, other.metrics, other.digest)
    assert [v.aliases for v in shared.list() if v.name == "arm"] == [v.aliases for v in own.list()]


def test_processes_that_register_at_once_get_a_version_each(uri: str, tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(3) as pool:
        found = pool.starmap(_registered, [(str(tmp_path / f"ws-{k}"), uri, k) for k in range(3)])
    assert sorted(found) == [1, 2, 3]
    registry = Registry(tmp_path / "reader", uri=uri)
    assert sorted(registry.load(f"slide@{n}").files["plant.json"] for n in (1, 2, 3)) == sorted(
        files(k)["plant.json"] for k in range(3)
    )


def _registered(workspace: str, uri: str, number: int) -> int:
    return (
        Registry(Path(workspace), uri=uri).register("slide", "plant", files(number), {"dataset": f"slide@{number + 1}"}).version
    )
