"""Notebooks run from top to bottom, and the outputs that are stored with them are those of a run."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from notebook_run import code_cells, run, texts
from page_walk import departures

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs/notebooks/first-look.ipynb"


def test_stored_outputs_are_those_of_a_run_from_top_to_bottom() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert {output.output_type for cell in cells for output in cell.outputs} <= {"execute_result", "display_data"}
    assert all("<script" not in text for cell in cells for output in cell.outputs for text in output.data.values())


@pytest.mark.slow
def test_the_first_look_finds_what_the_logs_hide(tmp_path: Path) -> None:
    """The same texts as those stored, up to rounding on another processor."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    stored = texts(notebook)
    run(notebook, tmp_path)
    for kept, fresh in zip(stored, texts(notebook), strict=True):
        assert departures(timeless(kept), timeless(fresh)) == [], "renew: python tests/helpers/notebook_run.py NOTEBOOK"
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    assert {output.output_type for output in outputs} <= {"execute_result", "display_data"}, "nothing is written to the console"
    table = next(text for text in stored if "held-out error" in text)
    assert all(word in table for word in ("Backlash of slew", "Valve dead-band of boom", "Swinging tool"))
    assert max(map(len, table.splitlines())) <= 80
    rich = next(output.data["text/html"] for output in outputs if "Backlash of slew" in output.data.get("text/html", ""))
    assert "<td>Backlash of slew</td>" in rich
    assert "<polyline" in rich
    assert sum("image/svg+xml" in output.data for output in outputs) == 2
    assert "RepairedPlant(autolog@2)" in stored[-1]
    assert list(tmp_path.glob("tmpdir/sysid-*/report.html"))


def timeless(text: str) -> str:
    """Without the seconds that a run took and the length of a picture."""
    return re.sub(r", [\d.]+ s\]|\(\d+ characters", "", text)
