"""Every verb on machines and logs at the edges of numbers: no traceback, and JSON that is JSON. ``make fuzz`` tries more."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from command_line import run
from edge_machines import edge_machine, from_bytes, write_machine
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "fuzz"))
from whole_verbs import run_edges


@settings(max_examples=5, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_verbs_end_without_a_traceback(data: Any) -> None:
    case = edge_machine(lambda options: data.draw(st.sampled_from(options)))
    with TemporaryDirectory() as folder:
        run_edges(case, Path(folder))


@pytest.mark.slow
@pytest.mark.parametrize("choices", ["", "000000000001", "00000000000001", "0002", "0000000002", "03"])
def test_the_whole_search_ends_without_a_traceback(choices: str, tmp_path: Path) -> None:
    """An ordinary machine, constant commands, an axis that stands still, 2 Hz, servo axes, six axes."""
    write_machine(from_bytes(bytes.fromhex(choices)), tmp_path / "edge")
    workspace = ("--workspace", tmp_path / "ws")
    assert run(*workspace, "ingest", tmp_path / "edge") == 0
    assert run(*workspace, "gap", "edge") in (0, 2)
