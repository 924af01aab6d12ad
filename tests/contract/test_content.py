"""Content folders are linted like code; nothing that crosses a trust boundary is a pickle."""

from __future__ import annotations

import ast
import hashlib
import re
import subprocess
import tomllib
from pathlib import Path
from typing import TypeGuard

import pytest

from sysid.extras import DISTRIBUTION, EXTRAS, install_command

ROOT = Path(__file__).parents[2]
FOLDERS = ("sysid", "rl/sysid_rl", "pipelines/simulated_bench")
CODE = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
CONTENT = ("datasets", "pipelines", "rl", "reports")
RAW_LOGS = {".mcap", ".csv", ".mat", ".parquet", ".bag", ".c3d", ".db3", ".blf"}


def tracked() -> list[Path]:
    """Files that ship. Outside of a repository (an unpacked archive): everything that is there."""
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    names = [name for name in done.stdout.split("\0") if name] if done.returncode == 0 else []
    paths = [ROOT / name for name in names] or list(ROOT.rglob("*"))
    return sorted(path for path in paths if path.is_file() and ".venv" not in path.parts)


def machines() -> list[Path]:
    return sorted(path.parent for path in (ROOT / "datasets").glob("*/machine.toml"))


@pytest.mark.parametrize("folder", CONTENT)
def test_content_folder_says_what_it_is_and_is_not_importable(folder: str) -> None:
    text = (ROOT / folder / "README.md").read_text("utf-8")
    assert text.startswith(f"# {folder}/")
    assert "sysid" in text, "say which code reads it"
    packages = {path.relative_to(ROOT).parts[1] for path in (ROOT / folder).rglob("__init__.py")}
    assert packages <= {"sysid_rl", "simulated_bench"}


def test_two_import_packages_with_their_files() -> None:
    """What is installed: ``sysid``, and ``sysid_rl`` in the folder of its recipes."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    assert settings["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["sysid", "rl/sysid_rl"]
    from hatchling.builders.wheel import WheelBuilder

    files = {file.distribution_path for file in WheelBuilder(str(ROOT)).recurse_included_files()}
    names = {path.relative_to(ROOT).as_posix() for path in tracked()}
    wanted = {name.removeprefix("rl/") for name in names if name.startswith(("sysid/", "rl/sysid_rl/"))}
    assert {"sysid/py.typed", "sysid_rl/py.typed", "sysid/cli/templates/servo-machine.toml"} <= wanted
    assert {name for name in files if not name.startswith("sysid/shipped/")} == wanted


def test_no_pickles() -> None:
    """Weights are safetensors, tables Parquet, the rest JSON or TOML; nothing reads what can run code."""
    modules = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
    called = {"torch.load", "torch.jit.load", "torch.save", "pd.read_pickle", "np.save"}
    wrong = []
    for path in CODE:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = set[str]()
            if isinstance(node, ast.Import):
                names = {alias.name.partition(".")[0] for alias in node.names} & modules
            elif isinstance(node, ast.ImportFrom):
                names = {(node.module or "").partition(".")[0]} & modules
            elif isinstance(node, ast.Attribute) and node.attr in {"load", "save", "to_pickle", "read_pickle"}:
                names = ({ast.unparse(node)} & called) | ({node.attr} & {"to_pickle", "read_pickle"})
            elif isinstance(node, ast.keyword) and node.arg == "allow_pickle" and ast.unparse(node.value) != "False":
                names = {"allow_pickle"}
            wrong += [f"{path.relative_to(ROOT)}: {name}" for name in names]
    assert wrong == []


@pytest.mark.parametrize("folder", machines(), ids=lambda folder: folder.name)
def test_dataset_folder_is_complete(folder: Path) -> None:
    readme = (folder / "README.md").read_text("utf-8").lower()
    assert "licence" in readme or "license" in readme, "the README states the licence of the data"
    assert (folder / "recipe.toml").is_file()


@pytest.mark.parametrize("folder", machines(), ids=lambda folder: folder.name)
def test_shipped_data_have_their_checksum(folder: Path) -> None:
    raw = [path for path in tracked() if path.is_relative_to(folder) and path.suffix in RAW_LOGS]
    if not raw:
        assert re.search(r"\b[0-9a-f]{64}\b", (folder / "README.md").read_text("utf-8") + sums_text(folder)), (
            "no data ship: the sha256 of the files to bring are stated"
        )
        return
    sums = dict(reversed(line.split(maxsplit=1)) for line in sums_text(folder).splitlines() if line.strip())
    sums = {name.lstrip("*./"): digest for name, digest in sums.items()}
    for path in raw:
        name = str(path.relative_to(folder))
        assert name in sums, f"{folder.name}/SHA256SUMS lacks {name}"
        assert hashlib.sha256(path.read_bytes()).hexdigest() == sums[name], f"{name} is not what SHA256SUMS says"


def sums_text(folder: Path) -> str:
    path = folder / "SHA256SUMS"
    return path.read_text("utf-8") if path.is_file() else ""


def test_no_text_holds_the_marks_of_a_merge() -> None:
    marks = tuple(sign * 7 + " " for sign in "<>")
    for pattern in ("*.md", "docs/**/*.md", "*/README.md", "*.toml", "*.txt", "Makefile", "rl/**/*.toml"):
        for path in ROOT.glob(pattern):
            found = [line for line in path.read_text("utf-8").splitlines() if line.startswith(marks)]
            assert not found, f"{path.relative_to(ROOT)}: {found[0]}"


def test_every_version_is_pinned() -> None:
    """Each dependency of pyproject.toml has an exact version in constraints.txt, and names no host."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = {name: own for name, own in project["optional-dependencies"].items() if name != "fuzz"}
    wanted = [
        text for own in (project["dependencies"], *extras.values()) for text in own if not text.startswith(project["name"])
    ]
    lines = [line for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9A-Za-z.!_]+", line) for line in lines), (
        "name==version, no hosts, no local versions"
    )
    pinned = {normal(line.partition("==")[0]) for line in lines}
    missing = {normal(re.split(r"[^A-Za-z0-9._-]", text)[0]) for text in wanted} - pinned
    assert not missing, f"constraints.txt lacks {sorted(missing)}"


