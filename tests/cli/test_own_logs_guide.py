"""``docs/guide/own-logs.md`` is followed word by word: its commands are run, its files are written as it says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.logs.inspection import inspect_file

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "own-logs.md"


def test_the_guide_works_word_by_word(tmp_path: Path, shared_data: Path) -> None:
    blocks = re.findall(r"^```(sh|toml)\n(.*?)^```$", GUIDE.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert [kind for kind, _ in blocks] == ["sh", "toml", "sh", "toml", "sh", "sh"]
    environment = {
        **os.environ,
        "LOGS": str(shared_data / "rc_excavator"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "SYSID_WORKSPACE": str(tmp_path / "workspace"),
    }
    folder = tmp_path / "excavator/datasets/excavator"

    def shell(text: str) -> str:
        done = subprocess.run(
            ["bash", "-e", "-c", text], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    shell(blocks[0][1])
    (folder / "machine.toml").write_text(blocks[1][1], "utf-8")
    looked = shell(blocks[2][1])
    assert "Boom Cmd" in looked
    draft = (folder / "recipe.toml").read_text("utf-8")
    for axis, low, high in (("Boom", "4.939", "10.01"), ("Stick", "4.929", "8.861"), ("Bucket", "5.198", "10.03")):
        values = f'field = "{axis} Cmd", zero = <neutral>, span = <from neutral to full>'
        assert f'# "{axis.lower()}.command" = {{ {values} }}   # {low} … {high}' in draft
    # What the page says of the files: how they pause, where the joystick stands while nobody touches it, what full is.
    logs = [inspect_file(path).streams[0] for path in sorted((folder / "logs").iterdir())]
    assert len(logs) == 10
    assert all(0.1 < log.clocks[0].longest_gap_s < 1.1 for log in logs)
    first = pd.read_csv(folder / "logs/manual_ol_1006_1648.csv", nrows=5)
    for axis, zero, span in re.findall(r'field = "(\w+) Cmd", zero = ([\d.]+), span = ([\d.]+)', blocks[3][1]):
        np.testing.assert_allclose(first[f"{axis} Cmd"], float(zero), atol=1e-3)
        duty = next(field for field in logs[0].fields if field.name == f"{axis} Cmd")
        reach = max(duty.high - float(zero), float(zero) - duty.low)
        assert float(span) == pytest.approx(reach, rel=0.02)
    head, mark, _ = draft.partition("[streams.signals]\n")
    (folder / "recipe.toml").write_text(head + mark + blocks[3][1], "utf-8")
    stored = shell(blocks[4][1])
    assert "excavator@1" in stored
    assert "40 ready, 3 not enough, 29 cannot be shown" in stored
    listed = json.loads(shell("sysid datasets excavator --json - 2>/dev/null"))
    roles = {recording["name"]: recording["role"] for recording in listed["recordings"]}
    assert sum(role == "held_out" for name, role in roles.items() if name.startswith("steps_")) == 9
    assert {role for name, role in roles.items() if name.startswith("manual")} == {"fit", "select", "held_out"}
    assert blocks[5][1] == "sysid gap excavator\n"
