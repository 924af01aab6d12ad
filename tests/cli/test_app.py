"""The command line as a user meets it: help, mistakes, exit status."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from command_line import run

from sysid.cli.app import app
from sysid.cli.verbs import all_verbs

INSTALL = (Path(__file__).parents[2] / "docs/install.md").read_text("utf-8")


def test_help_lists_every_verb_in_order(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--help") == 0
    text = capsys.readouterr().out
    places = [text.index(f"\n  {name} ") for name in all_verbs()]
    assert places == sorted(places)
    work = ["start", "gap", "export", "train", "track", "run", "view", "demo"]
    assert [name for name in all_verbs() if name in work] == work


@pytest.mark.parametrize("name", all_verbs())
def test_every_verb_loads_and_documents_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    command = app.get_command(click.Context(app), name)
    assert command is not None
    assert command.name == name
    assert run(name, "--help") == 0
    text = capsys.readouterr().out
    assert "--json" in text
    assert command.help


@pytest.mark.parametrize(("shell", "words", "wanted"), [
    ("bash", "sysid in", "plain,ingest"), ("zsh", "sysid da", "datasets"), ("fish", "sysid gap --lo", "--localise"),
])  # fmt: skip
def test_a_shell_completes_verbs_and_options(shell: str, words: str, wanted: str) -> None:
    """What the scripts of ``docs/install.md`` call at each tab."""
    last = words.split()[-1]
    position = last if shell == "fish" else str(len(words.split()) - 1)
    settings = {"_SYSID_COMPLETE": f"{shell}_complete", "COMP_WORDS": words, "COMP_CWORD": position}
    done = subprocess.run(
        [sys.executable, "-c", "from sysid.cli import main; import sys; sys.argv[0] = 'sysid'; main()"],
        env=os.environ | settings, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert wanted in done.stdout, done.stderr
    assert (
        f'eval "$(_SYSID_COMPLETE={shell}_source sysid)' in INSTALL
        or f"_SYSID_COMPLETE={shell}_source sysid | source" in INSTALL
    )


def test_unknown_verb_suggests_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("ingets") == 2
    assert "did you mean 'ingest'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    "args",
    [
        ("report", "autolog@x"),
        ("gap", "nothing"),
        ("fit", "forward", "nothing"),
        ("validate", "nothing@1", "nothing"),
        ("view", "nothing"),
    ],
)
def test_a_missing_dataset_is_one_paragraph(args: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", tmp_path, *args) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("sysid: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err


def test_json_into_a_missing_folder_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", tmp_path, "datasets", "--json", tmp_path / "no" / "x.json") == 2
    assert "no folder" in capsys.readouterr().err


def test_lists_of_an_empty_workspace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--workspace", tmp_path, "datasets", "--json", tmp_path / "d.json") == 0
    assert run("--workspace", tmp_path, "models", "--json", tmp_path / "m.json") == 0
    assert json.loads((tmp_path / "d.json").read_text())["datasets"] == []
    assert json.loads((tmp_path / "m.json").read_text())["models"] == []
    assert "sysid ingest" in capsys.readouterr().out, "an empty list says what fills it"


def test_the_installed_program_reports_a_mistake_without_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from sysid.cli import main; main()",
            "--workspace",
            str(tmp_path),
            "ingest",
            str(tmp_path / "none"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("sysid: ")
    assert "Traceback" not in done.stderr
