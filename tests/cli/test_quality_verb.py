"""``sysid datasets NAME --quality``: evidence, flags and verdicts for people and for machines."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run
from lift_logs import write_lift

from sysid.cli.dataset_tables import show_flags
from sysid.cli.output import Printer


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recordings of the same strokes at full command: three reversals in each, and no small command in any."""
    folder = tmp_path_factory.mktemp("lift")
    write_lift(folder, [0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0])
    assert run("--workspace", folder / "ws", "ingest", folder / "logs", "--machine", folder / "machine.toml") == 0
    return folder / "ws"


def test_ingest_says_where_to_look(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = workspace.parent
    capsys.readouterr()
    assert run("--workspace", workspace, "ingest", folder / "logs", "--machine", folder / "machine.toml") == 0
    assert capsys.readouterr().out.splitlines()[-1] == (
        f"Coverage and excitation: sysid --workspace {workspace} datasets lift@1 --quality"
    )


def test_the_verdicts_say_what_there_is_and_what_to_record(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", workspace, "datasets", "lift", "--quality") == 0
    out = capsys.readouterr().out
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert any(line.startswith("boom 30 % 10 % / 10 % 16.0 / 16.0 0.0 / 0.0 0.0 / 0.0 40.0 32 12") for line in lines), out
    assert "Command dead-band boom 0 of 2 s of small commands on each side" in lines
    assert "→ Record boom with slow commands from 0 to 30 % and back on both sides, 30 s." in lines
    assert "cannot be shown: machine.toml names no URDF" in lines
    assert any(line.startswith("Backlash boom ahead of the sensor 9 8 reversals") for line in lines), "three recordings count"


def test_json_holds_the_same(workspace: Path, tmp_path: Path) -> None:
    assert run("--workspace", workspace, "datasets", "lift@1", "--quality", "--json", tmp_path / "q.json") == 0
    value = json.loads((tmp_path / "q.json").read_text())
    assert (value["schema"], value["dataset"]) == (1, "lift@1")
    use = value["evidence"]["axes"]["boom"]
    assert use["reversals"] == 12
    assert use["small_positive_s"] == 0.0
    assert use["positive_s"] == pytest.approx(16.0, abs=0.1)
    deadband = next(v for v in value["readiness"]["verdicts"] if v["name"] == "valve_deadband")
    assert (deadband["status"], deadband["have"], deadband["need"]) == ("lacking", 0.0, 2.0)
    assert len(value["evidence"]["repeats"]) == 6, "every pair of the four"
    assert value["evidence"]["noise"]["boom.joint"]["repeats"] == pytest.approx(1e-3, rel=0.15)
    assert value["readiness"]["counted"] == [r for r in value["evidence"]["recordings"] if r in value["readiness"]["counted"]]


def test_flags_are_counted_and_the_first_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    flag = {"recording": "run-1", "source": "a.csv", "signal": "boom.joint", "kind": "marker_swap", "from_s": 1.5, "to_s": 2.0}
    show_flags(Printer(), [{**flag, "samples": 3, "text": f"swap {k:02}"} for k in range(15)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "flagged (values are unchanged unless stated): 15 × marker swap"
    assert lines[1] == "  run-1 1.50 s  marker swap of boom joint: swap 00"
    assert lines[-1] == "  … and 3 more (the report and --json have them all)"
    assert len(lines) == 14


def test_without_a_name_the_only_dataset_is_meant(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", workspace, "datasets", "--quality") == 0
    assert "Excitation of the effects:" in capsys.readouterr().out
    assert run("--workspace", workspace, "datasets", "lifd", "--quality") == 2
    assert "lift" in capsys.readouterr().err
