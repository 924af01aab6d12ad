"""Names made from any text, commands that a shell takes as they are printed, and options in the help of groups."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st

from sysid.cli.output import command, rerun_command
from sysid.names import is_dataset_name, is_name, model_name, slug


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Kran Größe 1", "kran-groesse-1"),
        ("Kran Gro\u0308ße 1", "kran-groesse-1"),  # as macOS writes file names
        ("ÜBUNG", "uebung"),
        ("Pelle à câble", "pelle-a-cable"),
        ("Gravemaskin Ærø/Åse", "gravemaskin-aeroe-aase"),
        ("żuraw łódź", "zuraw-lodz"),
        ("my_crane-2", "my_crane-2"),
        ("ﬁne № 4", "fine-no-4"),
        ("機械", "machine"),
        ("", "machine"),
    ],
)
def test_slugs(text: str, name: str) -> None:
    assert slug(text, "machine") == name


@given(st.text(max_size=300))
def test_every_slug_is_a_name_and_stays_itself(text: str) -> None:
    name = slug(text, "machine")
    assert is_dataset_name(name)
    assert is_name(name[:100].rstrip("-_"))
    assert slug(name, "machine") == name


@given(st.text(max_size=300), st.sampled_from(["", "-forward", "-gripper_actuator"]))
def test_every_machine_and_dataset_has_a_model_name(text: str, ending: str) -> None:
    name = model_name(text, ending)
    assert is_name(name)
    assert name.endswith(ending)
    assert (name == text + ending) == is_name(text + ending)


def test_names_without_latin_letters_stay_apart() -> None:
    assert model_name("Kran Größe 1") == "kran-groesse-1"
    assert model_name("機械", "-forward") == "model-81c946ea-forward" != model_name("械機", "-forward")


@given(st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=20), max_size=4))
def test_a_shell_reads_a_printed_command_as_it_was_meant(words: list[str]) -> None:
    assert shlex.split(command(*words, workspace="my work")) == ["sysid", "--workspace", "my work", *words]
    assert shlex.split(rerun_command(Path("a b.rrd")))[-1] == "a b.rrd"


def test_init_transliterates_and_prints_a_command_that_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "Kran Größe 1"
    assert run("init", folder) == 0
    printed = capsys.readouterr().out.splitlines()[-1].strip()
    assert shlex.split(printed) == ["sysid", "ingest", str(folder / "datasets" / "kran-groesse-1")]


def test_init_goes_on_with_the_name_of_an_earlier_version(tmp_path: Path) -> None:
    old = tmp_path / "Kran Größe 1" / "datasets" / "kran-gr-e-1"
    old.mkdir(parents=True)
    (old / "machine.toml").write_text("# mine\n", "utf-8")
    assert run("init", tmp_path / "Kran Größe 1") == 0
    assert {path.name for path in old.parent.iterdir()} == {"kran-gr-e-1", "README.md"}
    assert (old / "machine.toml").read_text() == "# mine\n"


@pytest.mark.parametrize(("group", "options"), [("datasets", ["--quality", "--json"]), ("models", ["--kind", "--json"])])
def test_help_of_a_group_lists_the_options_of_its_default(
    group: str, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(group, "--help") == 0
    text = capsys.readouterr().out
    for option in options:
        assert any(line.startswith(f"  {option}") for line in text.splitlines()), option
