"""No library takes settings or code from the current folder, or from a folder of data."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from sysid.children import python_command

ROOT = Path(__file__).parents[2]
CODE = "from pathlib import Path\nPath({!r}).touch()\n"
MODULES = ("numpy", "scipy", "numba", "yaml", "torch", "mlflow", "dask", "matplotlib", "rerun", "pybullet", "mujoco", "click")
#: Files that a library of the environment is known to read in some folder: name → text, in which CANARY is a file to be made.
PLANTED = {
    ".numba_config.yaml": "cache_dir: CANARY\nchrome_trace: CANARY\nopt: 0\n",
    "matplotlibrc": "backend: module://planted\n",
    ".env": "NUMBA_CACHE_DIR=CANARY\nMLFLOW_TRACKING_URI=CANARY\nPYTHONSTARTUP=planted.py\n",
    "dask.yaml": "distributed: {scheduler: {preload: [planted.py]}, worker: {preload: [planted.py]}}\n",
    "distributed.yaml": "distributed: {scheduler: {preload: [planted.py]}, worker: {preload: [planted.py]}}\n",
    ".config/dask/dask.yaml": "distributed: {scheduler: {preload: [planted.py]}}\n",
    "alembic.ini": "[alembic]\nscript_location = .\n",
    "env.py": CODE,
    "MLproject": "entry_points: {main: {command: touch CANARY}}\n",
    "mlruns/meta.yaml": "artifact_location: CANARY\n",
    "sitecustomize.py": CODE,
    "usercustomize.py": CODE,
    "planted.py": CODE,
    "planted.pth": "import planted\n",
    "conftest.py": CODE,
    "ipython_config.py": CODE,
    "jupyter_config.py": CODE,
    ".pdbrc": "!open('CANARY', 'w')\n",
    "setup.cfg": "[options.entry_points]\nmlflow.tracking_store = x = planted:x\n",
    "planted-1.0.dist-info/METADATA": "Name: planted\nVersion: 1.0\n",
    "planted-1.0.dist-info/entry_points.txt": "[mlflow.app]\nplanted = planted:app\n[dask.sizeof]\nplanted = planted:size\n",
    "can.conf": "[default]\ninterface = planted\n",
    "can.ini": "[default]\ninterface = planted\n",
    ".canrc": "[default]\ninterface = planted\n",
    ".netrc": "default login a password b\n",
    "pyvenv.cfg": "home = .\n",
    "site.cfg": "[ALL]\nlibrary_dirs = .\n",
    ".git/config": "[core]\nfsmonitor = touch CANARY\nsshCommand = touch CANARY\n",
    "mujoco_plugin/libplanted.so": "",
    "libomp.so": "",
    "_ops.py": CODE,
    "_classes.py": CODE,
    **{f"{name}.py": CODE for name in MODULES},
}
RECIPE = """
[actuator]
model = "history"
samples = 100
[actuator.history]
units = 2
epochs = 2
check_every = 1
"""
#: A program that compiles a function as the package does, and says which folder Numba would take; FIRST: imported first.
COMPILES = """
import sys
sys.addaudithook(lambda event, details: event == "open" and print("opened", details[0]))
import FIRST, sysid, numba
from sysid.compiled import kernel

@kernel
def same(x):
    return x

