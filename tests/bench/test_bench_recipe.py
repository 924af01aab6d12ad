"""Bench recipes: what cannot be a machine is refused, with the place and the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from simulated_bench import BenchRecipe, load_recipe
from sysid.errors import SettingsError

AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"


@pytest.mark.parametrize(
    ("found", "written", "message"),
    [
        ("backlash = 0.0105", "backlsh = 0.0105", r"unknown key 'axes\.slew\.backlsh'; expected 'backlash'\?"),
        ("backlash = 0.0105", "backlash = -0.1", r"axes\.slew\.backlash: -0\.1; expected zero or more"),
        ("[gripper]", "[masses]\nbalanced = 1.2\n[gripper]", r"masses\.balanced: 1\.2; expected a share from 0 to 1"),
        ("[gripper]", "[supply]\nrated = 0.0\n[gripper]", r"supply\.rated: 0\.0; expected more than zero"),
        ("gain = 0.025,", "gain = 0.025, notch = 1.5,", r"axes\.boom\.valve\.notch: 1\.5; expected a share from 0 to 1"),
        ("gain = 0.025,", "gain = 0.025, spool_speed = 0.0,", r"valve\.spool_speed: 0\.0; expected more than zero"),
        (
            "deadband_positive = 0.17",
            "deadband_positive = -0.17",
            r"axes\.stick\.valve\.deadband_positive: -0\.17; expected zero",
        ),
        ("gain = 0.436", "gain = 0.0", r"axes\.slew\.valve\.gain: 0\.0; expected more than zero"),
        ("[axes.telescope]", "[axes.telscope]", r"axes: 'telescope' is missing or not an axis of the crane"),
        ("park = 0.5", "park = 2.5", r"axes\.boom\.park: 2\.5; expected a value inside the limits"),
        ("stroke = 0.1010", "stroke = 0.2010", r"axes\.boom\.cylinder: levers 0\.2087 and 0\.0655 m cannot hold a cylinder"),
        ("offset = -0.209440", "offset = 0.3", r"axes\.stick\.cylinder\.offset: lever angles"),
        ("rate = 100.0", "rate = 130.0", r"does not divide the controller's cycle"),
        ('name = "manual-02"', 'name = "manual-01"', r"recording 'manual-01': name is taken"),
        ("poses = 500", "poses = 0", r"recording 'poses': seconds = 0\.0, poses = 0; expected one of them above zero"),
        ("markers = [0, 2]", "markers = [0, 4]", r"swap: markers \[0, 4\]; expected two different ones of 0 … 3"),
        ('recording = "manual-03"', 'recording = "manual-30"', r"no recording 'manual-30'; expected 'manual-0"),
        ('body = "tip_body"', 'body = "tipp_body"', r"swap: unknown body 'tipp_body'; expected 'tip_body'\?"),
        (
            'body = "gripper_body"',
            'body = "griper_body"',
            r"exported_markers: unknown body 'griper_body'; expected 'gripper_body'\?",
        ),
    ],
)
def test_recipe_that_is_no_machine_is_refused(tmp_path: Path, found: str, written: str, message: str) -> None:
    text = (AUTOLOG / "bench.toml").read_text("utf-8")
    assert found in text
    path = tmp_path / "bench.toml"
    path.write_text(text.replace(found, written, 1), "utf-8")
    with pytest.raises(SettingsError, match=message):
        load_recipe(path)


def test_unknown_recording_suggests_the_nearest(recipe: BenchRecipe) -> None:
    with pytest.raises(SettingsError, match="no recording 'manual-1'; expected 'manual-01'"):
        recipe.recording("manual-1")
