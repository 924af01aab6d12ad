"""``sysid datasets diff · split · lineage · vacuum`` and ``sysid ingest --append``, as a user meets them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import run
from stored import MACHINE, small_dataset

from sysid.datasets import Store
from sysid.datasets.versions.manifest import PartRecord
from sysid.registry import ModelVersion, Registry
from sysid.workspace import Workspace


def record(folder: Path, seed: int) -> None:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    table = {"time": np.arange(500) / 100.0, "a.command": rng.uniform(-1, 1, 500), "a.joint [rad]": rng.normal(size=500)}
    pd.DataFrame(table).to_csv(folder / "log.csv", index=False)


@pytest.fixture(scope="module")
def ingested(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``demo@1`` of three recordings in ``ws``, their logs in ``logs``."""
    folder = tmp_path_factory.mktemp("ingested")
    for index in range(3):
        record(folder / "logs" / f"r{index}", index)
    (folder / "logs/machine.toml").write_text(MACHINE)
    assert run("--workspace", folder / "ws", "ingest", folder / "logs") == 0
    return folder


@pytest.fixture
def place(ingested: Path, tmp_path: Path) -> Path:
    """A copy of :func:`ingested`."""
    return shutil.copytree(ingested, tmp_path / "place")


def model(name: str, lineage: Mapping[str, Any]) -> ModelVersion:
    return ModelVersion(name, 1, "plant", f"{len(name):064d}", lineage)


def registered(monkeypatch: pytest.MonkeyPatch, *versions: ModelVersion) -> None:
    monkeypatch.setattr(Registry, "survey", lambda self, kind=None: versions)


def test_append_then_diff_then_split(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    workspace = ("--workspace", place / "ws")
    record(place / "logs/r3", 3)
    capsys.readouterr()
    assert run(*workspace, "ingest", place / "logs", "--append", "demo", "--json", place / "a.json") == 0
    assert "added to demo@1: r3 as fit" in capsys.readouterr().out
    assert json.loads((place / "a.json").read_text())["dataset"] == "demo@2"
    assert run(*workspace, "ingest", place / "logs", "--append", "demo") == 0
    assert "demo@2 already holds all of these recordings: nothing was added." in capsys.readouterr().out
    assert run(*workspace, "datasets", "diff", "demo@1", "demo@2", "--json", place / "d.json") == 0
    assert "recording added: r3" in capsys.readouterr().out
    assert json.loads((place / "d.json").read_text())["recordings"]["added"] == ["r3"]
    assert run(*workspace, "datasets", "diff", "demo@2", "demo") == 0
    assert "No differences." in capsys.readouterr().out
    assert run(*workspace, "datasets", "split", "demo", "--held-out", "r3", "--held-out", "r0", "--fit", "r2") == 0
    assert "demo@3: the tables of demo@2." in capsys.readouterr().out
    assert Store(place / "ws").load("demo@3").splits == {"r0": "held_out", "r1": "select", "r2": "fit", "r3": "held_out"}
    assert run(*workspace, "datasets", "demo@3", "--json", place / "s.json") == 0
    tables = json.loads((place / "s.json").read_text())["tables"]
    assert [table["recordings"] for table in tables] == [["r0", "r1", "r2"], ["r3"]]
    assert all(Path(table[which], "_delta_log").is_dir() for table in tables for which in ("samples", "channels"))


def test_a_table_of_differences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(tmp_path)
    dataset, channels = small_dataset(1)
    store.save(dataset, channels, PartRecord(1))
    other, _ = small_dataset(1)
    dataset.recordings[0].table.loc[5, "a.joint"] += 0.5
    from dataclasses import replace

    store.save(replace(other, digest="1" * 64, recordings=dataset.recordings), channels, PartRecord(1))
    assert run("--workspace", tmp_path, "datasets", "diff", "demo@1", "demo@2") == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "a.joint" in line)
    assert row.split() == ["s1-r0", "a.joint", "50", "1", "0.5", "0.0714", "rad"]


