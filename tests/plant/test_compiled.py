"""Compiled code: the folder in which it is kept between processes."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.codegen import JITCodeLibrary

from sysid import compiled

ROOT = Path(__file__).parents[2]
#: A child says whether it was warned, and where it keeps compiled code.
CHILD = """
import warnings
with warnings.catch_warnings(record=True) as seen:
    warnings.simplefilter("always")
    from sysid import compiled
    folder = compiled.cache_folder()
print(any("for this process only" in str(w.message) for w in seen), folder.is_dir(), folder)
"""


def printed_by_child(**environment: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", CHILD], env={"PATH": "", **environment}, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_it_is_kept_by_its_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("effects", "plant"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(compiled, "_PACKAGE", tmp_path)
    before = compiled.source_digest()
    assert compiled.source_digest() == before
    (tmp_path / "effects" / "a.py").write_text("x = 2\n")
    assert compiled.source_digest() != before
    (tmp_path / "effects" / "a.py").rename(tmp_path / "effects" / "b.py")
    changed = compiled.source_digest()
    (tmp_path / "effects" / "b.py").write_text("x = 1\n")
    assert len({before, changed, compiled.source_digest()}) == 3
    (tmp_path / "compiled.py").write_text("fastmath = True\n")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert compiled.source_digest() not in {before, changed}


def test_code_of_another_package_is_kept_by_the_sources_beside_it_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    compiled.cache_folder.cache_clear()
    try:
        (tmp_path / "law.py").write_text("def law(x):\n    return x\n")
        folders = {compiled.cache_folder(), compiled.cache_folder(tmp_path)}
        compiled.cache_folder.cache_clear()
        (tmp_path / "tuning.py").write_text("SHARE = 0.5\n")
        assert len({*folders, compiled.cache_folder(), compiled.cache_folder(tmp_path)}) == 3
    finally:
        compiled.cache_folder.cache_clear()


@pytest.mark.parametrize(("variable", "below"), [("XDG_CACHE_HOME", "sysid/numba"), ("NUMBA_CACHE_DIR", "")])
def test_its_folder_is_named_after_the_sources(tmp_path: Path, variable: str, below: str) -> None:
    folder = tmp_path / below / compiled.source_digest()[:16]
    assert printed_by_child(**{variable: str(tmp_path)}) == ["False", "True", str(folder)]


def test_a_folder_that_cannot_be_written_warns(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    assert printed_by_child(XDG_CACHE_HOME=str(blocked), TMPDIR=str(tmp_path))[:2] == ["True", "True"]


#: A program with a kernel of two parts, which says what it computes and how often it compiled.
PROGRAM = """
from sysid.compiled import inlined, kernel, loop

@inlined
def twice(x):
    return 2.0 * x

@loop
def total(values):
    found = 0.0
    for value in values:
        found += twice(value)
    return found

@kernel
def whole(values):
    return total(values) + twice(1.0)

import numpy as np
print(whole(np.arange(5.0)), sum(whole.stats.cache_misses.values()))
"""


def test_a_later_process_compiles_nothing_also_in_another_working_copy(tmp_path: Path) -> None:
    environment = {"PATH": "", "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = []
    for copy, text in (("one", PROGRAM), ("two", PROGRAM), ("two", PROGRAM.replace("2.0", "3.0"))):
        program = tmp_path / copy / "same" / "program.py"
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(text)
        run = [sys.executable, str(program)]
        said.append(subprocess.run(run, env=environment, capture_output=True, text=True, check=True).stdout)
    assert said == ["22.0 1\n", "22.0 0\n", "33.0 1\n"]


def test_machine_code_is_made_of_kernels_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    library: Any = JITCodeLibrary
    before = library._finalize_specific
    monkeypatch.setattr(library, "_finalize_specific", lambda self: (made.append(self.name), before(self)))

    inlined: Any = compiled.inlined
    loop: Any = compiled.loop

    @inlined
    def halved(x: Any) -> Any:
        return 0.5 * x

    @loop
    def quartered(x: Any) -> Any:
        return halved(halved(x))

    def whole(x: Any) -> Any:
        return quartered(x) + halved(x)

    assert compiled.kernel(whole)(3.0) == 2.25
    assert {"halved", "quartered", "whole"} & {name.rpartition(".")[2] for name in made} == {"whole"}


def test_the_setting_of_other_packages_is_restored() -> None:
    def same(x: float) -> float:
        return x

    before = numba.config.CACHE_DIR
    compiled.kernel(same)
    assert before == numba.config.CACHE_DIR


def test_one_module_imports_numba() -> None:
    """Code that another one caches would lie in a folder that nobody chose."""
    importing = set()
    folders = ("sysid", "rl/sysid_rl", "pipelines/simulated_bench")
    texts = {path: path.read_text("utf-8") for folder in folders for path in (ROOT / folder).rglob("*.py")}
    for path, text in texts.items():
        for node in ast.walk(ast.parse(text)) if "numba" in text else ():
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == "numba" for name in names):
                importing.add(str(path.relative_to(ROOT)))
    assert importing == {"sysid/compiled.py", "pipelines/simulated_bench/compiled.py"}, "use sysid.compiled"


@pytest.mark.parametrize("part", [compiled.inlined, compiled.loop], ids=["inlined", "loop"])
def test_a_part_is_the_same_function_in_a_kernel_and_in_python(part: Any) -> None:
    @part
    def doubled(x: Any) -> Any:
        """Twice as much."""
        return x + x

    whole = numba.njit(lambda x: doubled(x) + 1.0)
    assert whole(3.0) == doubled(3.0) + 1.0 == 7.0
    assert doubled.__doc__ == "Twice as much."
