"""What a version changes against the one before, on its card."""

from __future__ import annotations

import re
from pathlib import Path

from sample_workspace import sample_workspace

from sysid.model_versions import ModelVersions
from sysid.reports.card import CardBlock


def block(versions: ModelVersions, reference: str) -> CardBlock | None:
    return next((item for item in versions.card(reference).blocks if item.title.startswith("Changed since")), None)


def test_predictions_of_a_network_and_effects_of_a_plant_are_compared_with_the_version_before(tmp_path: Path) -> None:
    versions = ModelVersions(sample_workspace(tmp_path / "ws"))
    assert block(versions, "autolog-actuator@1") is None
    network = block(versions, "autolog-actuator@2")
    assert network is not None
    assert network.title == "Changed since autolog-actuator@1"
    rows = {row[0]: row[1:] for row in network.rows}
    assert re.fullmatch(r"0\.1\d+°", rows["boom.joint"][0]), "off by 0.002 rad"
    assert rows["boom.cylinder"][0].startswith("0"), "the other direction is the same"
    plant = block(versions, "autolog@2")
    assert plant is not None
    assert ("Backlash", "slew", "width", "none") in [row[:4] for row in plant.rows]
    assert block(versions, "autolog@1") is None


def test_an_earlier_version_whose_files_were_changed_leaves_the_card_without_the_comparison(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    first, second = (set(place.models.load(f"autolog-actuator@{number}").files.values()) for number in (1, 2))
    own = [path for path in (tmp_path / "ws").rglob("*.safetensors") if path.read_bytes() in first - second]
    assert own
    own[0].write_bytes(b"other")
    assert block(ModelVersions(place), "autolog-actuator@2") is None
