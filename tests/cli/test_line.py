"""The verbs one after the other on a small machine with a known dead-band, as a user would type them."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path

import pytest
from command_line import run
from deadband_logs import DEADBAND, MACHINE, RECIPE, write_logs

from sysid.workspace import open_workspace


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with logs, a workspace beside them, and the dataset ingested."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "machine.toml").write_text(MACHINE)
    (folder / "recipe.toml").write_text(RECIPE)
    write_logs(folder / "logs")
    assert (
        run(
            "--workspace",
            folder / "ws",
            "ingest",
            folder / "logs",
            "--machine",
            folder / "machine.toml",
            "--json",
            folder / "i.json",
        )
        == 0
    )
    return folder


@pytest.fixture(scope="module")
def answered(site: Path) -> Path:
    """The same after the networks and the gap."""
    assert (
        run("--workspace", site / "ws", "fit", "actuator", "lift", "--recipe", site / "recipe.toml", "--json", site / "f.json")
        == 0
    )
    with (site / "gap.txt").open("w") as shown, contextlib.redirect_stdout(shown):
        assert run("--workspace", site / "ws", "gap", "lift", "--add", "--json", site / "g.json") == 0
    return site


def test_ingest_again_is_the_same_version(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = json.loads((site / "i.json").read_text())
    assert made["dataset"] == "lift@1"
    assert {entry["role"] for entry in made["recordings"]} == {"fit", "select", "held_out"}
    assert run("--workspace", site / "ws", "ingest", site / "logs", "--machine", site / "machine.toml", "--json", "-") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["dataset"] == "lift@1"
    assert "lift@1 in " in captured.err, "with JSON on stdout the text goes to stderr"


def test_datasets_lists_and_shows(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", site / "ws", "datasets") == 0
    assert "lift@1" in capsys.readouterr().out
    assert run("--workspace", site / "ws", "datasets", "lift@1") == 0
    assert "run-3" in capsys.readouterr().out
    assert run("--workspace", site / "ws", "datasets", "lfit") == 2
    assert "'lift'?" in capsys.readouterr().err


def test_gap_add_shows_the_change_and_how_to_undo_it(answered: Path) -> None:
    text = (answered / "gap.txt").read_text()
    assert "Plant lift@2 = plant lift@1 repaired" in text
    assert '  +[[effects]]\n  +name = "valve_deadband"\n  +target = "boom"\n' in text
    assert "Promoted: `lift` alone now means plant lift@2 instead of lift@1." in text
    assert re.search(r"passed +stages: command stage of boom \d+ → [01]", text)
    assert re.search(r"Undo it:  sysid --workspace \S+ models promote lift@1 ", text)
    assert "Not run in the PyBullet world" in text
    assert "no URDF" in text
    row = next(line.split() for line in text.splitlines() if re.match(r" *boom\.cylinder +\d", line))
    assert row[2:7:2] == ["mm", "mm", "mm"], "before, after and noise floor of every signal, in millimetres"


def test_gap_names_what_is_hidden(answered: Path) -> None:
    result = json.loads((answered / "g.json").read_text())
    assert result["verdict"] == "named"
    assert [(effect["name"], effect["target"]) for effect in result["effects"]] == [("valve_deadband", "boom")]
    found = result["effects"][0]["parameters"]
    assert found["positive"] == pytest.approx(DEADBAND[0], rel=0.1)
    assert found["negative"] == pytest.approx(DEADBAND[1], rel=0.1)
    assert result["plant"] == {"before": "lift@1", "after": "lift@2"}


def test_lineage_shows_the_gap_result_that_a_plant_was_in(answered: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for version, role in (("lift@1", "tested it"), ("lift@2", "created it")):
        assert run("--workspace", answered / "ws", "models", "lineage", version) == 0
        assert f"used by   gap result on lift@1: {role}" in capsys.readouterr().out


def test_validate_repeats_the_report_of_the_fit(answered: Path) -> None:
    fitted = json.loads((answered / "f.json").read_text())
    assert fitted["model"] == "lift-actuator@1"
    assert run("--workspace", answered / "ws", "validate", "lift-actuator@1", "lift", "--json", answered / "v.json") == 0
    again = json.loads((answered / "v.json").read_text())
    assert [entry["metrics"] for entry in again["outputs"]] == [entry["metrics"] for entry in fitted["validation"]["outputs"]]


def test_motion_and_history_are_fitted_judged_and_kept(site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In a workspace of their own: a plant takes the static part of actuators with history as its linkage."""
    ws, recipe = tmp_path / "ws", tmp_path / "recipe.toml"
    history = "[actuator.history]\ninterval = 0.1\nunits = 2\nepochs = 2\ncheck_every = 1\n"
    motion = "[motion]\nmembers = 1\nsamples = 500\nhorizons = [0.5]\n[motion.training]\nlearning_rate = 5e-3\nepochs = 10\n"
    recipe.write_text(RECIPE.replace("[actuator]", '[actuator]\nmodel = "history"') + history + motion)
    assert run("--workspace", ws, "ingest", site / "logs", "--machine", site / "machine.toml") == 0
    for kind in ("motion", "actuator"):
        assert run("--workspace", ws, "fit", kind, "lift", "--recipe", recipe, "--json", tmp_path / f"{kind}.json") == 0
    text = capsys.readouterr().out
    assert "boom.cylinder after 500 ms" in text
    assert "by direction of the input" in text
    moved, along = (json.loads((tmp_path / f"{kind}.json").read_text()) for kind in ("motion", "actuator"))
    assert (moved["model"], along["model"]) == ("lift-motion@1", "lift-history@1")
    assert "nominal simulation" in moved["validation"]["outputs"][0]["baselines"]
    assert "static network" in along["validation"]["outputs"][0]["baselines"]
    assert run("--workspace", ws, "validate", "lift-motion@1", "lift", "--json", tmp_path / "v.json") == 0
    again = json.loads((tmp_path / "v.json").read_text())
    assert again["outputs"][0]["metrics"] == moved["validation"]["outputs"][0]["metrics"]
    place = open_workspace(ws)
    data = place.dataset("lift")
    plant = place.plant(data)
    assert plant.origin["networks"] == "lift-history@1"
    assert "boom" in plant.linkages
    assert {report.kind for report in place.report_inputs(data).validations} == {"history", "motion"}
    assert run("--workspace", ws, "models", "promote", "lift-motion@1") == 0
    assert run("--workspace", ws, "models", "card", "lift-history@1") == 0


