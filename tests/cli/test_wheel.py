"""The wheel in fresh environments: the core alone runs the demo on every Python that is supported, and here."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
VERSIONS = ("3.11", "3.12", "3.13")


def interpreter(version: str) -> str:
    """A Python of this version that runs: this one, one on the PATH, or one that pyenv has installed; empty without any.

    A shim of pyenv is on the PATH for versions that it refuses to run.
    """
    managed = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/{version}.*/bin/python"))
    found = (sys.executable, shutil.which(f"python{version}"), *map(str, managed))
    return next((python for python in found if python is not None and runs(python, version)), "")


def runs(python: str, version: str) -> bool:
    text = "import sys; print('%d.%d' % sys.version_info[:2])"
    done = subprocess.run([python, "-c", text], capture_output=True, text=True, check=False)
    return done.returncode == 0 and done.stdout.strip() == version


def command(*words: object, folder: Path) -> str:
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        list(map(str, words)), cwd=folder, env=environment, capture_output=True, text=True, timeout=1800, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder, ROOT, folder=folder)
    return next(folder.glob("sysid_toolkit-*.whl"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("version", VERSIONS)
def test_the_core_runs_the_demo(wheel: Path, tmp_path: Path, version: str) -> None:
    python = interpreter(version)
    if not python:
        pytest.skip(f"Python {version} is not here")
    command(python, "-m", "venv", tmp_path / "env", folder=tmp_path)
    tool = tmp_path / "env/bin/sysid"
    installed = subprocess.run(
        [tmp_path / "env/bin/python", "-m", "pip", "install", "--quiet", wheel], capture_output=True, text=True, check=False
    )
    if installed.returncode:
        pytest.skip("no packages can be installed here")
    shown = command(tool, "--workspace", "ws", "demo", folder=tmp_path)
    assert "Networks were left out: pip install 'sysid-toolkit[networks]'" in shown
    found = json.loads((tmp_path / "ws/demo/result.json").read_text())["gap"]
    names = {(effect["name"], effect["target"]) for effect in found["effects"]}
    assert names == {("backlash", "slew"), ("valve_deadband", "boom"), ("gripper_sway", "tool")}
    assert (tmp_path / "ws/demo/report.html").stat().st_size > 1e6
    command(tool, "--workspace", "ws", "ui", folder=tmp_path)
    assert (tmp_path / "ws/site/reports/autolog@1.html").is_file()
    failed = subprocess.run(
        [tool, "--workspace", "ws", "view", "autolog"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert failed.returncode == 2
    assert "pip install 'sysid-toolkit[view]'" in failed.stderr