def test_lineage_ends_at_the_models(place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    digest = Store(place / "ws").load("demo").digest
    registered(monkeypatch, model("crane", {"dataset_digest": digest}), model("policy", {"plant": "crane@1"}), model("x", {}))
    capsys.readouterr()
    assert run("--workspace", place / "ws", "datasets", "lineage", "demo@1", "--json", place / "l.json") == 0
    text = capsys.readouterr().out
    found = json.loads((place / "l.json").read_text())
    assert [item["model"] for item in found["models"]] == ["crane@1", "policy@1"]
    for source in found["parts"][0]["sources"]:
        assert source["sha256"][:12] in text
    assert found["parts"][0]["settings"]["rate_hz"] == 100.0
    assert "model     policy@1" in text


def test_vacuum_says_first_and_keeps_what_models_need(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    workspace = ("--workspace", place / "ws")
    for number in (3, 4):
        record(place / f"logs/r{number}", number)
        assert run(*workspace, "ingest", place / "logs", "--name", "demo") == 0
    registered(monkeypatch, model("crane", {"steps": [{"dataset": "demo@1"}]}), model("demo", {"plant": "demo@2"}))
    capsys.readouterr()
    assert run(*workspace, "datasets", "vacuum", "--keep", "1") == 0
    text = capsys.readouterr().out
    assert "would remove demo@2" in text
    assert "kept demo@1: plant crane@1 was made from it" in text
    assert "Nothing was removed yet: the same command with --yes removes it." in text
    assert [entry.version for entry in Store(place / "ws").list()] == [1, 2, 3]
    assert run(*workspace, "datasets", "vacuum", "--keep", "1", "--yes", "--json", place / "v.json") == 0
    assert [item["what"] for item in json.loads((place / "v.json").read_text())["removed"]] == ["demo@2"]
    assert [entry.version for entry in Store(place / "ws").list()] == [1, 3]
    capsys.readouterr()
    assert run(*workspace, "datasets", "vacuum", "demo@1") == 2
    assert "demo@1: not removed: plant crane@1 was made from it" in capsys.readouterr().err
    assert [entry.version for entry in Store(place / "ws").list()] == [1, 3]
    assert run(*workspace, "datasets", "vacuum", "demo@3") == 0, "a version that is named needs no further word"
    assert [entry.version for entry in Store(place / "ws").list()] == [1]


def test_models_are_found_through_models_and_not_by_a_name_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plant and a dataset may both be called ``demo@1``."""
    registered(
        monkeypatch,
        model("demo-actuator", {"dataset": "demo@1", "dataset_digest": "d1"}),
        model("demo", {"networks": "demo-actuator@1", "plant": "demo@2"}),
        model("policy", {"plant": "demo@1"}),
        model("other", {"evidence": {"dataset_digest": "d2"}}),
    )
    workspace = Workspace(tmp_path)
    assert [v.name for v in workspace.made_from("demo@1", "d1")] == ["demo-actuator", "demo", "policy"]
    assert [v.name for v in workspace.made_from("demo@2", "d2")] == ["other"]
    assert workspace.made_from("demo@3", "d3") == ()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("datasets", "diff", "demo", "dmo"), "no dataset 'dmo'; expected 'demo'?"),
        (("datasets", "split", "demo"), "no role; expected --fit, --select or --held-out"),
        (("datasets", "split", "demo", "--fit", "r9"), "splits.fit: no recording 'r9'"),
        (("datasets", "split", "demo", "--fit", "r*", "--held-out", "r1"), "'r1' is both fit and held_out"),
        (("datasets", "vacuum", "--dry-run", "--yes"), "--dry-run with --yes"),
        (("ingest", "logs", "--role", "fit"), "given without --append"),
        (("ingest", "logs", "--append", "demo", "--name", "x"), "'x' with --append"),
        (("ingest", "logs", "--append", "demo", "--role", "held-out"), "expected 'held_out'?"),
    ],
)
def test_mistakes_are_one_paragraph(
    place: Path, args: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run("--workspace", place / "ws", *(place / arg if arg == "logs" else arg for arg in args)) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_disk_that_fails_is_no_mistake_of_the_user(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    record(place / "logs/r3", 3)
    monkeypatch.setattr("sysid.datasets.versions.files.LocalFiles.publish", full)
    capsys.readouterr()
    assert run("--workspace", place / "ws", "ingest", place / "logs", "--append", "demo") == 1
    error = capsys.readouterr().err
    assert "No space left on device); no version was made" in error
    assert [line.startswith("sysid: ") for line in error.splitlines() if not line.startswith("ingest:")] == [True]  # progress
