"""The functions of ``import sysid`` on a small machine with a known dead-band, beside the same verbs of the command line."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from deadband_logs import DEADBAND, MACHINE, write_logs

import sysid
from sysid.gap.result import Gap, Unnamed
from sysid.gap.statement import Missing
from sysid.progress import silent

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> sysid.Workspace:
    """A workspace with the dataset, beside its logs."""
    folder = tmp_path_factory.mktemp("front")
    (folder / "machine.toml").write_text(MACHINE)
    write_logs(folder / "logs")
    workspace = sysid.open(folder / "ws")
    sysid.ingest(folder / "logs", workspace, machine=folder / "machine.toml", progress=silent)
    return workspace


@pytest.fixture(scope="module")
def gap(place: sysid.Workspace) -> sysid.GapResult:
    return sysid.find_gap(workspace=place, progress=silent)


def test_every_name_is_there_and_the_functions_are_documented() -> None:
    for name in sysid.__all__:
        assert getattr(sysid, name) is not None, name
    functions = ("ingest", "start", "find_gap", "fit", "report", "open", "load", "demo_logs")
    assert [name for name in functions if not inspect.isfunction(getattr(sysid, name))] == []
    page = (ROOT / "docs/guide/python.md").read_text("utf-8")
    assert [name for name in (*functions, "export", "validate") if f"| `{name}(" not in page] == []


def test_a_package_of_the_name_of_a_function_is_called_as_the_function() -> None:
    """Whichever is imported first."""
    code = "import sysid.validate.metrics, sysid\nassert callable(sysid.validate)\nfrom sysid import export\n"
    code += "import sysid.export.names\nfor function in (export, sysid.export, sysid.validate):\n"
    code += (
        "    try:\n        function()\n    except TypeError as error:\n        print(error)\nprint(sysid.export.names.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    lines = [line.partition(" missing")[0] for line in done.stdout.splitlines()]
    assert lines == ["export()", "export()", "validate()", "sysid.export.names"]


def test_a_result_prints_as_a_short_table(gap: sysid.GapResult) -> None:
    lines = repr(gap).splitlines()
    assert lines[0].startswith("lift@1: One effect is missing")
    assert max(map(len, lines)) <= 80
    assert len(lines) < 40
    (row,) = (line for line in lines if line.startswith(" Valve dead-band"))
    assert "positive 0.110" in row
    assert any(line.split()[:1] == ["boom.cylinder"] for line in lines)
    assert repr(gap.result) == f"GapResult(lift@1: {gap.result.headline})"


def test_a_notebook_shows_tables_and_a_picture(gap: sysid.GapResult) -> None:
    page = gap._repr_html_()
    assert "<td>Valve dead-band of boom</td>" in page
    assert page.count("<table") == 2
    assert page.count("<svg") == 1


def test_what_is_not_named_or_missing_is_in_the_text(gap: sysid.GapResult) -> None:
    result = replace(
        gap.result,
        unnamed=(Unnamed("command", "boom", 1e-3, "boom.cylinder", "a ripple [x]"),),
        ambiguous=((("input_delay", "boom"), ("first_order_lag", "boom")),),
        missing=(Missing("maps of the error", "out of memory"),),
        gap=Gap({f"s{k}": 1.0 for k in range(8)}, {f"s{k}": 0.0 for k in range(8)}, {f"s{k}": 0.0 for k in range(8)}),
    )
    text = " ".join(repr(replace(gap, result=result)).split())
    for words in ("a ripple [x]", "Cannot be distinguished: ", "Out of memory", "the 6 largest errors of 8"):
        assert words in text


def test_tables_have_the_values_of_the_result(gap: sysid.GapResult) -> None:
    assert gap.verdict == "named"
    (effect,) = gap.effects
    table = gap.table().set_index("parameter")
    assert list(table.loc[["positive", "negative"], "value"]) == pytest.approx(DEADBAND, rel=0.05)
    assert all(table["low"] < table["value"])
    assert all(table["value"] < table["high"])
    assert table.loc["positive", "value"] == effect.parameters["positive"]
    assert set(table["unit"]) == {"1"}
    row = gap.errors().loc["boom.cylinder"]
    assert row["closed"] == pytest.approx((row["before"] - row["after"]) / (row["before"] - row["noise floor"]))
    assert row["closed"] > 0.95
    assert gap.errors(stages=True).loc["boom.cylinder", "before"] == gap.result.stage_gap.before["boom.cylinder"]


def test_plots_are_drawn_from_the_result(gap: sysid.GapResult, tmp_path: Path) -> None:
    path = gap.plot().save(tmp_path / "a.svg")
    assert path.read_text("utf-8").count("<polyline") == 3
    drawn = gap.plot("boom.cylinder", over="boom.command")._repr_svg_()
    item = next(item for item in gap.result.maps if item.signal == "boom.cylinder" and item.over == "boom.command")
    points = [re.split("[ ,]", text) for text in re.findall(r'points="([^"]*)"', drawn)]
    assert [len(each) for each in points] == [2 * len(item.at)] * 2
    after = np.array(points[1], dtype=float)[1::2]
    assert np.ptp(np.array(points[0], dtype=float)[1::2]) > 5 * np.ptp(after), "the repair flattens the map"
    with pytest.raises(sysid.SettingsError, match=r"no signal 'bom\.cylinder'; expected 'boom\.cylinder'\?"):
        gap.plot("bom.cylinder")
    with pytest.raises(sysid.SettingsError, match=r"no error map of boom\.cylinder over 'boom\.speed'"):
        gap.plot("boom.cylinder", over="boom.speed")


def test_the_result_and_the_repair_are_stored(gap: sysid.GapResult, place: sysid.Workspace, tmp_path: Path) -> None:
    stored = place.gap(place.dataset("lift"))
    assert stored is not None
    assert stored.effects == gap.result.effects
    assert gap.repaired.reference == "lift@2"
    made = gap.repaired.export("json", tmp_path / "out")
    assert made.plant == "lift@2"
    assert made.replay is not None
    assert made.replay.agrees
    assert json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))["dataset"] == "lift@1"


def test_the_verb_gives_the_same(gap: sysid.GapResult, place: sysid.Workspace, tmp_path: Path) -> None:
    assert run("--workspace", place.location, "gap", "lift", "--json", tmp_path / "g.json") == 0
    written = json.loads((tmp_path / "g.json").read_text("utf-8"))
    assert written["effects"] == json.loads(json.dumps(gap.result.to_json()["effects"]))
    assert written["gap"] == gap.result.to_json()["gap"]
    assert written["plant"]["after"] == ""
    assert sysid.report(workspace=place) == place.output("report.html", place.dataset("lift"))


def test_localise_stores_nothing_and_has_no_repair(place: sysid.Workspace) -> None:
    before = place.models.list()
    located = sysid.find_gap("lift", workspace=place, localise=True, progress=silent)
    assert located.verdict == "unnamed"
    first = next(line for line in repr(located).splitlines() if line.startswith(" command"))
    assert first.split()[:2] == ["command", "boom.cylinder"]
    assert place.models.list() == before
    with pytest.raises(sysid.StoreError, match=r"gap of lift@1: no repaired simulation is stored.*add=True"):
        _ = located.repaired


def test_a_dataset_of_another_workspace_is_an_error(place: sysid.Workspace, tmp_path: Path) -> None:
    with pytest.raises(sysid.StoreError, match="lift"):
        sysid.find_gap(place.dataset("lift"), workspace=tmp_path / "other", progress=silent)


def test_start_asks_by_an_error_and_goes_on_with_answers(
    gap: sysid.GapResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without its search: that of a drafted machine is in datasets/test_unstated_gain.py."""
    monkeypatch.setattr("sysid.front.gap.find_gap_in", lambda *_, **__: gap.result)
    write_logs(tmp_path / "logs")
    for path in tmp_path.glob("logs/*/*.csv"):  # neither units nor what moves
        path.write_text("time,boom_cmd,boom_pos,angle\n" + path.read_text("utf-8").partition("\n")[2], "utf-8")
    with pytest.raises(sysid.SettingsError, match=r"open questions.*answers=\{key: value\}") as stopped:
        sysid.start(tmp_path / "logs", tmp_path / "ws", progress=silent)
    assert not (tmp_path / "logs" / "machine.toml").exists()
    assert "the unit is not stated (unit, proposed 'mm')" in str(stopped.value)
    with pytest.warns(UserWarning, match="left out|Taken") as warned:
        found = sysid.start(
            tmp_path / "logs", tmp_path / "ws", answers={"drives": "cylinder"}, accept_proposals=True, progress=silent
        )
    taken = [str(each.message) for each in warned if "Taken" in str(each.message)]
    assert [text.rpartition("Taken: ")[2] for text in taken] == ["unit=mm"]
    assert found.dataset.reference == "logs@1"
    assert (tmp_path / "logs" / "machine.toml").exists()


def test_the_default_workspace_is_that_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SYSID_WORKSPACE", str(tmp_path / "mine"))
    assert sysid.open().location == str(tmp_path / "mine")
    monkeypatch.delenv("SYSID_WORKSPACE")
    assert sysid.open().location == "./workspace"


def test_the_demo_logs_are_those_of_the_checkout() -> None:
    assert sysid.demo_logs() == ROOT / "datasets" / "autolog"
