"""Every ``sysid`` command in a fenced block of the documentation is one that the command line accepts.

The pages that ``tests/cli/test_pages.py`` follows run theirs; here verbs, options and numbers of arguments are checked on all.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from sysid.cli.app import app

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "datasets").rglob("*.md"), *(ROOT / "reports").rglob("*.md")]
)
_FENCE = re.compile(r"^```(?:sh|console)?[^\S\n]*(?:slow)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def commands() -> list[tuple[str, str]]:
    """Page and command."""
    found = []
    for page in PAGES:
        for block in _FENCE.findall(page.read_text("utf-8")):
            lines = [line.removeprefix("$ ").removeprefix(".venv/bin/") for line in block.splitlines()]
            found += [(str(page.relative_to(ROOT)), line) for line in lines if line.startswith("sysid ")]
    return found


@pytest.fixture
def parsed_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Verbs are parsed and not called; a path need not exist."""
    monkeypatch.setattr(click.Command, "invoke", lambda self, ctx: None)
    monkeypatch.setattr(click.Path, "convert", lambda self, value, param, ctx: value)


@pytest.mark.parametrize(("page", "command"), commands())
@pytest.mark.usefixtures("parsed_only")
def test_a_command_of_the_documentation_is_accepted(page: str, command: str) -> None:
    arguments = shlex.split(command, comments=True)[1:]
    app.main(arguments, prog_name="sysid", standalone_mode=False)


def test_most_pages_have_commands() -> None:
    assert len(commands()) > 60


@pytest.mark.parametrize("command", ["gap", "gap arm --localize", "datasets vacuum --keep all", "models promote", "plot arm"])
@pytest.mark.usefixtures("parsed_only")
def test_another_command_is_not(command: str) -> None:
    with pytest.raises(click.UsageError):
        app.main(command.split(), prog_name="sysid", standalone_mode=False)