def test_models_shows_what_was_made_from_what(answered: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", answered / "ws", "models", "--json", answered / "m.json") == 0
    listed = {f"{m['name']}@{m['version']}": m["lineage"] for m in json.loads((answered / "m.json").read_text())["models"]}
    assert set(listed) == {"lift-actuator@1", "lift@1", "lift@2"}
    assert listed["lift@2"]["plant"] == "lift@1"
    assert listed["lift@1"]["networks"] == "lift-actuator@1"
    capsys.readouterr()
    assert run("--workspace", answered / "ws", "models", "lift@2") == 0
    assert "dataset   lift@1" in capsys.readouterr().out
    assert run("--workspace", answered / "ws", "models", "--kind", "plants") == 2
    assert "plant" in capsys.readouterr().err


def test_report_holds_the_answer(answered: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", answered / "ws", "report", "--out", answered / "r.html") == 0
    text = (answered / "r.html").read_text("utf-8")
    assert "One effect is missing from the simulation." in text
    assert "lift-actuator@1" in text
    assert "traces-data" in text
    assert str(answered / "r.html") in capsys.readouterr().out


def test_view_shows_before_and_after(answered: Path) -> None:
    assert run("--workspace", answered / "ws", "view", "lift", "--out", answered / "v.rrd", "--json", answered / "w.json") == 0
    assert json.loads((answered / "w.json").read_text())["simulations"] == ["before", "after"]
    assert run("--workspace", answered / "ws", "view", "lift", "--plant", "lift@2", "--recording", "run-0") == 0
    assert (answered / "ws" / "results" / "lift@1" / "run-0.rrd").stat().st_size > 10_000


def test_repaired_plant_leaves_no_gap(answered: Path) -> None:
    assert (
        run("--workspace", answered / "ws", "gap", "lift", "--plant", "lift@2", "--localise", "--json", answered / "l.json")
        == 0
    )
    stages = {item["stage"]: item for item in json.loads((answered / "l.json").read_text())["localised"]}
    assert stages["command"]["stage_rmse"] < 1.5 * stages["command"]["noise_floor"]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("gap", "lift", "--plant", "lift-actuator@1"), "is of kind 'actuator'; expected a plant"),
        (("gap", "lift", "--plant", "lfit"), "'lift'"),
        (("validate", "lift@1", "lift"), "expected a network"),
        (("view", "lift", "--recording", "run-9"), "no recording 'run-9'"),
        (("fit", "forward", "lift"), "ee"),
    ],
)
def test_mistakes_are_one_paragraph(
    answered: Path, args: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("--workspace", answered / "ws", *args) == 2
    text = capsys.readouterr().err
    assert re.match(r"sysid: .*\n\Z", text)
    assert message in text


def test_a_damaged_result_is_reported(answered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import shutil

    shutil.copytree(answered / "ws", tmp_path / "ws")
    (tmp_path / "ws" / "results" / "lift@1" / "gap" / "result.json").write_text('{"schema": 1}')
    assert run("--workspace", tmp_path / "ws", "report", "lift") == 2
    assert "Run `sysid gap` again" in capsys.readouterr().err


def test_the_name_alone_means_what_is_promoted_and_can_be_set_back(answered: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = json.loads((answered / "g.json").read_text())
    assert result["promotion"]["promoted"] is True
    assert (result["promotion"]["previous"], result["promotion"]["current"]) == ("lift@1", "lift@2")
    assert result["machine_diff"].startswith("--- machine.toml\n+++ machine.toml\n@@ ")
    assert result["world_gap"]["skipped"].startswith("machine lift has no URDF")
    assert result["effects"][0]["evidence"]["delta_bic"] > 10.0
    assert (answered / "ws" / "results" / "lift@1" / "gap" / "machine.diff").read_text() == result["machine_diff"]
    for reference, instead in (("lift@1", "lift@2"), ("lift@2", "lift@1")):
        assert run("--workspace", answered / "ws", "models", "promote", reference) == 0
        assert f"`lift` alone now means {reference} instead of {instead}." in capsys.readouterr().out
        assert run("--workspace", answered / "ws", "models", "lift") == 0
        shown = capsys.readouterr().out
        assert shown.startswith(f"{reference}  (champion)  plant")
        assert ("+[[effects]]" in shown) == (reference == "lift@2"), "the change of machine.toml is shown with its version"
    assert run("--workspace", answered / "ws", "gap", "lift", "--plant", "lift", "--localise") == 0
    assert "`lift` means lift@2." in capsys.readouterr().out
    assert run("--workspace", answered / "ws", "models", "promote", "lift") == 2
    assert "expected one version, as in autolog@1" in capsys.readouterr().err
