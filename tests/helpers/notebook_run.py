"""The outputs of a notebook, which are stored with it and shown on the documentation site.

    python tests/helpers/notebook_run.py docs/notebooks/first-look.ipynb    (runs it, and stores its outputs anew)

The kernel is a process of its own, so that warnings and the working directory are those of a user.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from unittest import mock

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

ROOT = Path(__file__).parents[2]
FOLDERS = ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR", "TMPDIR")
#: What a site without scripts shows of an output.
SHOWN = ("text/plain", "text/html", "image/svg+xml")


def run(notebook: NotebookNode, folder: Path) -> None:
    """Replace the outputs of ``notebook`` by those of a run in ``folder``, with the settings of Jupyter below it."""
    folders = {name: str(folder / name.lower()) for name in FOLDERS}
    for path in folders.values():
        Path(path).mkdir()
    settings = {"PYTHONPATH": str(ROOT), "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    with mock.patch.dict(os.environ, folders | settings):
        NotebookClient(notebook, timeout=540, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    for cell in code_cells(notebook):
        cell.metadata = NotebookNode()  # when it ran
        for output in cell.outputs:
            output.data = NotebookNode({kind: text for kind, text in output.get("data", {}).items() if kind in SHOWN})
        cell.outputs = [
            output for output in cell.outputs if output.data.get("text/html", "-")
        ]  # a bar that was removed is empty


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def texts(notebook: NotebookNode) -> list[str]:
    """The outputs as plain text, in order."""
    return [str(output.data["text/plain"]) for cell in code_cells(notebook) for output in cell.outputs]


def main() -> None:
    """Run a notebook and store its outputs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path)
    path = parser.parse_args().path
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        run(notebook, Path(folder))
    nbformat.write(notebook, path)


if __name__ == "__main__":
    main()
