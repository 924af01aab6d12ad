"""Recipes: strict keys, paths that stay inside, names that exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.datasets.recipe import check_against_machine, load_recipe
from sysid.errors import SettingsError
from sysid.machine import load_machine

MACHINE = """schema = 1
name = "m"
rate_hz = 100.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "cylinder"
stroke = [0.0, 0.1]
"""


def recipe(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "recipe.toml"
    path.write_text("schema = 1\n" + text)
    return path


def test_a_whole_recipe(tmp_path: Path) -> None:
    path = recipe(
        tmp_path,
        """name = "d"
[recordings]
poses = ["poses"]
[[streams]]
files = "*.csv"
time = "t"
[streams.signals]
"boom.command" = {field = "duty", zero = 7.5, span = 2.5, sign = -1}
[[streams]]
files = "mocap.csv"
reader = "motive"
domain = "mocap"
[streams.bodies]
b = "boom"
[streams.points]
ee = {body = "tip", at = [0.1, 0, 0]}
[streams.reference]
seconds = [0.2, 1.2]
joints = {boom = 0.5}
""",
    )
    loaded = load_recipe(path)
    assert loaded.streams[0].signals["boom.command"].sign == -1
    assert loaded.streams[1].points["ee"].at == (0.1, 0.0, 0.0)
    assert loaded.recordings.motion == ("*",)
    assert loaded.text == path.read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nme = 'x'", r"unknown key 'nme'; expected 'name'\?"),
        ("[[streams]]\nfiles = 'a'\nclok = 'log'", r"unknown key 'streams\[0\]\.clok'; expected 'clock'\?"),
        ("[[streams]]\nfiles = 'a'\n[streams.signals]\n'boom.joint' = {colum = 'x'}", "streams"),
        ("[[streams]]\nfiles = 'a'\nreader = 'mcp'", r"unknown reader 'mcp'; expected 'mcap'\?"),
        ("[[streams]]\nfiles = 'a'\nreader = 'mcap'\nclock = 'heder'", r"unknown clock 'heder'; expected 'header'\?"),
        (
            "[[streams]]\nfiles = 'a'\n[streams.signals]\n'boom.joint' = {field = 'x', span = 0.0}",
            r"span = 0\.0; expected a number other than zero",
        ),
        (
            "[[streams]]\nfiles = 'a'\nrate_hz = 0.0",
            r"rate_hz = 0\.0; expected a number greater than or equal to 0\.001",
        ),
        ("[[streams]]\nfiles = 'a'\nrate_hz = 5.0\ntime = 't'", "both `time` and `rate_hz`"),
        ("[[streams]]\nfiles = 'a'\n[streams.points]\nhand = {body = 'b'}", "unknown point 'hand'"),
        ("machine = '../machine.toml'", r"path '\.\./machine\.toml' leaves the folder"),
        ("machine = '/etc/passwd'", "path '/etc/passwd' leaves the folder"),
        ("[[streams]]\nfiles = '../*.csv'", r"path '\.\./\*\.csv' leaves the folder of the logs"),
        ("[recordings]\nfiles = {a = '/etc/passwd'}", "path '/etc/passwd' leaves the folder of the logs"),
        ("[splits]\nheld_out_last = {a = 1.5}", r"held_out_last\.a: 1\.5; expected a share between 0 and 1"),
        ("text = 'x'", "unknown key 'text'"),
        ("name = 3", "name"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        load_recipe(recipe(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[[streams]]\nfiles = 'a'\n[streams.signals]\n'boom.cylindr' = {field = 'x'}",
            r"unknown signal 'boom\.cylindr'; expected 'boom\.cylinder'\?",
        ),
        (
            "[[streams]]\nfiles = 'a'\n[streams.signals]\n'bom.joint' = {field = 'x'}",
            r"unknown signal 'bom\.joint'; expected 'boom\.joint'\?",
        ),
        ("[[streams]]\nfiles = 'a'\n[streams.bodies]\nb = 'boom'", "rigid bodies on links; expected a machine with a urdf"),
        (
            "[[streams]]\nfiles = 'a'\n[streams.reference]\nseconds = [0, 1]\njoints = {bom = 1.0}",
            r"unknown axis 'bom'; expected 'boom'\?",
        ),
    ],
)
def test_names_have_to_fit_the_machine(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    machine = load_machine(tmp_path / "machine.toml")
    path = recipe(tmp_path, text)
    with pytest.raises(SettingsError, match=message):
        check_against_machine(load_recipe(path), machine, path)