def test_every_package_of_an_extra_is_known_to_the_message_about_it() -> None:
    """A missing package is answered by the extra that installs it, under the name of this distribution."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["name"] == DISTRIBUTION
    extras = project["optional-dependencies"]
    modules = {"rerun": "rerun-sdk", "can": "python-can", "serial": "pyserial", "pinocchio": "pin", "mujoco": "mujoco-core"}
    modules |= {"pxr": "usd-core", "newton_usd_schemas": "newton-usd-schemas", "pybullet_data": "pybullet"}
    for module, extra in EXTRAS.items():
        assert any(text.startswith(modules.get(module, module)) for text in extras[extra]), f"{module}: {extra}"
    known = {normal(modules.get(module, module)) for module in EXTRAS}
    used = {name for name in extras if name not in ("all", "dev", "docs", "fuzz")}
    assert used == set(EXTRAS.values())
    for name in used:
        assert {normal(re.split(r"[^A-Za-z0-9._-]", text)[0]) for text in extras[name]} <= known


#: Where a remedy is written: sources, docs, recipes of training, the README.
WRITTEN = {".py", ".md", ".ipynb", ".toml", ".html"}
INSTALLS = re.compile(r"pip install\s+['\"]?sysid(?P<rest>-toolkit)?\[(?P<extras>[^\]]*)\]")


def test_every_written_command_installs_extras_of_this_distribution() -> None:
    """``sysid`` is another project on the package index; an extra that pyproject.toml lacks installs nothing."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    found = {
        (str(path.relative_to(ROOT)), match)
        for path in tracked()
        if path.suffix in WRITTEN and path != Path(__file__)
        for match in INSTALLS.finditer(path.read_text("utf-8"))
    }
    assert found
    wrong = {place for place, match in found if match["rest"] is None}
    assert not wrong, f"install another project: {sorted(wrong)}"
    for place, match in found:
        if "{" in match["extras"]:  # of a format string
            continue
        assert {name.strip() for name in match["extras"].split(",")} <= extras.keys(), f"{place}: {match[0]}"


def test_a_refusal_about_a_missing_package_names_its_extra() -> None:
    """Each ``except ImportError`` that refuses takes its remedy from :mod:`sysid.extras`, for the module that it imports."""
    refusals = 0
    for path in CODE:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not isinstance(node, ast.Try):
                continue
            for handler in node.handlers:
                caught = {name.id for name in ast.walk(handler.type or handler) if isinstance(name, ast.Name)}
                raised = [name for name in ast.walk(handler) if isinstance(name, ast.Raise) and name.exc is not None]
                if not caught & {"ImportError", "ModuleNotFoundError"} or not raised:
                    continue
                refusals += 1
                modules = {ast.literal_eval(call.args[0]) for call in ast.walk(handler) if _is_remedy(call)}
                place = f"{path.relative_to(ROOT)}:{handler.lineno}"
                assert len(modules) == 1, f"{place}: one install_remedy"
                assert install_command(modules.pop()).startswith(f"pip install '{DISTRIBUTION}["), place
    assert refusals >= 5


def _is_remedy(node: ast.AST) -> TypeGuard[ast.Call]:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "install_remedy"


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
