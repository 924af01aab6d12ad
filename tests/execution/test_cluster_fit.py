"""Fits of several datasets as tasks: the networks of one process, in processes and on a real Dask scheduler."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from crane_data import poses
from dask_cluster import cluster
from pose_workspace import pose_workspace

from sysid.cli import main
from sysid.workspace import Workspace

NAMES = ("one", "two")


def workspace(folder: Path) -> Workspace:
    """A workspace with two datasets of static poses, and a recipe beside it."""
    return pose_workspace(folder, {name: poses(count=80 + 20 * number) for number, name in enumerate(NAMES)})


def fit(place: Workspace, *args: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--workspace", str(place.folder), "fit", "forward", *args, "--recipe", str(place.folder.parent / "quick.toml")])
    assert not stop.value.code


def networks(place: Workspace) -> list[dict[str, str]]:
    """SHA-256 of the files of each network."""
    return [dict(place.models.load(f"{name}-forward@1").sha256) for name in NAMES]


@pytest.mark.slow
def test_several_datasets_get_the_networks_of_single_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    alone, processes = (workspace(tmp_path / name) for name in ("alone", "processes"))
    for name in NAMES:
        fit(alone, name)
    fit(processes, *NAMES, "--workers", "2", "--json", str(tmp_path / "fits.json"))
    fits = json.loads((tmp_path / "fits.json").read_text())["fits"]
    assert [each["model"] for each in fits] == [f"{name}-forward@1" for name in NAMES]
    assert "two-forward@1" in capsys.readouterr().out
    assert networks(processes) == networks(alone)


@pytest.mark.slow
def test_a_cluster_fits_the_same_networks(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    alone, distributed = (workspace(tmp_path / name) for name in ("alone", "cluster"))
    for name in NAMES:
        fit(alone, name)
    with cluster(tmp_path / "dask") as (address, _):
        fit(distributed, *NAMES, "--cluster", address)
    assert networks(distributed) == networks(alone)


def test_a_dataset_that_cannot_be_fitted_leaves_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = workspace(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["--workspace", str(place.folder), "fit", "forward", "one", "missing", "--recipe", str(tmp_path / "quick.toml")])
    assert stop.value.code == 2
    assert "missing" in capsys.readouterr().err
    assert [version.reference for version in place.models.list()] == ["one-forward@1"]
