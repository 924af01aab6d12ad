"""What a new user looks for is three links away from the README, on the path that ``docs/tasks.md`` states."""

from __future__ import annotations

import os
import re
from collections import deque
from pathlib import Path

import pytest
from test_glossary import anchors

from sysid import __version__

ROOT = Path(__file__).parents[2]
TASKS = ROOT / "docs" / "tasks.md"
#: Task → what the page that answers it has to say.
ANSWERS = {
    "Install": "pip install sysid-toolkit",
    "Get a first answer from my own CSV files": "sysid start",
    "What is a dead-band?": "dead-band",
    "Why is nothing named?": "`insufficient_excitation`",
    "What is the unit of a parameter?": "`time_constant` [s]",
    "Export to MuJoCo": "sysid export autolog --to mjcf",
    "Compare two versions": "sysid models diff",
    "Undo a promotion": "sysid models promote autolog@1",
    "When does a network pay?": "reports/network_pays/README.md",
    "Add an effect": "sysid/effects/catalogue.py",
    "Cite": "please cite",
}
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def links(page: Path) -> dict[Path, set[str]]:
    """The files that a page links, each with the anchors that it names."""
    found: dict[Path, set[str]] = {}
    text = CODE.sub("", page.read_text("utf-8")) if page.suffix == ".md" else ""
    for target in LINK.findall(text):
        name, _, anchor = target.partition("#")
        if ":" not in target and name:
            path = Path(os.path.normpath(page.parent / name))
            found.setdefault(path / "README.md" if path.is_dir() else path, set()).add(anchor)
    return found


def distances(start: Path) -> dict[Path, int]:
    """Page → the least number of links from ``start``; the table of tasks itself leads nowhere."""
    found, queue = {start: 0}, deque([start])
    while queue:
        page = queue.popleft()
        for target in links(page) if page != TASKS else ():
            if target.is_file() and target not in found:
                found[target] = found[page] + 1
                queue.append(target)
    return found


def rows() -> dict[str, list[str]]:
    """Task → the links of its path."""
    cells = re.findall(r"^\| (.+?) \| (\[.+\]\(.+\)) \|$", TASKS.read_text("utf-8"), re.MULTILINE)
    return {task: LINK.findall(path) for task, path in cells}


@pytest.mark.parametrize("task", ANSWERS)
def test_a_task_is_answered_where_its_path_leads(task: str) -> None:
    """Each link of the path is on the page before it; the heading exists, and the page answers."""
    page = ROOT / "README.md"
    for target in rows()[task]:
        name, _, anchor = target.partition("#")
        path = (TASKS.parent / name).resolve()
        assert path in links(page), f"{page.relative_to(ROOT)} does not link {name}"
        assert not anchor or anchor in anchors(path), target
        page = path
    text = page.read_text("utf-8")
    answer = text[_heading(text, anchor) :] if anchor else text
    assert ANSWERS[task] in answer
    assert distances(ROOT / "README.md")[page] == len(rows()[task]) <= 3


def _heading(text: str, anchor: str) -> int:
    """Where the heading with this anchor begins."""
    words = anchor.split("-")
    found = [
        match.start() for match in re.finditer(r"^#+ .*$", text, re.MULTILINE) if all(w in match[0].lower() for w in words)
    ]
    return found[0]


def test_the_table_has_every_task() -> None:
    assert rows().keys() == ANSWERS.keys()


def test_the_citation_is_of_this_version() -> None:
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text("utf-8")


def test_a_path_is_followed_link_by_link(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("[b](b.md#x) `[c](c.md)`")
    (tmp_path / "b.md").write_text("[c](c.md) [web](https://c)")
    (tmp_path / "c.md").write_text("")
    assert links(tmp_path / "a.md") == {tmp_path / "b.md": {"x"}}
    assert distances(tmp_path / "a.md") == {tmp_path / "a.md": 0, tmp_path / "b.md": 1, tmp_path / "c.md": 2}
