"""``sysid demo`` runs the pipeline of the folder that it is called in."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sysid.cli import main

PIPELINE = """
import json
from pathlib import Path

def main(workspace: Path) -> Path:
    path = workspace / "demo" / "result.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"schema": 1, "here": True}))
    return path
"""


def test_demo_runs_the_pipeline_above_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pipelines").mkdir()
    (tmp_path / "pipelines" / "first_look.py").write_text(PIPELINE)
    (tmp_path / "deeper").mkdir()
    monkeypatch.chdir(tmp_path / "deeper")
    with pytest.raises(SystemExit) as stop:
        main(["--workspace", str(tmp_path / "ws"), "demo", "--json", str(tmp_path / "copy.json")])
    assert stop.value.code == 0, capsys.readouterr().err
    assert json.loads((tmp_path / "copy.json").read_text()) == {"schema": 1, "here": True}
