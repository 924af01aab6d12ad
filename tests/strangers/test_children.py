"""What lies in the current folder is not run: by no child process, whatever it is called."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from sysid.children import SAFE_PATH, child_environment, python_command, safe_children

ROOT = Path(__file__).parents[2]
TRAP = "from pathlib import Path\nPath({!r}).write_text('ran')\nraise SystemExit('ran')\n"
#: Modules that a Python process imports before anything of ours can say where to look.
FIRST = ("multiprocessing", "sysid", "numpy", "click", "pickle", "typing_extensions")
SEEDS = """
import sys
from sysid.execution import LocalExecutor

def double(number, progress):
    return 2 * number

if __name__ == "__main__":
    print(LocalExecutor(2).run(double, [(1,), (2,)], reports=True))
"""


@pytest.fixture
def traps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of a stranger, which is the current one; the path of the file that its modules would write."""
    folder = tmp_path / "stranger"
    folder.mkdir()
    for name in FIRST:
        (folder / f"{name}.py").write_text(TRAP.format(str(tmp_path / "ran")))
    monkeypatch.chdir(folder)
    monkeypatch.delenv(SAFE_PATH, raising=False)
    return tmp_path / "ran"


def test_a_python_child_imports_nothing_from_the_current_folder(traps: Path) -> None:
    environment = child_environment() | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        python_command("-m", "sysid.cli", "--help"), env=environment, capture_output=True, text=True, check=True
    )
    assert "Verbs, in the order of work" in done.stdout
    assert not traps.exists()


def test_the_processes_of_several_seeds_import_nothing_from_the_current_folder(traps: Path, tmp_path: Path) -> None:
    script = tmp_path / "seeds.py"
    script.write_text(SEEDS)
    environment = {key: value for key, value in os.environ.items() if key != SAFE_PATH} | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[2, 4]", done.stderr
    assert not traps.exists()


def test_the_environment_is_as_it_was_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    for before in (None, "", "1"):
        monkeypatch.delenv(SAFE_PATH, raising=False) if before is None else monkeypatch.setenv(SAFE_PATH, before)
        with safe_children():
            assert os.environ[SAFE_PATH] == "1"
        assert os.environ.get(SAFE_PATH) == before


def test_the_viewer_of_a_run_is_such_a_child(monkeypatch: pytest.MonkeyPatch) -> None:
    from sysid_rl.cli.run import show_log

    started: list[tuple[list[str], dict[str, str]]] = []

    def start(command: list[str], env: dict[str, str], **_: object) -> SimpleNamespace:
        started.append((command, env))
        return SimpleNamespace(pid=os.getpid())

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(os, "setpriority", lambda *_: None)
    show_log(Path("-odd.mcap"))
    ((command, environment),) = started
    assert command[:3] == [sys.executable, "-P", "-m"]
    assert command[-2:] == ["--", "-odd.mcap"], "a file is no option, whatever its name"
    assert environment[SAFE_PATH] == "1"


def test_every_place_that_starts_a_process_is_listed() -> None:
    """Readers that run in a process of their own enter theirs here."""
    found = set()
    folders = ("sysid", "rl/sysid_rl", "pipelines/simulated_bench")
    for path in sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        if not re.search("subprocess|multiprocessing|concurrent|pty|runpy", path.read_text("utf-8")):
            continue
        modules = {
            name.name if isinstance(node, ast.Import) else str(node.module)
            for node in ast.walk(ast.parse(path.read_text("utf-8")))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in node.names
        }
        if modules & {"subprocess", "multiprocessing", "concurrent.futures", "pty", "runpy"}:
            found.add(path)
    starts = {path for path in found if "ThreadPool" not in path.read_text("utf-8")}
    for path in sorted(starts):
        text = path.read_text("utf-8")
        assert any(word in text for word in ("python_command", "safe_children")), f"{path} starts a process: see sysid.children"
