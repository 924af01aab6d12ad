"""The guide's page on an effect of one's own, followed word by word on a copy of the package."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


#: What the rest of the toolkit writes of an effect, from its file alone.
WORDS = """
from sysid.effects import effect_named
from sysid.effects.catalogue import confusions
from sysid.reports.words import effect_sentence, effect_title
from effect_pages import page

assert effect_title("command_offset") == "Valve null bias"
assert effect_sentence("command_offset", "boom", {"offset": "0.05"}).startswith("A constant of 0.05 is added to every command")
assert "command_offset" in confusions(effect_named("valve_deadband"))
assert "shifts both edges" in page(effect_named("valve_deadband"))
assert "added to the command" in page(effect_named("command_offset"))
"""

#: The exported models have the effect as well: one step of the plant is one step of theirs.
EXPORTS = """
import numpy as np
import torch
from sysid.export.drive_data import drive_data
from sysid.export.drive_module import module_of
from sysid.export.torchscript.model import script_of
from sysid.machine import KnownEffect
from sysid.plant import nominal_plant
from sysid.plant.stepper import Stepper
from sysid.testing.probe import RATE_HZ, probe_machine

plant = nominal_plant(probe_machine()).with_effect(KnownEffect("command_offset", "boom", {"offset": 0.05}))
data = drive_data(plant, RATE_HZ)
module = module_of(data)
shipped, script = module.assemble(data, module.PARTS), script_of(plant, RATE_HZ)
rows = [torch.tensor([values], dtype=torch.float64) for values in ([0.1, 0.2, 0.0, 0.3], [0.1, 0.05, 0.0, 0.3], [0.0] * 4)]
stepper, theta = Stepper(plant, RATE_HZ), script.theta(1)
before = stepper.reset(*(row.numpy() for row in rows[:1]), drive=rows[1].numpy(), commands=rows[2].numpy()).drive[0]
shipped.reset(*(row[0].numpy() for row in rows))
state, _ = script.begin(theta, *rows)
for _ in range(20):
    expected = stepper.step(rows[2].numpy()).drive[0]
    state, signals = script(theta, state, rows[2])
    np.testing.assert_allclose(shipped.step(rows[2][0].numpy()).drive, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(signals["drive"][0].numpy(), expected, rtol=0.0, atol=1e-12)
assert abs(expected[1] - before[1] - 20 * 0.05 * 0.008 / RATE_HZ) < 1e-9, "the offset moves the boom"
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with the effect: its file, its entry in the catalogue, its line in the chain."""
    effect, line, _ = code_of_the_page()
    package = tmp_path / "sysid"
    shutil.copytree(ROOT / "sysid", package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "effects" / "command_offset.py").write_text(effect, "utf-8")
    insert(package / "effects" / "catalogue.py", "    command_rate_limit,\n", "    command_offset,\n")
    insert(package / "effects" / "catalogue.py", "    valve_deadband.EFFECT,\n", "    command_offset.EFFECT,\n")
    insert(package / "plant" / "chain.py", "    command_rate_limit,\n", "    command_offset,\n")
    insert(package / "plant" / "chain.py", "    u = valve_deadband.step(", line)
    return tmp_path


@pytest.mark.slow
def test_page_as_it_is_written(package: Path) -> None:
    run(package, code_of_the_page()[-1] + EXPORTS, {"XDG_CACHE_HOME": str(package / "cache")})


def test_words_come_from_the_file_alone(package: Path) -> None:
    run(package, WORDS, {"NUMBA_DISABLE_JIT": "1"})


def code_of_the_page() -> list[str]:
    page = (ROOT / "docs" / "guide" / "own-effect.md").read_text("utf-8")
    return re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)


def run(folder: Path, code: str, environment: dict[str, str]) -> None:
    places = os.pathsep.join((str(folder), str(ROOT / "pipelines")))
    environment = {**os.environ, "PYTHONPATH": places, **environment}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def insert(path: Path, before: str, text: str) -> None:
    whole = path.read_text("utf-8")
    assert whole.count(before) == 1, before
    path.write_text(whole.replace(before, text + before), "utf-8")
