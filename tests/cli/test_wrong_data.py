"""Implausible data on the command line: ingest shows them, ``--quality`` too, and ``gap`` stops before it searches."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from lift_logs import write_lift

PAGE = Path(__file__).parents[2] / "docs/guide/wrong-data.md"


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Joint angles in degrees under a header that says rad."""
    folder = tmp_path_factory.mktemp("lift")
    write_lift(folder, [0.0, 1.0, 0.0, -1.0, 0.0, 0.5, 0.0, -0.5, 0.0], np.degrees)
    return folder


@pytest.fixture(scope="module")
def workspace(wrong: Path) -> Path:
    found = wrong / "found.json"
    arguments = ("ingest", wrong / "logs", "--machine", wrong / "machine.toml", "--json", found)
    assert run("--workspace", wrong / "ws", *arguments) == 0
    (finding,) = json.loads(found.read_text("utf-8"))["plausibility"]
    assert finding["severity"] == "severe"
    assert finding["keys"] == ["boom.joint:range"]
    assert finding["causes"][0]["factor"] == pytest.approx(180.0 / np.pi)
    return wrong / "ws"


def test_quality_shows_the_finding(workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("--workspace", workspace, "datasets", "lift", "--quality", "--json", tmp_path / "q.json") == 0
    printed = capsys.readouterr().out
    assert "SEVERE  boom.joint:range" in printed
    assert "boom.joint is in degrees, but read as rad (too large by a factor of 57.3)" in printed
    assert json.loads((tmp_path / "q.json").read_text("utf-8"))["plausibility"][0]["keys"] == ["boom.joint:range"]


def test_gap_stops_before_it_searches(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("--workspace", workspace, "gap", "lift") == 2
    shown = capsys.readouterr()
    assert "SEVERE  boom.joint:range" in shown.out
    assert "--accept 'boom.joint:range'" in shown.err
    assert not (workspace / "results").exists()


@pytest.mark.parametrize("pattern", ["boom.joint:range", "boom.*"])
def test_an_accepted_finding_does_not_stop(workspace: Path, pattern: str, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("--workspace", workspace, "gap", "lift", "--localise", "--accept", pattern) == 0
    assert "accepted: boom.joint:range" in capsys.readouterr().out


def test_a_key_that_does_not_exist_suggests_the_nearest(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("--workspace", workspace, "gap", "lift", "--accept", "boom.joint:rang") == 2
    assert "no finding has this key; expected 'boom.joint:range'?" in capsys.readouterr().err


@pytest.mark.slow
def test_the_page_shows_what_the_commands_print(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    """The example of docs/guide/wrong-data.md, word by word."""
    folder = tmp_path / "excavator"
    shutil.copytree(shared_data / "rc_excavator", folder / "logs")
    shutil.copy(datasets_folder / "rc_excavator/machine.toml", folder)
    recipe = (datasets_folder / "rc_excavator/recipe.toml").read_text("utf-8")
    (folder / "recipe.toml").write_text(
        recipe.replace('unit = "mm"', 'unit = "cm"').replace("schema = 1", 'schema = 1\nlogs = "logs"')
    )
    blocks = re.findall(r"^```(sh|console)\n(.*?)^```$", PAGE.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert [kind for kind, _ in blocks] == ["sh", "console", "sh", "console"]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "SYSID_WORKSPACE": str(tmp_path / "workspace")}
    for (_, command), (_, expected), status in ((blocks[0], blocks[1], 0), (blocks[2], blocks[3], 2)):
        done = subprocess.run(
            ["bash", "-c", command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == status, done.stderr
        assert expected in done.stdout + done.stderr
