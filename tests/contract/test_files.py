"""Files appear whole or not at all; values become JSON without loss of what JSON can say."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sysid.files import json_text, plain, write_durably, written_whole


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    with written_whole(path) as half:
        half.write_text("old")

    def fail_on_the_way() -> None:
        with written_whole(path) as half:
            half.write_text("new, but")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        fail_on_the_way()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_writer_left_goes_with_the_next_write(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        pass
    here = platform.node()
    left, running, elsewhere, other = (
        tmp_path / name
        for name in (
            f".a.json.{here}-{dead.pid}-0123abcd.part",
            f".a.json.{here}-{os.getpid()}-0123abcd.part",
            f".a.json.elsewhere-{dead.pid}-0123abcd.part",
            f".b.json.{here}-{dead.pid}-0123abcd.part",
        )
    )
    for path in (left, running, elsewhere, other):
        path.write_text("half")
    write_durably(tmp_path / "a.json", b"whole", "state", "Make room.")
    assert sorted(tmp_path.iterdir()) == sorted([tmp_path / "a.json", running, elsewhere, other])
    assert (tmp_path / "a.json").read_bytes() == b"whole"


def test_values_become_plain() -> None:
    value = {1: np.float64("nan"), "a": (np.int64(3), np.float32(0.5)), "b": np.array([[1.0, np.inf]]), "c": Path("x/y")}
    assert plain(value) == {"1": None, "a": [3, 0.5], "b": [[1.0, None]], "c": "x/y"}
    assert json.loads(json_text(value)) == plain(value)
