"""Installed size of the core and of each extra: files of all distributions that it needs, in the environment of this Python.

``make test`` installs that environment at the versions of constraints.txt. Writes the table of docs/install.md.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from importlib.util import cache_from_source
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from committed import markdown, write_tables

ROOT = Path(__file__).resolve().parents[1]
#: Extras for people who work on the toolkit itself.
INTERNAL = ("dev", "docs", "fuzz")
#: Number of distributions that a row names.
LARGEST = 3


def main() -> None:
    """Write the table."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = {name: own for name, own in project["optional-dependencies"].items() if name not in INTERNAL}
    inside = re.findall(r"[\w-]+", extras["all"][0].partition("[")[2])
    extras["all"] = [text for name in inside for text in extras[name]]
    core = closure(project["dependencies"])
    rows = [row("(none)", {name: installed_size(distribution(name)) for name in core})]
    for name, own in extras.items():
        beyond = closure(own) - core
        rows.append(row(f"`{name}`", {package: installed_size(distribution(package)) for package in beyond}))
    head = ("extra", "packages", "size [MB]", "largest parts [MB]")
    write_tables(ROOT / "docs" / "install.md", markdown(head, rows, "lrrl"), "pipelines/install_sizes.py")


def row(title: str, sizes: Mapping[str, int]) -> tuple[str, ...]:
    """A line of the table; ``sizes`` holds bytes by distribution."""
    parts = sorted(sizes, key=lambda name: -sizes[name])[:LARGEST]
    shown = ", ".join(f"{name} {megabytes(sizes[name])}" for name in parts)
    return title, str(len(sizes)), megabytes(sum(sizes.values())), shown


def megabytes(size: int) -> str:
    return f"{size / 1e6:.0f}" if size >= 1e7 else f"{size / 1e6:.1f}"


def closure(requirements: Iterable[str]) -> set[str]:
    """Names of the distributions that requirements install, with everything that those need in turn.

    Raises:
        PackageNotFoundError: one of them is not installed.
    """
    waiting: list[tuple[Requirement, str]] = [(Requirement(text), "") for text in requirements]
    done: set[tuple[str, str]] = set()
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        for wanted in ("", *requirement.extras):
            if (name, wanted) not in done:
                done.add((name, wanted))
                waiting += [(Requirement(text), wanted) for text in needs(name)]
    return {name for name, _ in done}


def needs(name: str) -> Sequence[str]:
    """The requirements in the metadata of an installed distribution, those of its extras included."""
    try:
        return distribution(name).requires or []
    except PackageNotFoundError:
        raise PackageNotFoundError(f"{name}: not installed; expected everything of `make test`") from None


def installed_size(found: Distribution) -> int:
    """Bytes of the files of a distribution, bytecode included."""
    paths = {Path(str(found.locate_file(path))) for path in found.files or ()}
    # Bytecode is not in the list where it was compiled after the installation.
    paths |= {Path(cache_from_source(path)) for path in paths if path.suffix == ".py"}
    return sum(path.stat().st_size for path in paths if path.is_file())


if __name__ == "__main__":
    main()
