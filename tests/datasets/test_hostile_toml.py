"""TOML that asks for much, or is no file: refused before it is parsed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sysid.config import read_toml
from sysid.errors import SettingsError


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a." * 200_000 + "a = 1", r".*nested deeper than 64 levels"),
        ('"a" . ' * 65 + "a = 1", r".*nested deeper than 64 levels"),
        ("a = {" + "b." * 65 + "c = 1}", r".*nested deeper than 64 levels"),
        ("a = " + "[" * 50_000, r".*nested deeper than 64 levels"),
        ("# " + "x" * 2**23, r"more than 8388608 bytes"),
    ],
    ids=["dotted", "quoted", "inline", "deep", "large"],
)
def test_toml_that_asks_for_much_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=rf"recipe\.toml: {said}"):
        read_toml(path)


def test_keys_and_texts_with_dots_are_read(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text('a.b."c.d" = "' + "x. " * 100 + '"\nlist = [1.5, 2.5]\n# Sentences. With. Dots.\n')
    assert read_toml(path)["a"]["b"]["c.d"] == "x. " * 100


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    os.mkfifo(path)
    with pytest.raises(SettingsError, match=r"recipe\.toml: no regular file; expected a TOML file"):
        read_toml(path)
