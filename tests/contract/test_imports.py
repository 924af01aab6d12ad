"""Imports point one way, also from ``sysid_rl`` to ``sysid``; the simulated test bench stands alone; starting up is cheap."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "sysid"
#: What moves a machine: it builds on ``sysid``.
DOWNSTREAM = ROOT / "rl" / "sysid_rl"
BENCH = ROOT / "pipelines" / "simulated_bench"

#: From the ground floor up. A part may import itself and what stands on a lower floor, never a neighbour or a higher one.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("release", "current_folder", "errors", "foreign", "parse", "children", "lazy", "extras"),
    ("location",),
    ("units", "signals", "progress", "scratch", "files", "compiled", "cores", "pictures", "names", "numbers", "display"),
    ("config", "root", "execution", "confined", "quoting", "progress_bar"),
    ("figures",),
    ("logs", "machine"),
    ("effects",),
    ("datasets",),
    ("networks",),
    ("plant",),
    ("registry", "validate", "testing", "world"),
    ("gap", "versions"),
    ("reports", "export"),
    ("view", "actuators"),
    ("workspace",),
    ("model_versions", "fleet"),
    ("site", "front"),
    ("cli",),
)
#: The same of ``sysid_rl``; each may import all of ``sysid``.
DOWNSTREAM_FLOORS: tuple[tuple[str, ...], ...] = (("control",), ("train",), ("run",), ("cli",))
#: The simulated test bench has its own physics: it shares nothing with the library but errors and settings.
BENCH_MAY_IMPORT = {"errors", "config"}
#: Half a second and more each, or a compiler: only loaded by the verb that needs them.
HEAVY = (
    "torch",
    "pybullet",
    "mlflow",
    "rerun",
    "pandas",
    "numpy",
    "scipy",
    "sklearn",
    "numba",
    "plotly",
    "deltalake",
    "pint",
    "pyarrow",
    "gymnasium",
)


def sources(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.py") if "__pycache__" not in path.parts)


def part_of(path: Path, package: Path = PACKAGE) -> str:
    """``sysid/gap/result.py`` → ``gap``; ``sysid/errors.py`` → ``errors``; ``sysid/__init__.py`` → the empty name."""
    first = path.relative_to(package).parts[0].removesuffix(".py")
    return "" if first == "__init__" else first


@functools.cache
def import_statements(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """All of a file, inside functions and for types alone too."""
    tree = ast.parse(path.read_text("utf-8"), str(path))
    return tuple(node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom))


def imported_parts(path: Path, package: str = "sysid") -> Iterator[tuple[str, int]]:
    """The parts of a package that a file imports anywhere in it (also inside functions), with the line."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            module = node.module or ""
            names = [f"{package}.{alias.name}" for alias in node.names] if module == package else [module]
        for name in names:
            words = name.split(".")
            if words[0] == package and len(words) > 1 and words[1] != "__version__":
                yield words[1], node.lineno


def test_every_part_has_its_floor() -> None:
    listed = {part for floor in FLOORS for part in floor} | {""}
    found = {part_of(path) for path in sources(PACKAGE)}
    assert found <= listed, f"no floor for {sorted(found - listed)}: enter it in FLOORS"


def not_downwards(folder: Path, floors: Sequence[Sequence[str]]) -> list[str]:
    """Imports of files in a package that lead to its own floor or a higher one."""
    floor_of = {name: number for number, floor in enumerate(floors) for name in floor}
    return [
        f"{path.relative_to(ROOT)}, line {line}: {folder.name}.{other}"
        for path in sources(folder)
        if path != folder / "__init__.py"  # the names that the package offers are of many parts
        for part in [part_of(path, folder)]
        for other, line in imported_parts(path, folder.name)
        if other != part and floor_of.get(other, len(floors)) >= floor_of.get(part, -1)
    ]


def test_imports_point_downwards() -> None:
    assert not_downwards(PACKAGE, FLOORS) == []


def test_imports_of_the_package_downstream_point_downwards() -> None:
    assert not_downwards(DOWNSTREAM, DOWNSTREAM_FLOORS) == []
    files = [path for path in sources(DOWNSTREAM) if path != DOWNSTREAM / "__init__.py"]
    assert {part_of(path, DOWNSTREAM) for path in files} <= {part for floor in DOWNSTREAM_FLOORS for part in floor}
    verbs = [path for path in files if "cli" in {other for other, _ in imported_parts(path)}]
    assert [path for path in verbs if part_of(path, DOWNSTREAM) != "cli"] == []


def test_the_simulated_test_bench_shares_nothing_with_what_is_tested_on_it() -> None:
    for path in sources(BENCH):
        wrong = [f"line {line}: sysid.{other}" for other, line in imported_parts(path) if other not in BENCH_MAY_IMPORT]
        wrong += [f"line {line}: sysid_rl.{other}" for other, line in imported_parts(path, "sysid_rl")]
        assert not wrong, f"{path.relative_to(ROOT)} may not import {wrong}"


@pytest.mark.parametrize(
    ("folder", "word"), [(PACKAGE, "sysid_rl"), (PACKAGE, "simulated_bench"), (DOWNSTREAM, "simulated_bench")]
)
def test_a_package_does_not_name_what_builds_on_it(folder: Path, word: str) -> None:
    """Neither in an import, in a function either, nor as a name that is imported later: entry points lead to verbs."""
    assert [str(path.relative_to(ROOT)) for path in sources(folder) if word in path.read_text("utf-8")] == []


