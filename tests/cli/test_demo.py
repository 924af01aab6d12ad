"""``sysid demo`` runs the pipeline of its own checkout, and never what lies in the folder that it is called in."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sysid.cli import main
from sysid.cli.demo import PIPELINE as SHIPPED_PIPELINE
from sysid.errors import SettingsError
from sysid.front.shipped import CHECKOUT, shipped_file

PIPELINE = """
import json
from pathlib import Path

def main(workspace: Path) -> Path:
    path = workspace / "demo" / "result.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"schema": 1, "ran": %r}))
    return path
"""


def checkout(folder: Path, word: str) -> Path:
    (folder / "pipelines").mkdir(parents=True)
    (folder / "pipelines" / "first_look.py").write_text(PIPELINE % word)
    (folder / "pyproject.toml").write_text("")
    return folder


def test_demo_runs_the_pipeline_of_its_checkout_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sysid.front.shipped.CHECKOUT", checkout(tmp_path / "own", "own"))
    (checkout(tmp_path / "stranger", "stranger") / "deeper").mkdir()
    for here in ("stranger", "stranger/deeper"):
        monkeypatch.chdir(tmp_path / here)
        with pytest.raises(SystemExit) as stop:
            main(["--workspace", str(tmp_path / here / "ws"), "demo", "--json", str(tmp_path / "copy.json")])
        assert stop.value.code == 0, capsys.readouterr().err
        assert json.loads((tmp_path / "copy.json").read_text()) == {"schema": 1, "ran": "own"}


def test_a_wheel_has_its_own_demo_and_a_broken_one_says_so(tmp_path: Path) -> None:
    site = checkout(tmp_path / "site", "other package")
    (site / "pyproject.toml").unlink()
    with pytest.raises(SettingsError, match=r"no pipelines/first_look\.py in .*Install the wheel again"):
        shipped_file(SHIPPED_PIPELINE, site, tmp_path / "shipped")
    shipped = checkout(tmp_path / "shipped", "shipped")
    assert shipped_file(SHIPPED_PIPELINE, site, shipped) == shipped / "pipelines/first_look.py"
    assert shipped_file(SHIPPED_PIPELINE, CHECKOUT, shipped) == Path(__file__).parents[2] / "pipelines" / "first_look.py"


def test_the_arm_is_its_own_pipeline_and_takes_what_to_hide(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = checkout(tmp_path / "own", "crane")
    text = PIPELINE.replace("workspace: Path)", "workspace: Path, hide=())").replace("%r", "list(hide)")
    (own / "pipelines" / "demo_arm.py").write_text('HIDDEN = ("default",)\n' + text)
    monkeypatch.setattr("sysid.front.shipped.CHECKOUT", own)
    for number, (words, ran) in enumerate(((["--hide", "a=1", "--hide", "b=2"], ["a=1", "b=2"]), ([], ["default"]))):
        with pytest.raises(SystemExit) as stop:
            main(["--workspace", str(tmp_path / str(number)), "demo", "--arm", *words, "--json", str(tmp_path / "r.json")])
        assert stop.value.code == 0, capsys.readouterr().err
        assert json.loads((tmp_path / "r.json").read_text())["ran"] == ran
    with pytest.raises(SystemExit) as stop:
        main(["--workspace", str(tmp_path / "x"), "demo", "--hide", "a=1"])
    assert stop.value.code == 2
    assert "--hide without --arm" in capsys.readouterr().err
