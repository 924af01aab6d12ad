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


@pytest.mark.slow
def test_page_as_it_stands(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "guide" / "own-effect.md").read_text("utf-8")
    effect, line, check = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    package = tmp_path / "sysid"
    shutil.copytree(ROOT / "sysid", package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "effects" / "command_offset.py").write_text(effect, "utf-8")
    insert(package / "effects" / "catalogue.py", "    command_rate_limit,\n", "    command_offset,\n")
    insert(package / "effects" / "catalogue.py", "    valve_deadband.EFFECT,\n", "    command_offset.EFFECT,\n")
    insert(package / "plant" / "chain.py", "    command_rate_limit,\n", "    command_offset,\n")
    insert(package / "plant" / "chain.py", "    u = valve_deadband.step(", line)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    run = subprocess.run(
        [sys.executable, "-c", check], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr


def insert(path: Path, before: str, text: str) -> None:
    whole = path.read_text("utf-8")
    assert whole.count(before) == 1, before
    path.write_text(whole.replace(before, text + before), "utf-8")
