"""Notebooks run from top to bottom, and are stored without outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


@pytest.fixture
def jupyter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folders of Jupyter and IPython below this one; the kernel imports this checkout."""
    for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR", "TMPDIR"):
        folder = tmp_path / name.lower()
        folder.mkdir()
        monkeypatch.setenv(name, str(folder))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    return tmp_path


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert [cell.id for cell in code_cells(notebook) if cell.outputs or cell.execution_count is not None] == []


@pytest.mark.slow
def test_the_first_look_finds_what_the_logs_hide(jupyter: Path) -> None:
    """The kernel is a process of its own, so that warnings and the working directory are those of a user."""
    notebook = nbformat.read(ROOT / "docs/notebooks/first-look.ipynb", as_version=4)
    NotebookClient(notebook, timeout=540, kernel_name="python3", resources={"metadata": {"path": str(jupyter)}}).execute()
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    assert [output for output in outputs if output.output_type not in ("execute_result", "display_data")] == []
    texts = ["".join(output.data.get("text/plain", "")) for output in outputs]
    table = next(text for text in texts if "held-out error" in text)
    assert all(word in table for word in ("Backlash of slew", "Valve dead-band of boom", "Swinging tool"))
    assert max(map(len, table.splitlines())) <= 80
    rich = next(output.data["text/html"] for output in outputs if "Backlash of slew" in output.data.get("text/html", ""))
    assert "<td>Backlash of slew</td>" in rich
    assert "<polyline" in rich
    assert sum("image/svg+xml" in output.data for output in outputs) == 2
    assert "RepairedPlant(autolog@2)" in texts[-1]
    assert list(jupyter.glob("tmpdir/sysid-*/report.html"))
