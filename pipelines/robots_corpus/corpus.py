"""The corpus: packages of ``corpus.toml``, their wheels in the workspace, and the robot models in them."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

#: Of random poses and recordings.
SEED = 0
LIST = Path(__file__).with_name("corpus.toml")
#: The start of a file, in which its root element is looked for [characters].
_HEAD = 20_000
_ROOT = re.compile(r"^(?:\ufeff|\s|<\?.*?\?>|<!--.*?-->)*<(robot|mujoco)\b", re.DOTALL)


@dataclass(frozen=True)
class Package:
    """A package of the index; ``files``: its models on the list, relative to the unpacked wheel."""

    name: str
    version: str
    licence: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class Robot:
    """One model file: ``root`` is the folder of its unpacked wheel."""

    package: str
    file: str
    root: Path

    @property
    def path(self) -> Path:
        return self.root / self.file

    @property
    def kind(self) -> str:
        """``urdf`` or ``mjcf``, by its suffix."""
        return "urdf" if self.file.endswith(".urdf") else "mjcf"

    @property
    def key(self) -> str:
        """A name for its folder."""
        return re.sub(
            r"[^A-Za-z0-9_]+", "-", f"{self.package}-{self.file.removesuffix('.urdf').removesuffix('.xml')}-{self.kind}"
        )


def packages(path: Path = LIST) -> tuple[Package, ...]:
    """The packages of the list."""
    values = tomllib.loads(path.read_text("utf-8"))["packages"]
    return tuple(Package(v["name"], v["version"], v["licence"], tuple(v["files"])) for v in values)


def fetch(wanted: Sequence[Package], work: Path) -> dict[str, Path]:
    """Package → folder of its unpacked wheel; wheels that are missing are downloaded with pip.

    A wheel is unpacked and not installed: nothing of it is run, and its files lie where the list says.

    Raises:
        RuntimeError: pip does not get a wheel.
    """
    wheels, found = work / "wheels", dict[str, Path]()
    for package in wanted:
        folder = work / "packages" / package.name
        if not folder.exists():
            wheel = _wheel(package, wheels) or _download(package, wheels)
            half = folder.with_name(f".{package.name}.part")
            with zipfile.ZipFile(wheel) as archive:
                archive.extractall(half)
            half.rename(folder)
        found[package.name] = folder
    return found


def _wheel(package: Package, wheels: Path) -> Path | None:
    return next(iter(sorted(wheels.glob(f"{package.name}-{package.version}-*.whl"))), None)


def _download(package: Package, wheels: Path) -> Path:
    requirement = f"{package.name}=={package.version}"
    options = ["--no-deps", "--only-binary", ":all:", "--quiet", "--disable-pip-version-check", "--dest", str(wheels)]
    command = [sys.executable, "-m", "pip", "download", *options, requirement]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wheel = _wheel(package, wheels)
    if done.returncode != 0 or wheel is None:
        last = (done.stderr.strip().splitlines() or ["no wheel"])[-1]
        raise RuntimeError(
            f"pip download {requirement}: {last}; expected its wheel. Check the connection to the package index."
        )
    return wheel


def listed(wanted: Sequence[Package], roots: dict[str, Path]) -> list[Robot]:
    """The models on the list."""
    return [Robot(package.name, file, roots[package.name]) for package in wanted for file in package.files]


def others(wanted: Sequence[Package], roots: dict[str, Path]) -> list[Robot]:
    """All further files of the packages whose root element is ``robot`` or ``mujoco``."""
    return [
        Robot(package.name, file, roots[package.name])
        for package in wanted
        for file in _models(roots[package.name])
        if file not in package.files
    ]


def _models(root: Path) -> Iterator[str]:
    for path in sorted(root.rglob("*")):
        if path.suffix in (".urdf", ".xml") and path.is_file():
            with path.open(encoding="utf-8", errors="replace") as text:
                if _ROOT.match(text.read(_HEAD)):
                    yield path.relative_to(root).as_posix()
