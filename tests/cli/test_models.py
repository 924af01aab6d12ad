"""``sysid models promote · lineage · diff · export · card`` and the verdict of ``sysid validate``, as users meet them."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from command_line import run
from crane_data import dataset, motion
from stored import small_dataset
from version_data import actuator, forward, structured

from sysid.datasets import Store
from sysid.datasets.recording import Source
from sysid.datasets.versions.manifest import PartRecord
from sysid.model_versions import ModelVersions
from sysid.networks import NetworkRecipe
from sysid.registry import Registry
from sysid.validate import validate_model
from sysid.workspace import Workspace

UNITS = {
    "time": "s",
    **{f"{axis}.joint": "rad" for axis in ("slew", "boom", "stick")},
    **dict.fromkeys(("telescope.joint", "boom.cylinder", "stick.cylinder", "ee.x", "ee.y", "ee.z"), "m"),
}


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``crane@1`` and ``later@1``; ``crane-actuator`` exact, 2 mrad off, and of another recipe; two forward models; a plant."""
    place = Workspace(tmp_path_factory.mktemp("template") / "ws")
    _, channels = small_dataset(1)
    raw = (Source("run-1/log.csv", "ab" * 32, 10),)
    own = place.datasets.save(replace(dataset(), digest="a" * 64, sources=raw, units=UNITS), channels, PartRecord(1))
    later = replace(dataset((motion("new-1", 30.0, 11),), {"new-1": "fit"}), name="later", digest="b" * 64, units=UNITS)
    place.datasets.save(later, channels, PartRecord(1))
    recipe = NetworkRecipe()
    for model, used in (
        (actuator("boom"), recipe),
        (actuator("boom", off=0.002), recipe),
        (actuator("boom", off=0.0001), replace(recipe, seed=5)),
        (structured(seed=1), recipe),
        (structured(seed=2), recipe),
    ):
        place.add_network(own, model, used, validate_model(model, own))
    lineage = {"networks": "crane-actuator@1", "dataset": "crane@1"}
    place.models.register("crane", "plant", {"plant.json": b"{}"}, lineage)
    folder = place.gap_folder(own)
    folder.mkdir(parents=True)
    (folder / "result.json").write_text('{"plant": {"before": "crane@1", "after": "crane@1"}}')
    return place.folder


@pytest.fixture
def place(template: Path, tmp_path: Path) -> Path:
    return shutil.copytree(template, tmp_path / "ws")


