"""``sysid init`` lays out folders that the rest of the toolkit accepts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.cli import main
from sysid.datasets import Store
from sysid.datasets.recipe import load_recipe
from sysid.machine import load_machine


def run(*args: str | Path) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(arg) for arg in args])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_layout_is_valid_as_it_stands(tmp_path: Path) -> None:
    assert run("init", tmp_path / "My Crane", "--json", tmp_path / "made.json") == 0
    folder = tmp_path / "My Crane" / "datasets" / "my-crane"
    machine = load_machine(folder / "machine.toml")
    recipe = load_recipe(folder / "recipe.toml")
    assert recipe.name == "my-crane"
    assert machine.name == "my-crane"
    assert machine.axis("boom").driven == "boom.cylinder"
    assert {path.name for path in (tmp_path / "My Crane").iterdir()} == {"datasets", "pipelines", "rl", "reports", ".gitignore"}
    assert f"datasets/{machine.name}/recipe.toml" in json.loads((tmp_path / "made.json").read_text())["made"]


def test_logs_in_the_laid_out_folder_are_ingested_as_the_templates_stand(tmp_path: Path) -> None:
    run("init", tmp_path / "lift")
    folder = tmp_path / "lift" / "datasets" / "lift"
    time = np.arange(0.0, 20.0, 0.01)
    table = {"time": time, "joystick_y": 50.0 * np.sin(time), "draw_wire_1": 80.0 + 20.0 * np.sin(time - 0.3)}
    (folder / "logs" / "day-1").mkdir()
    pd.DataFrame(table).to_csv(folder / "logs" / "day-1" / "crane.csv", index=False)
    assert run("--workspace", tmp_path / "ws", "ingest", folder) == 0
    dataset = Store(tmp_path / "ws").load("lift")
    values = np.concatenate([recording.values("boom.command") for recording in dataset.recordings])
    assert 0.45 < np.nanmax(values) <= 0.5, "per cent became 1"
    assert dataset.units["boom.cylinder"] == "m"


def test_a_second_run_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("init", tmp_path / "crane")
    path = tmp_path / "crane" / "datasets" / "crane" / "machine.toml"
    path.write_text(path.read_text() + "# mine\n")
    capsys.readouterr()
    assert run("init", tmp_path / "crane") == 0
    assert path.read_text().endswith("# mine\n")
    assert "made" not in capsys.readouterr().out


def test_a_name_that_cannot_be_a_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", tmp_path, "--name", "../x") == 2
    assert "lower-case letters" in capsys.readouterr().err
