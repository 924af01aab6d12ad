"""A page of documentation is followed word by word: commands are run, files are written as it shows them, output is compared.

    python tests/helpers/page_walk.py docs/guide/servo.md ../shared/data/sage_so101    (writes the page's output blocks anew)

The fenced blocks of a page, in order; what follows the language on the fence is not rendered:

    ```sh                       commands, run by bash in one folder; ``sh slow`` takes minutes
    ```toml file=PATH           content of a file, in any language; ``after=TEXT`` keeps the file up to the first TEXT
    ```console                  lines of the output of the commands above; a line ``…`` stands for lines that are left out

Other languages are not part of the walk.
"""

from __future__ import annotations

import argparse
import difflib
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_FENCE = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"[-−+]?\d+(?:\.\d+)?")
#: Shown numbers may depart by this share, or by one unit of their last digit: other processors round differently.
_TOLERANCE = 0.05
LEFT_OUT = "…"


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, the options on its fence, its text, and the text's place in the page."""

    kind: str
    options: dict[str, str]
    text: str
    span: tuple[int, int]

    @property
    def is_slow(self) -> bool:
        return "slow" in self.options


@dataclass(frozen=True)
class Step:
    """One block after it was followed; ``output`` of the commands (stdout and stderr), ``seconds`` that they took."""

    block: Block
    output: str
    seconds: float


def blocks(text: str) -> tuple[Block, ...]:
    """The blocks of a page that a walk follows."""
    found = []
    for match in _FENCE.finditer(text):
        options = dict(part.partition("=")[::2] for part in shlex.split(match[2]))
        if match[1] in ("sh", "console") or "file" in options:
            found.append(Block(match[1], options, match[3], match.span(3)))
    return tuple(found)


def walk(page: Path, folder: Path, logs: Path | None = None, slow: bool = True) -> Iterator[Step]:
    """Follow ``page`` in ``folder``, block by block.

    Args:
        logs: folder that ``$LOGS`` of the page names.
        slow: also run the commands marked so, and give the output blocks that belong to them.

    Raises:
        AssertionError: a command failed, an output block follows no command.
    """
    output = None
    for block in blocks(page.read_text("utf-8")):
        if block.is_slow and not slow:
            output = None
        elif block.kind == "sh":
            begin = time.perf_counter()
            output = run(block.text, folder, logs)
            yield Step(block, output, time.perf_counter() - begin)
        elif "file" in block.options:
            write(block, folder)
            yield Step(block, "", 0.0)
        elif output is not None:
            yield Step(block, output, 0.0)


def run(text: str, folder: Path, logs: Path | None) -> str:
    """What the commands print, with stderr; each one has to succeed."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("SYSID_")}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    paths = (str(ROOT / "pipelines"), environment.get("PYTHONPATH"))  # pipelines: for simulated_bench, as the pages say
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    if logs is not None:
        environment["LOGS"] = str(logs)
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", text],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{text}\n{done.stdout}"
    return done.stdout


def write(block: Block, folder: Path) -> None:
    """Write the file that a block shows, or its end."""
    path = folder / block.options["file"]
    assert path.resolve().is_relative_to(folder.resolve()), path
    head = ""
    if "after" in block.options:
        before, mark, _ = path.read_text("utf-8").partition(block.options["after"])
        assert mark, f"{path} has no {block.options['after']!r}"
        head = f"{before}{mark}\n"
    path.write_text(head + block.text, "utf-8")


def departures(shown: str, output: str) -> list[str]:
    """Lines of an output block that the output does not have in this order, up to small differences of numbers."""
    actual = [_plain(line) for line in output.splitlines()]
    missing, at = [], 0
    for line in _lines(shown):
        here = next((i for i in range(at, len(actual)) if _agree(_plain(line), actual[i])), None)
        if here is None:
            missing.append(f"{line!r}; the most similar line: {_nearest(line, output.splitlines())!r}")
        else:
            at = here + 1
    return missing


def renewed(shown: str, output: str) -> str:
    """The output block with each line replaced by the most similar line of the output."""
    lines = [line if line.strip() == LEFT_OUT else _nearest(line, output.splitlines()) for line in shown.splitlines()]
    return "\n".join(line.rstrip().replace("\u202f", " ") for line in lines) + "\n"


def _lines(shown: str) -> list[str]:
    return [line for line in shown.splitlines() if line.strip() and line.strip() != LEFT_OUT and "───" not in line]


def _plain(line: str) -> str:
    return " ".join(line.split())


def _agree(shown: str, actual: str) -> bool:
    if _NUMBER.sub("#", shown) != _NUMBER.sub("#", actual):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(actual), strict=True)
    return all(math.isclose(_value(a), _value(b), rel_tol=_TOLERANCE, abs_tol=1.01 * _last_digit(a)) for a, b in pairs)


def _value(number: str) -> float:
    return float(number.replace("−", "-"))


def _last_digit(number: str) -> float:
    return 10.0 ** -len(number.partition(".")[2])


def _nearest(line: str, among: Sequence[str]) -> str:
    """The line of ``among`` that is most similar in words, then in numbers; ``line`` where there is none."""

    def similar(other: str) -> tuple[float, float]:
        ratio = difflib.SequenceMatcher(None, _NUMBER.sub("#", _plain(line)), _NUMBER.sub("#", _plain(other))).ratio()
        return ratio, difflib.SequenceMatcher(None, _plain(line), _plain(other)).ratio()

    return max((other for other in among if other.strip()), key=similar, default=line)


def main() -> None:
    """Follow a page and write its output blocks anew; prints the duration of each block."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("logs", type=Path, help="what $LOGS of the page names")
    given = parser.parse_args()
    text = given.page.read_text("utf-8")
    fresh = []
    with tempfile.TemporaryDirectory() as folder:
        prepare(given.page, Path(folder))
        for step in walk(given.page, Path(folder), given.logs.resolve()):
            if step.block.kind == "console":
                fresh.append((step.block.span, renewed(step.block.text, step.output)))
            elif step.block.kind == "sh":
                sys.stdout.write(f"{step.seconds:6.1f} s  {step.block.text.splitlines()[0]}\n")
    for (begin, end), new in reversed(fresh):
        text = text[:begin] + new + text[end:]
    given.page.write_text(text, "utf-8")


def prepare(page: Path, folder: Path) -> None:
    """What a page starts from: of ``datasets/<name>/`` a copy of that folder and of the pipelines, as in a checkout; of a guide
    the folders of ``datasets/`` from which its commands copy."""
    import shutil

    page = page.resolve()
    for name in re.findall(r"^cp (?:-r )?datasets/(\w+)/", page.read_text("utf-8"), re.MULTILINE):
        shutil.copytree(ROOT / "datasets" / name, folder / "datasets" / name, dirs_exist_ok=True)
    if page.parents[1] == ROOT / "datasets":
        shutil.copytree(page.parent, folder / "datasets" / page.parent.name)
        shutil.copytree(ROOT / "pipelines", folder / "pipelines", ignore=shutil.ignore_patterns("__pycache__"))


if __name__ == "__main__":
    main()
