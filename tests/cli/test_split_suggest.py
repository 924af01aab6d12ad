"""Roles on the console: what ingest and --quality say about them, --suggest, and logs that `gap` refuses at once."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from axis_motion import AXES_OF_TEST, write_logs
from command_line import run

from sysid.datasets import Store
from sysid.datasets.checks.roles import role_lacks


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Six recordings; the stick moves in the first three, and the recipe holds out one in which it rests."""
    return write_logs(
        tmp_path, AXES_OF_TEST, [(f"run {name}", 30.0, AXES_OF_TEST if name in "abc" else ("boom",)) for name in "abcdef"]
    )


def ingest(folder: Path, recipe: str, name: str = "lift") -> int:
    (folder / "recipe.toml").write_text(f"schema = 1\n{recipe}\n")
    parts = ("--machine", folder / "machine.toml", "--recipe", folder / "recipe.toml", "--name", name)
    return run("--workspace", folder / "ws", "ingest", folder / "logs", *parts, "--json", folder / f"{name}.json")


def test_the_automatic_roles_need_no_note(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest(folder, "") == 0
    assert "note:" not in capsys.readouterr().out
    value = json.loads((folder / "lift.json").read_text())
    assert (value["needs"], value["lacks"]) == (None, [])
    assert run("--workspace", folder / "ws", "datasets", "split", "lift", "--suggest") == 0
    out = capsys.readouterr().out
    assert "No role lacks motion." in out
    assert "suggested" not in out


def test_a_lack_is_said_before_gap_with_a_command_that_removes_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ws = folder / "ws"
    assert ingest(folder, '[splits]\nfit = ["run [abc]"]\nselect = ["run d", "run e"]\nheld_out = ["run f"]') == 0
    out = capsys.readouterr().out
    assert "note: stick does not move in the selection and test recordings" in out
    assert f"sysid --workspace {ws} datasets split lift@1 --suggest" in out
    assert json.loads((folder / "lift.json").read_text())["lacks"][0]["roles"] == ["select", "held_out"]
    assert run("--workspace", ws, "datasets", "lift", "--quality") == 0
    assert "note: stick does not move in the selection and test recordings" in capsys.readouterr().out
    assert run("--workspace", ws, "datasets", "split", "lift", "--suggest") == 0
    assert "named in the recipe, unchanged: run a, run b" in capsys.readouterr().out


def test_the_path_of_the_workspace_is_quoted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "recipe.toml").write_text(
        'schema = 1\n[splits]\nfit = ["run [abc]"]\nselect = ["run d"]\nheld_out = ["run [ef]"]\n'
    )
    ws, logs = folder / "my work", ("--machine", folder / "machine.toml", "--recipe", folder / "recipe.toml")
    assert run("--workspace", ws, "ingest", folder / "logs", *logs, "--name", "lift") == 0
    assert f"sysid --workspace '{ws}' datasets split lift@1 --suggest" in capsys.readouterr().out


