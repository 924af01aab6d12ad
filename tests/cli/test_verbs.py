"""Verbs and viewers that installed packages add by entry points."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_line import run

from sysid.cli.verbs import GROUP, VERBS, VIEWERS, all_verbs, names

Installed = Callable[..., None]
VERB = """
from sysid.cli.verbs import Verb
WELD = Verb("weld_command:weld", "Weld what was planned.", after={after!r})
"""
COMMAND = """
import click
@click.command()
def weld():
    '''Weld.'''
    print("welded")
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Installed]:
    """A package with entry points (group → lines) and modules, as an installer leaves it."""

    def make(entries: dict[str, str], **modules: str) -> None:
        folder = tmp_path / "site"
        info = folder / "weld_tools-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: weld-tools\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text("".join(f"[{group}]\n{lines}\n" for group, lines in entries.items()))
        for name, text in modules.items():
            (folder / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(folder)

    yield make
    for name in [name for name in sys.modules if name.startswith("weld_")]:
        del sys.modules[name]


def test_a_verb_of_another_package_is_listed_in_its_place_and_runs(
    installed: Installed, capsys: pytest.CaptureFixture[str]
) -> None:
    installed({GROUP: "weld = weld_verbs:WELD"}, weld_verbs=VERB.format(after="gap"), weld_command=COMMAND)
    order = list(all_verbs())
    assert order[order.index("gap") + 1] == "weld"
    assert run("--help") == 0
    assert "Weld what was planned." in capsys.readouterr().out
    assert "weld_command" not in sys.modules, "its command is imported when it is called"
    assert run("weld") == 0
    assert capsys.readouterr().out == "welded\n"


@pytest.mark.parametrize("after", ["", "nothing"])
def test_without_a_place_it_is_the_last(installed: Installed, after: str) -> None:
    installed({GROUP: "weld = weld_verbs:WELD"}, weld_verbs=VERB.format(after=after))
    assert list(all_verbs())[-1] == "weld"


def test_a_verb_of_sysid_is_not_replaced(installed: Installed) -> None:
    installed({GROUP: "gap = weld_verbs:WELD"}, weld_verbs=VERB.format(after=""))
    assert all_verbs()["gap"] is VERBS["gap"]
    assert names().count("gap") == 1


@pytest.mark.parametrize(
    ("modules", "why"),
    [
        ({}, "No module named 'weld_verbs'"),
        ({"weld_verbs": "raise RuntimeError('two\\nlines')"}, "does not load (RuntimeError: two lines)"),
        ({"weld_verbs": ""}, "AttributeError"),
        ({"weld_verbs": "WELD = 3"}, "is of type int, not a sysid.cli.verbs.Verb"),
        ({"weld_verbs": VERB.format(after="")}, "No module named 'weld_command'"),
        ({"weld_verbs": VERB.format(after=""), "weld_command": ""}, "has no attribute 'weld'"),
        ({"weld_verbs": VERB.format(after=""), "weld_command": "weld = 3"}, "is no command of click"),
    ],
)
def test_one_that_does_not_load_is_named_and_the_others_work(
    modules: dict[str, str], why: str, installed: Installed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    installed({GROUP: "weld = weld_verbs:WELD"}, **modules)
    assert run("weld") == 2
    error = capsys.readouterr().err
    assert error.startswith("sysid: verb 'weld' of the package weld-tools: weld_verbs:WELD ")
    assert why in error
    assert error.count("\n") == 1
    assert run("--help") == 0
    assert "weld" in capsys.readouterr().out
    assert run("--workspace", tmp_path, "datasets") == 0
    assert run("train", "--help") == 0


def test_completion_leaves_out_what_does_not_load(tmp_path: Path, installed: Installed) -> None:
    installed({GROUP: "welder = weld_verbs:WELD"})
    settings = {"_SYSID_COMPLETE": "bash_complete", "COMP_WORDS": "sysid ", "COMP_CWORD": "1"}
    done = subprocess.run(
        [sys.executable, "-c", "from sysid.cli import main; import sys; sys.argv[0] = 'sysid'; main()"],
        env=os.environ | settings | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert "plain,ingest" in done.stdout, done.stderr
    assert "plain,train" in done.stdout
    assert "welder" not in done.stdout


def test_a_missing_package_of_an_extra_is_answered_by_the_extra(
    installed: Installed, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    installed({GROUP: "weld = weld_verbs:WELD"}, weld_verbs=VERB.format(after=""), weld_command="import torch\n" + COMMAND)
    assert run("weld") == 2
    assert "pip install 'sysid-toolkit[networks]'" in capsys.readouterr().err
    (Path(sys.path[0]) / "weld_verbs.py").write_text("import torch\n")
    del sys.modules["weld_verbs"]
    assert run("--help") == 0
    assert "torch" in capsys.readouterr().out


SHOW = """
def show(file, out, json_file):
    print(file.name, out and out.name, json_file)
"""


def test_a_viewer_of_another_package_shows_its_files(installed: Installed, capsys: pytest.CaptureFixture[str]) -> None:
    installed({VIEWERS: "seam = weld_view:show"}, weld_view=SHOW)
    assert run("view", "a.seam") == 0
    assert run("view", "a.seam", "--out", "b.rrd", "--json", "c.json") == 0
    assert capsys.readouterr().out == "a.seam None None\na.seam b.rrd c.json\n"


def test_one_that_does_not_load_is_named(installed: Installed, capsys: pytest.CaptureFixture[str]) -> None:
    installed({VIEWERS: "seam = weld_view:show"})
    assert run("view", "a.seam") == 2
    assert capsys.readouterr().err.startswith("sysid: viewer 'seam' of the package weld-tools: weld_view:show does not load ")


def test_the_verbs_that_move_a_machine_are_entry_points() -> None:
    added = {"train", "track", "run"}
    assert added <= set(names()), "pyproject.toml has changed since the installation: run make kernels"
    assert not added & set(VERBS)