def imported_modules(path: Path) -> Iterator[str]:
    """Modules of ours that a file imports, inside functions and for types alone too; of a package, what it takes from it."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            while name and name not in MODULES:
                name = name.rpartition(".")[0]
            if name:
                yield name


def module_of(path: Path) -> str:
    root = next(folder.parent for folder in (PACKAGE, DOWNSTREAM, BENCH) if path.is_relative_to(folder))
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in (*sources(PACKAGE), *sources(DOWNSTREAM), *sources(BENCH))}


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Modules that reach themselves, and what needs them: those left when modules that import none of the rest are removed."""
    left = dict(imports)
    while free := [name for name, needed in left.items() if not needed & left.keys()]:
        for name in free:
            del left[name]
    return [sorted(left)] if left else []


def test_no_module_imports_itself_through_others() -> None:
    assert circles({name: set(imported_modules(path)) - {name} for name, path in MODULES.items()}) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c", "d"]]


def test_the_checker_sees_an_upward_import(tmp_path: Path) -> None:
    bad = tmp_path / "bad.py"
    bad.write_text("def f():\n    from sysid.gap import find_gap\n    import sysid.site.item\n    from sysid import cli\n")
    assert list(imported_parts(bad)) == [("gap", 2), ("site", 3), ("cli", 4)]


def defined_in(path: Path) -> set[str]:
    """Names that a module has, those that it imports lazily among them."""
    tree = ast.parse(path.read_text("utf-8"), str(path))
    nodes, found = list(ast.walk(tree)), set[str]()
    if any(isinstance(node, ast.Name) and node.id == "lazy_names" for node in nodes):
        found = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
    return found


def missing_names(path: Path, defined: dict[str, set[str]]) -> list[str]:
    """What a file takes from our packages that is not there."""
    nodes = (node for node in import_statements(path) if isinstance(node, ast.ImportFrom))
    ours = [node for node in nodes if (node.module or "").partition(".")[0] in ("sysid", "sysid_rl", "simulated_bench")]
    taken = [(node.lineno, str(node.module), alias.name) for node in ours for alias in node.names]
    return [
        f"{path.name}, line {line}: {name} of {module}"
        for line, module, name in taken
        if name not in defined.get(module, set()) and f"{module}.{name}" not in defined
    ]


def test_studies_and_tests_take_from_sysid_what_is_there(tmp_path: Path) -> None:
    defined = {name: defined_in(path) for name, path in MODULES.items()}
    files = [*sources(PACKAGE), *sources(DOWNSTREAM), *sources(ROOT / "pipelines"), *sources(ROOT / "tests")]
    assert [text for path in files for text in missing_names(path, defined)] == []
    bad = tmp_path / "bad.py"
    bad.write_text("from sysid.cores import cores, processors\nfrom sysid import nothing, gap\n")
    assert missing_names(bad, defined) == [
        "bad.py, line 1: processors of sysid.cores", "bad.py, line 2: nothing of sysid",
    ]  # fmt: skip


def loaded_after(code: str) -> set[str]:
    """Top-level modules in memory after running ``code`` in a fresh interpreter."""
    script = f"import sys\n{code}\nprint('LOADED', *sorted({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_import_sysid_is_light() -> None:
    loaded = loaded_after("import sysid")
    assert "sysid" in loaded
    assert not loaded & set(HEAVY)


def test_help_is_light() -> None:
    loaded = loaded_after(
        "from sysid.cli import main\ntry:\n    main(['--help'])\nexcept SystemExit as stop:\n    assert not stop.code"
    )
    assert "click" in loaded
    assert not loaded & {*HEAVY, "rich", "jinja2", "pydantic"}


def loaded_by_verb(*words: str) -> set[str]:
    call = f"main({list(words)!r})"
    return loaded_after(f"from sysid.cli import main\ntry:\n    {call}\nexcept SystemExit as stop:\n    assert not stop.code")


@pytest.fixture(scope="module")
def small_workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One dataset and one promoted plant."""
    from one_axis_logs import MACHINE, record

    from sysid.datasets import ingest
    from sysid.plant import nominal_plant
    from sysid.registry import Check, PromotionDecision
    from sysid.workspace import open_workspace

    folder = tmp_path_factory.mktemp("light")
    for seed in range(3):
        record(folder / f"logs/r{seed}", seed)
    (folder / "machine.toml").write_text(MACHINE, "utf-8")
    dataset = ingest([folder / "logs"], folder / "workspace", folder / "machine.toml")
    workspace = open_workspace(folder / "workspace")
    made = workspace.models.register("demo", "plant", nominal_plant(dataset.machine).to_files(), {"dataset": dataset.reference})
    decision = PromotionDecision(True, "", (Check("names", "passed", "all"),), decided_ms=1)
    workspace.models.promote(made.reference, decision=decision)
    return folder / "workspace"


@pytest.mark.parametrize(
    "words",
    ["models", "models demo", "models --kind plant", "datasets", "datasets --help", "models --help"],
)
def test_lists_are_light(small_workspace: Path, words: str) -> None:
    """They print a few lines, and do not wait for the numerical libraries."""
    loaded = loaded_by_verb("--workspace", str(small_workspace), *words.split())
    assert "click" in loaded
    assert not loaded & {*HEAVY, "sqlalchemy", "jinja2", "alembic"}


def test_init_is_light(tmp_path: Path) -> None:
    assert not loaded_by_verb("init", str(tmp_path / "crane")) & {*HEAVY, "sqlalchemy", "jinja2"}


def test_every_public_name_of_a_lazy_package_exists() -> None:
    import sysid.datasets

    for name in sysid.datasets.__all__:
        assert getattr(sysid.datasets, name).__module__.startswith("sysid.datasets") or name in ("Kind", "Role"), name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = sysid.datasets.nothing