def test_the_printed_command_applies_the_suggestion(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ws = folder / "ws"
    assert ingest(folder, "") == 0
    roles = ("--fit", "run [abc]", "--select", "run [de]", "--held-out", "run f")
    assert run("--workspace", ws, "datasets", "split", "lift@1", *roles) == 0
    capsys.readouterr()
    assert run("--workspace", ws, "datasets", "split", "lift@2", "--suggest", "--json", folder / "s.json") == 0
    value, out = json.loads((folder / "s.json").read_text()), capsys.readouterr().out
    assert value["better"]
    assert value["present"]["motion"]["held_out"]["stick"]["forward_s"] == 0.0
    assert value["suggested"]["motion"]["held_out"]["stick"]["forward_s"] > 1.5
    assert [lack["kind"] for lack in value["present"]["lacks"]] == ["motion"]
    assert value["suggested"]["lacks"] == []
    assert value["command"] in out
    header = next(line for line in out.splitlines() if "axis" in line)
    assert " ".join(header.split()) == "axis role now s − / + reversals suggested s − / + reversals"
    assert Store(ws).versions("lift") == [1, 2], "nothing is created"
    words = shlex.split(value["command"])
    assert words[0] == "sysid"
    assert run(*words[1:]) == 0
    repaired = Store(ws).load("lift@1")  # these roles are those of the first version
    assert role_lacks(repaired) == ()
    assert dict(repaired.splits) == value["suggested"]["roles"]
    assert ingest(folder, value["recipe"], "again") == 0
    assert dict(Store(ws).load("again").splits) == value["suggested"]["roles"], "the lines for the recipe do the same"


def test_suggest_takes_no_roles(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ingest(folder, "") == 0
    assert run("--workspace", folder / "ws", "datasets", "split", "lift", "--suggest", "--fit", "run a") == 2
    assert "--suggest with roles" in capsys.readouterr().err


def test_recordings_of_one_axis_each_are_cut(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_logs(tmp_path, AXES_OF_TEST, [("boom", 60.0, ("boom",)), ("stick", 60.0, ("stick",)), ("rest", 20.0, ())])
    assert ingest(folder, '[splits]\nfit = ["boom"]\nselect = ["rest"]\nheld_out = ["stick"]', "named") == 0
    assert ingest(folder, "") == 0
    assert "stick#3" in capsys.readouterr().out
    assert role_lacks(Store(folder / "ws").load("lift")) == ()
    assert {lack.kind for lack in role_lacks(Store(folder / "ws").load("named"))} == {"motion"}


def test_a_short_log_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In a process of its own: nothing of the workflow is even imported, so that nothing is compiled."""
    folder = write_logs(tmp_path, AXES_OF_TEST, [("only", 3.0, AXES_OF_TEST)])
    assert ingest(folder, "") == 0
    out = capsys.readouterr().out
    need = (
        "4 s of recorded motion or more in each role (fit, selection and test); there is 3.0 s for fit, 0.0 s for selection, "
        "0.0 s for test. Record 15 s or more in one recording, which is then cut for the roles, or three recordings of 4 s or "
        "more."
    )
    assert f"note: sysid gap will need {need}" in " ".join(out.split())
    assert json.loads((folder / "lift.json").read_text())["needs"]["found"].startswith("3.0 s for fit")
    assert run("--workspace", folder / "ws", "datasets", "lift", "--quality") == 0
    assert capsys.readouterr().out.count("sysid gap will need 4 s of recorded motion") == 1
    code = (
        "import sys\nfrom sysid.cli import main\n"
        f"try:\n    main(['--workspace', {str(folder / 'ws')!r}, 'gap', 'lift'])\n"
        "except SystemExit as stop:\n    print('RC', stop.code, sorted({'numba', 'sysid.gap', 'sysid.plant'} & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "RC 2 []"
    assert "lift@1: 3.0 s for fit" in done.stderr
    assert "Record 15 s or more in one recording" in done.stderr


def test_long_recordings_in_one_role_are_refused_with_what_helps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_logs(tmp_path, AXES_OF_TEST, [("only", 60.0, AXES_OF_TEST)])
    assert ingest(folder, '[splits]\nfit = ["only"]') == 0
    assert run("--workspace", folder / "ws", "gap", "lift") == 2
    assert "leave [splits] out of the recipe and ingest them again" in capsys.readouterr().err
    assert ingest(folder, "") == 0
    assert "note:" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("runs", [[("one", 15.0)], [("a", 4.0), ("b", 4.0), ("c", 4.0)]])
def test_the_least_length_is_searched(tmp_path: Path, runs: list[tuple[str, float]]) -> None:
    """What the message asks to record is then accepted."""
    folder = write_logs(tmp_path, AXES_OF_TEST, [(name, seconds, AXES_OF_TEST) for name, seconds in runs])
    assert ingest(folder, "") == 0
    assert run("--workspace", folder / "ws", "gap", "lift") == 0