same(1.0)
print("cache", repr(numba.config.CACHE_DIR), int(numba.config.OPT))
"""


def compiles(folder: Path, program: Path, first: str = "sysid", **environment: str) -> list[str]:
    """Lines of the program, run in ``folder``."""
    program.write_text(COMPILES.replace("FIRST", first))
    variables = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")} | environment
    command = python_command(str(program))
    return subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=True).stdout.splitlines()


#: Draws of a bootstrap, then an import of the user's own.
DRAWS = """
import numpy
from sysid.validate.metrics import bootstrap_means
bootstrap_means(numpy.arange(50.0), 0)
print("drawn")
import matplotlib
"""


def plant(folder: Path, canary: Path, names: Sequence[str] = ()) -> None:
    for name, text in {**dict.fromkeys(names, CODE), **PLANTED}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text.format(str(canary)) if text is CODE else text.replace("CANARY", str(canary)))


def test_numba_takes_no_settings_from_the_current_folder(tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    (stranger := tmp_path / "stranger").mkdir()
    plant(stranger, canary)
    *opened, cache = compiles(stranger, tmp_path / "program.py")
    assert cache == "cache '' 3"
    assert not [line for line in opened if line.removeprefix("opened ") in PLANTED]
    assert not canary.exists()


def test_what_numba_took_before_is_undone(tmp_path: Path) -> None:
    """A program that imports it first: that Numba then reads the file cannot be prevented, but nothing of ours uses it."""
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {tmp_path / 'canary'}\nopt: 0\n")
    *opened, cache = compiles(tmp_path, tmp_path / "program.py", "numba")
    assert "opened .numba_config.yaml" in opened
    assert cache == "cache '' 3"
    assert not (tmp_path / "canary").exists()


def test_a_setting_of_the_environment_is_the_users(tmp_path: Path) -> None:
    (tmp_path / ".numba_config.yaml").write_text("opt: 0\n")
    mine = str(tmp_path / "mine")
    *_, cache = compiles(tmp_path, tmp_path / "program.py", NUMBA_CACHE_DIR=mine, NUMBA_OPT="1")
    assert cache == f"cache {mine!r} 1"


def test_matplotlib_is_not_imported_even_where_it_is_installed(tmp_path: Path) -> None:
    """It opens ``matplotlibrc``, which may be a pipe, and would wait for ever."""
    (tmp_path / "matplotlib").mkdir()
    (tmp_path / "matplotlib" / "__init__.py").write_text("print('imported')\n__version__ = '3.9'\n")
    done = subprocess.run(
        python_command("-c", DRAWS), env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["drawn", "imported"]


def verbs() -> list[list[str]]:
    """Commands of a whole piece of work."""
    return [
        ["ingest", "data", "--name", "one"],
        ["ingest", "data", "--name", "two", "--workers", "2"],
        ["datasets", "one", "--quality"],
        ["gap", "one", "--add"],
        ["fit", "actuator", "one", "--recipe", "recipe.toml"],
        ["models"],
        ["models", "card", "one-history"],
        ["models", "lineage", "one-history"],
        ["export", "autolog", "--to", "mjcf", "--out", "workspace/mjcf"],
        ["report", "one"],
        ["view", "one"],
        ["ui"],
    ]


def traced(words: Sequence[str], folder: Path, log: Path) -> tuple[set[str], set[str]]:
    """Names in ``folder`` (relative) that a command opened or executed, and those that it looked for."""
    command = ["strace", "-f", "-qq", "-y", "--seccomp-bpf", "-s", "4096", "-e", "trace=%file", "-o", str(log)]
    done = subprocess.run(
        [*command, str(Path(sys.executable).with_name("sysid")), *words],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, (words, done.stderr[-2000:])
    opened, looked = set(), set()
    for line in log.read_text(errors="replace").splitlines():
        found = re.match(r'\d+ +(\w+)\((?:(?:AT_FDCWD|\d+)<([^>]*)>, )?"((?:[^"\\]|\\.)*)"', line)
        if found is None or not found[3]:
            continue
        path = os.path.normpath(os.path.join(found[2] or folder, found[3]))
        if path != str(folder) and path.startswith(f"{folder}/"):
            name = os.path.relpath(path, folder)
            looked.add(name)
            if found[1].startswith(("open", "exec")) and "ENOENT" not in line:
                opened.add(name)
    return opened, looked


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.timeout(1800)
def test_no_verb_opens_a_file_of_a_stranger_that_it_was_not_told_to(tmp_path: Path) -> None:
    """First in a folder with the data alone: what is looked for beside them is then planted as well, and not opened."""
    named = {"data", "workspace", "recipe.toml"}
    looked: dict[str, set[str]] = {}
    for visit in ("empty", "planted"):
        folder = tmp_path / visit
        shutil.copytree(ROOT / "datasets" / "autolog", folder / "data")
        (folder / "recipe.toml").write_text(RECIPE)
        if visit == "planted":
            beside = {name for names in looked.values() for name in names if name.split("/")[0] not in named}
            plant(folder, tmp_path / "canary", sorted(beside))
            plant(folder / "data", tmp_path / "canary")
        strange = {name for path in PLANTED for name in (path, f"data/{path}")}
        for words in verbs():
            opened, looked[str(words)] = traced(words, folder, tmp_path / "trace")
            wrong = {name for name in opened if name in strange or name.split("/")[0] not in named}
            assert not wrong, (visit, words)
            assert not (tmp_path / "canary").exists(), words