def test_the_gate(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ws = ("--workspace", place)
    (place / "p.toml").write_text('schema = 1\n[actuator.limits]\n"boom.joint" = {bias = "1 mrad"}\n')
    assert run(*ws, "models", "promote", "crane-actuator@1", "--policy", place / "p.toml") == 0
    shown = capsys.readouterr().out
    assert "`crane-actuator` alone now means crane-actuator@1." in shown
    assert run(*ws, "models", "promote", "crane-actuator@2", "--policy", place / "p.toml", "--json", place / "r.json") == 2
    shown, error = capsys.readouterr()
    assert re.search(r"failed    boom.joint in motion: bias 0\.1\d+°, 0\.0\d+° above the 0\.0573° allowed", shown)
    assert re.search(r"failed    boom.joint in motion: rmse .* % above the .* of crane-actuator@1; 5 % allowed", shown)
    assert "`crane-actuator` alone still means crane-actuator@1" in shown
    assert re.search(r"not promoted: \d of \d+ conditions do not hold.* models promote crane-actuator@2 --anyway 'WHY'", error)
    assert json.loads((place / "r.json").read_text())["promoted"] is False
    assert run(*ws, "models", "promote", "crane-actuator@2", "--anyway", "the sensor was moved") == 0
    assert "Promoted regardless of the checks: the sensor was moved" in capsys.readouterr().out
    assert run(*ws, "models", "crane-actuator", "--json", place / "s.json") == 0
    shown = capsys.readouterr().out
    assert shown.startswith("crane-actuator@2  (champion)  actuator")
    assert "not promoted, crane-actuator@1 stays  (policy p.toml)" in shown
    assert "promoted instead of crane-actuator@1  (user): the sensor was moved (overruled: " in shown
    one, two = json.loads((place / "s.json").read_text())["decisions"]
    assert one["judged"]["rules"]["limits"] == {"boom.joint": {"bias": "1 mrad"}}
    assert one["judged"]["dataset"] == "crane@1"
    assert (two["promoted"], two["word"]) == (True, "the sensor was moved")
    assert run(*ws, "models", "promote", "crane-actuator@3") == 0
    assert "below the" in capsys.readouterr().out
    assert Workspace(place).network_version(Store(place).load("crane"), "actuator").reference == "crane-actuator@3"  # type: ignore[union-attr]


def test_a_plant_needs_its_proof_or_a_word(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ws = ("--workspace", place)
    assert run(*ws, "models", "promote", "crane@1") == 2
    assert "no proof of crane@1 is recorded; Plants are evaluated by the proof of `sysid" in capsys.readouterr().err
    assert run(*ws, "models", "promote", "crane@1", "--policy", place / "p.toml") == 2
    assert "p.toml: no such file" in capsys.readouterr().err
    (place / "p.toml").write_text("schema = 1")
    assert run(*ws, "models", "promote", "crane@1", "--policy", place / "p.toml") == 2
    assert "crane@1 is a plant; expected a network" in capsys.readouterr().err
    assert run(*ws, "models", "promote", "crane@1", "--anyway", "the only one") == 0
    Registry(place).register("crane", "plant", {"plant.json": b"[]"}, {})
    assert run(*ws, "models", "promote", "crane@2", "--anyway", "newer") == 0
    capsys.readouterr()
    assert run(*ws, "models", "promote", "crane@1") == 0, "what was in use may be set back"
    assert "`crane` alone now means crane@1 instead of crane@2." in capsys.readouterr().out


def test_lineage_both_ways(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", place, "models", "lineage", "crane-actuator@1", "--json", place / "l.json") == 0
    shown = capsys.readouterr().out
    assert "raw       abababababab  run-1/log.csv  10 bytes" in shown
    assert "used by   crane@1  plant" in shown
    found = json.loads((place / "l.json").read_text())
    assert found["dataset"] == found["source"]["dataset"] == "crane@1"
    assert [item["reference"] for item in found["children"]] == ["crane@1"]
    assert run("--workspace", place, "models", "lineage", "crane@1") == 0
    shown = capsys.readouterr().out
    assert "made of   crane-actuator@1  actuator" in shown
    assert "used by   gap result on crane@1: tested it" in shown
    assert run("--workspace", place, "models", "lineage", "crane-forward@1") == 0
    assert "used by   nothing was made from it" in capsys.readouterr().out


def test_lineage_of_a_dataset_that_is_gone(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(place / "datasets" / "crane")
    assert run("--workspace", place, "models", "lineage", "crane-actuator@1") == 0
    assert "dataset   crane@1: " in capsys.readouterr().out
    assert run("--workspace", place, "models", "promote", "crane-actuator@1") == 2
    assert run("--workspace", place, "models", "promote", "crane-actuator@1", "--anyway", "old logs") == 0
    assert run("--workspace", place, "models", "card", "crane-actuator@1", "--out", place / "c.md") == 0
    assert "its dataset is not available" in (place / "c.md").read_text()


def test_diff(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ws = ("--workspace", place, "models", "diff")
    assert run(*ws, "crane-actuator@1", "crane-actuator@3", "--json", place / "d.json") == 0
    shown = capsys.readouterr().out
    assert "recipe seed: 0 → 5" in shown
    assert "file changed: network.json" not in shown
    assert "file changed: weights.safetensors" in shown
    found = json.loads((place / "d.json").read_text())
    joint, cylinder = found["predictions"]
    assert joint["largest"] == pytest.approx(1e-4, rel=1e-2)
    assert cylinder["largest"] == 0.0
    assert {change["what"] for change in found["figures"]} >= {"boom.joint.motion.rmse"}
    assert run(*ws, "crane-forward@1", "crane-forward@2", "--json", place / "g.json") == 0
    shown = capsys.readouterr().out
    assert re.search(r"boom_joint\.offset\s+−?[\d.]+°\s+−?[\d.]+°\s+[\d.]+", shown)
    geometry = json.loads((place / "g.json").read_text())["geometry"]
    assert all(change["sigmas"] > 0.0 for change in geometry)
    assert run(*ws, "crane-forward@1", "crane-forward@1") == 0
    assert "No differences." in capsys.readouterr().out
    assert run(*ws, "crane-forward@1", "crane-actuator@1") == 2
    assert "is of kind 'actuator'; expected 'forward', as crane-forward@1" in capsys.readouterr().err


def test_diff_of_models_of_different_make(place: Path) -> None:
    models = ModelVersions(Workspace(place))
    models.workspace.add_network(Store(place).load("crane"), forward(), NetworkRecipe())
    found = models.diff("crane-forward@1", "crane-forward@3")
    assert {change.after for change in found.geometry if change.after == change.after} == set(), "a network has no geometry"
    assert [entry.points > 4000 for entry in found.predictions] == [True] * 3


def test_export_and_card(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
    ws = ("--workspace", place, "models")
    assert run(*ws, "export", "crane-actuator@1", "--json", place / "e.json") == 0
    assert (place / "exports/crane-actuator@1/boom.to_joint.onnx").is_file()
    assert json.loads((place / "e.json").read_text())["files"][0]["inputs"] == ["boom.cylinder"]
    assert run(*ws, "export", "crane@1") == 2
    assert run(*ws, "promote", "crane-actuator@1", "--anyway", "<b>first</b>") == 0
    assert run(*ws, "card", "crane-actuator") == 0
    text = (place / "cards/crane-actuator@1.md").read_text()
    assert re.search(r"\| boom\.joint in motion \| [\d.]+° \| .* \| (polynomial, degree \d|linkage geometry) [\d.]+° \|", text)
    assert "| raw file | run-1/log.csv | 10 bytes | abababababab |" in text
    assert 'open_workspace("./workspace").network("crane-actuator@1")' in text
    page = (place / "cards/crane-actuator@1.html").read_text()
    assert "&lt;b&gt;first&lt;/b&gt;" in page
    assert run(*ws, "card", "crane", "--out", place / "c.txt") == 2
    assert "suffix '.txt'; expected .md or .html" in capsys.readouterr().err


def test_validate_says_whether_it_still_fits(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ws = ("--workspace", place, "validate")
    assert run(*ws, "crane-actuator@1", "later", "--json", place / "v.json") == 0
    assert "crane-actuator@1 on later@1 fits: inside its ranges its errors have not grown" in capsys.readouterr().out
    found = json.loads((place / "v.json").read_text())
    assert found["drift"]["verdict"] == "fits"
    assert found["outputs"][0]["metrics"]["rmse"] > 0.0
    assert run(*ws, "crane-actuator@1", "crane", "--json", place / "v.json") == 0
    assert json.loads((place / "v.json").read_text())["drift"] is None
    new = Store(place).load("later")
    table = new.recordings[0].table.assign(**{"boom.cylinder": lambda t: t["boom.cylinder"] + 2e-4})
    moved = replace(new, name="moved", digest="c" * 64, recordings=(replace(new.recordings[0], table=pd.DataFrame(table)),))
    Store(place).save(moved, small_dataset(1)[1], PartRecord(1))
    capsys.readouterr()
    assert run(*ws, "crane-actuator@1", "moved") == 0
    shown = capsys.readouterr().out
    assert "no longer fits: significantly larger errors in boom.joint (motion), boom.cylinder (motion)." in shown
