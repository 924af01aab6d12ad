"""Environments from the registry: what fits is built, what does not is refused by name."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from crane_store import crane_registry

from sysid.cli.app import app
from sysid.errors import SettingsError, StoreError
from sysid.registry import Registry
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.factory import from_versions
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.task import Task


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("versions")
    crane_registry(folder)
    return folder


@pytest.fixture
def registry(workspace: Path) -> Registry:
    return Registry(workspace)


def test_both_settings_come_from_the_same_versions(registry: Registry) -> None:
    still = from_versions(registry, "crane", "crane-forward@1", size=3, task=Task(steps=7))
    assert isinstance(still, KinematicEnvironment)
    assert (still.size, still.steps, still.plant.reference) == (3, 7, "crane@1")
    driven = from_versions(registry, "crane@1", "crane-forward", full=True, feedback="plant", history=3)
    assert isinstance(driven, DrivenEnvironment)
    assert (driven.feedback, driven.history) == ("plant", 3)
    with pytest.raises(SettingsError, match="settings history; expected none: they belong to the full path"):
        from_versions(registry, "crane", "crane-forward", history=3)


def test_a_forward_model_of_another_machine_is_refused(registry: Registry) -> None:
    message = r"other-forward@1: was trained on another machine \(dataset digger@3\); expected .* crane@1: crane"
    with pytest.raises(SettingsError, match=message):
        from_versions(registry, "crane", "other-forward")


def test_a_plant_that_lacks_a_joint_is_refused(registry: Registry) -> None:
    with pytest.raises(SettingsError, match="plant crane@1: has no joint 'wrist'; expected the joints of wrist-forward@1"):
        from_versions(registry, "crane", "wrist-forward")


def test_a_version_of_another_kind_is_refused(registry: Registry) -> None:
    with pytest.raises(StoreError, match="is of kind 'forward'; expected a version of kind 'plant'"):
        from_versions(registry, "crane-forward", "crane-forward")
    with pytest.raises(StoreError, match="is of kind 'plant'; expected a version of kind 'forward'"):
        from_versions(registry, "crane", "crane")


def test_the_verb_tracks_and_writes_what_it_says(workspace: Path, tmp_path: Path) -> None:
    square = tmp_path / "square.csv"
    square.write_text("t,x,y,z\n0,0.8,0,0.3\n1,0.85,0.05,0.3\n2,0.85,0,0.35\n", "utf-8")
    words = ["--workspace", str(workspace), "track", "ik", "--path", str(square), "--full", "--baseline", "ik-lookahead"]
    words += ["--forward", "crane-forward", "--json", str(tmp_path / "out.json"), "--out", str(tmp_path / "run")]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0
    said = json.loads((tmp_path / "out.json").read_text("utf-8"))
    assert [row["policy"] for row in said["rows"]] == ["ik", "ik-lookahead"]
    assert (said["plant"], said["forward"], said["controller"], said["full"]) == ("crane@1", "crane-forward@1", "tuned", True)
    assert said["rows"][0]["steps"] == 200
    assert said["rows"][1]["lookahead_s"] == pytest.approx(0.11)
    assert (tmp_path / "run" / "from-above.svg").is_file()
    assert "200 steps at 100 Hz" in done.output
    with pytest.raises(StoreError, match="no model 'nobody'"):
        CliRunner().invoke(app, ["--workspace", str(workspace), "track", "nobody"], catch_exceptions=False)
    words = ["--workspace", str(workspace), "track", "ik", "--untuned", "--forward", "crane-forward"]
    with pytest.raises(SettingsError, match="--untuned: without --full"):
        CliRunner().invoke(app, words, catch_exceptions=False)
