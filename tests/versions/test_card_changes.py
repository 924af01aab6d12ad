"""What a version changes against the one before, on its card."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sample_workspace import sample_workspace

from sysid.model_versions import ModelVersions
from sysid.reports.card import CardBlock
from sysid.reports.model_pages import models_page


def block(versions: ModelVersions, reference: str) -> CardBlock | None:
    return next((item for item in versions.card(reference).blocks if item.title.startswith("Changed since")), None)


def test_predictions_of_a_network_and_effects_of_a_plant_are_compared_with_the_version_before(tmp_path: Path) -> None:
    versions = ModelVersions(sample_workspace(tmp_path / "ws"))
    assert block(versions, "autolog-actuator@1") is None
    network = block(versions, "autolog-actuator@2")
    assert network is not None
    assert network.title == "Changed since autolog-actuator@1"
    rows = {row[0]: row[1:] for row in network.table.rows}
    assert re.fullmatch(r"0\.1\d+°", rows["boom.joint"][0]), "off by 0.002 rad"
    assert rows["boom.cylinder"][0].startswith("0"), "the other direction is the same"
    assert block(versions, "autolog@2") is None, "all its effects are new: they are listed once"
    assert block(versions, "autolog@1") is None


def test_the_card_of_a_plant_has_errors_and_each_value_once_with_its_unit(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    effect: dict[str, Any] = {"name": "backlash", "target": "slew", "parameters": {"width": 0.0105}, "units": {"width": "rad"}}
    effect |= {"interval95": {"width": [0.0104, 0.0106]}, "closed_share": 0.9}
    errors = {"tool.x": 0.03, "tool.y": 0.0, "tool.z": 0.04, "slew.joint": 0.01}
    gap = {"before": errors, "after": {name: 0.1 * value for name, value in errors.items()}}
    gap["noise_floor"] = {name: 0.05 * value for name, value in errors.items()}
    lineage: dict[str, Any] = {"dataset": "autolog@1", "plant": "autolog@2", "effects": [effect], "proof": {"gap": gap}}
    lineage["recordings"] = {"held_out": ["manual-04"]}
    files = place.models.load("autolog@2").files
    place.models.register("autolog", "plant", files, lineage)
    versions = ModelVersions(place)
    card = {item.title: item for item in versions.card("autolog@3").blocks}
    rows = {
        row[0]: tuple(cell.replace("\N{NARROW NO-BREAK SPACE}", " ") for cell in row[1:4]) for row in card["Error"].table.rows
    }
    assert rows["tool position"] == ("50.0 mm", "5.00 mm", "2.50 mm")
    assert rows["slew joint"][0] == "0.573°", "in the unit of the dataset"
    assert "manual-04" in card["Error"].text[0]
    assert card["Added effects"].table.rows == [
        ("Backlash", "slew", "width", "0.602°", "0.596 to 0.607°", "90\N{NARROW NO-BREAK SPACE}%"),
    ]
    changed = {(row[0], row[2]): row[3:5] for row in card["Changed since autolog@2"].table.rows}
    assert changed["Backlash", "width"][1] == "0.602°"
    assert changed["Swinging tool", "length"][1] == "none", "what is no longer in it"
    page = models_page(place.models.list(), "ws")
    heights = [float(y) for y in re.findall(r'<circle class="c1" cx="[\d.]+" cy="([\d.]+)"', page)]
    assert heights[0] < heights[1], "the error falls from version to version"


def test_an_earlier_version_whose_files_were_changed_leaves_the_card_without_the_comparison(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    first, second = (set(place.models.load(f"autolog-actuator@{number}").files.values()) for number in (1, 2))
    own = [path for path in (tmp_path / "ws").rglob("*.safetensors") if path.read_bytes() in first - second]
    assert own
    own[0].write_bytes(b"other")
    assert block(ModelVersions(place), "autolog-actuator@2") is None
