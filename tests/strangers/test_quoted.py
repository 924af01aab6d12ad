"""Text of strangers in text that is generated: the parser of each format reads it back as it was."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from xml.sax.saxutils import quoteattr

import markdown_it
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st
from one_axis_logs import MACHINE, record

from sysid.datasets.robot_files import Choices, drafted_files
from sysid.errors import SysidError
from sysid.figures import Table
from sysid.files import json_text
from sysid.foreign import is_unicode, visible
from sysid.gap.adapters.mujoco.repair import read_side_file, write_side_file
from sysid.machine import KnownEffect
from sysid.machine.sources import mjcf_model
from sysid.plant import effects_toml
from sysid.quoting import code, comment, markdown, toml_key, toml_value
from sysid.reports.card import Card, CardBlock

#: Ends of strings and comments, escapes and templates of many languages, marks that hide text, words that are reserved.
HOSTILE = (
    "", " ", '"', "'", '"""', "'''", "\\", '\\"', "\\N{BULLET}", "\\u0041", "a\nrate_hz = 1", "a\r\nb", "\t", "\0",
    "\x07", "\x1b[31m", "\x7f", "\x85", "\u2028", "\u202eab", "\ufeff", "*/", "<!--", "-->", "]]>",
    "</script><script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "&lt;", "${x}", "$(id)", "`id`", "%s%n",
    "{0}", "{{x}}", "{% x %}", "#", "# a", "= 1", "[x]", "](x)", "a|b", "*a*", "__a__", "~~a~~", "class", "end",
    "function", "nan", "true", "None", "a" * 300, "🙂", "e\u0301", "\u00e9", "Ａ", "..", "/", "a/b",
)  # fmt: skip
#: Undecodable bytes of file names too.
TEXT = st.one_of(st.sampled_from(HOSTILE), st.text(st.characters(codec=None), max_size=60))


@given(TEXT)
def test_toml(text: str) -> None:
    found = tomllib.loads(f"{toml_key(text)} = {toml_value([text, 1.5, True])} # {comment(text)}\nnext = 1\n")
    expected = text if is_unicode(text) else "".join(letter if is_unicode(letter) else "\ufffd" for letter in text)
    assert found == {expected: [expected, 1.5, True]} | ({"next": 1} if expected != "next" else {})


@pytest.mark.parametrize("value", [float("nan"), [1.0, float("inf")]])
def test_toml_has_no_value_that_is_none(value: object) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        toml_value(value)


@given(TEXT)
def test_json(text: str) -> None:
    stored = json_text({"key": text}).encode()
    assert json.loads(stored) == {"key": text}


@given(TEXT)
def test_markdown(text: str) -> None:
    """A cell, a code span and a heading hold the text and nothing else: no element, no HTML, no further cell."""
    reader = markdown_it.MarkdownIt("gfm-like", {"linkify": False})
    cells = f"| a | b |\n| --- | --- |\n| {markdown(text)} | {code(text.replace('|', '/'))} |\n\n# x {markdown(text)} y\n"
    tokens = reader.parse(cells)
    inside = [child for token in tokens for child in token.children or ()]
    assert {child.type for child in inside} <= {"text", "code_inline", "text_special"}
    assert [token.type for token in tokens].count("td_open") == 2
    heading = "".join(child.content for child in tokens[-2].children or ())
    assert heading.split() == f"x {visible(text)} y".split()


@given(TEXT)
def test_card(text: str) -> None:
    """Cells of cards hold paths of raw files, and reasons of other people."""
    words = Card("a@1", "plant", (CardBlock("Lineage", (), Table(("a", "b"), [(text, "end")])),)).markdown()
    rows = [token for token in markdown_it.MarkdownIt("gfm-like", {"linkify": False}).parse(words) if token.type == "td_open"]
    assert len(rows) == 2


@pytest.mark.parametrize("text", HOSTILE)
def test_effects(text: str, tmp_path: Path) -> None:
    effect = KnownEffect("backlash", text, {"width": 0.1}, None)
    assert tomllib.loads(effects_toml([effect]))["effects"][0]["target"] == text
    if "/" in text or "\0" in text or len(text) > 200 or text in ("", ".", ".."):
        return
    write_side_file(tmp_path / f"{text}.xml", [effect])
    assert [found.target for found in read_side_file(tmp_path / f"{text}.xml")] == [text]


@pytest.mark.parametrize("place", ["actuator", "joint", "body", "site", "model", "file"])
@pytest.mark.parametrize("text", [text for text in HOSTILE if "\0" not in text and "\x1b" not in text and "\x07" not in text])
def test_a_drafted_machine(text: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of an MJCF and of its file: the drafted files are read, or a name is refused; the text has no line of its own."""
    if place == "file" and ("/" in text or len(text) > 200):
        return
    monkeypatch.setattr(mjcf_model, "inside", lambda: True)  # not in a process of its own, which takes longer
    parts = ("actuator", "joint", "body", "site", "model")
    names = {part: quoteattr(text if part == place else part, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}) for part in parts}
    path = tmp_path / (f"{text}.xml" if place == "file" else "a.xml")
    path.write_text(
        "<mujoco model={model}><worldbody><body name={body}><joint name={joint} range='-1 1' limited='true' armature='1'/>"
        "<geom size='1'/><site name={site}/></body></worldbody><actuator><position name={actuator} joint={joint} kp='9'/>"
        "</actuator></mujoco>".format(**names),
        "utf-8",
    )
    try:
        files = drafted_files(path, "n", Choices()).files
    except SysidError as error:
        refusal = str(error)
    else:
        refusal = ""
    assert "TOML" not in refusal
    if refusal:
        return
    values = tomllib.loads(files["machine.toml"])
    assert set(values) <= {"schema", "name", "rate_hz", "urdf", "tip", "gravity", "left_out", "axes", "effects"}
    assert values["rate_hz"] == 50.0
    tomllib.loads(files["recipe.toml"])


@pytest.mark.parametrize("text", ['"', "a\nb = 1", "\x7f", "\\", "*[a]?", "\u202e🙂", "]#{%s}$x"])
def test_a_drafted_recipe(text: str, tmp_path: Path) -> None:
    """Names of files, folders and columns; the recipe reads what it was drafted from, as far as names are taken."""
    (tmp_path / "machine.toml").write_text(MACHINE)
    for recording in ("r0", f"r{text}"):
        record(tmp_path / "logs" / recording, 1)
        table = (tmp_path / "logs" / recording / "log.csv").read_text().split("\n", 1)
        quoted = '"' + f"a.cylinder {text}".replace('"', '""') + '"'
        (tmp_path / "logs" / recording / f"{text}.csv").write_text(f"time,a.command,{quoted}\n{table[1]}", "utf-8")
    recipe = tmp_path / "r.toml"
    machine = ("--machine", tmp_path / "machine.toml")
    assert run("ingest", tmp_path / "logs", "--inspect", *machine, "--draft", recipe, "--json", tmp_path / "i.json") in (0, 2)
    json.loads((tmp_path / "i.json").read_text("utf-8"))
    assert set(tomllib.loads(recipe.read_text("utf-8"))) <= {"schema", "machine", "logs", "streams", "recordings"}


def test_names_that_are_no_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A byte that is no UTF-8 in the name of a file: shown, refused with its remedy, and no traceback."""
    name = os.fsdecode(b"x\xff")
    (tmp_path / "machine.toml").write_text(MACHINE)
    record(tmp_path / "logs/r0", 1)
    (tmp_path / "logs/r0/log.csv").rename(tmp_path / "logs/r0" / f"{name}.csv")
    (tmp_path / f"{name}.xml").write_text("<mujoco/>")
    machine = ("--machine", tmp_path / "machine.toml")
    assert run("ingest", tmp_path / "logs", "--inspect", *machine, "--json", tmp_path / "i.json") == 0
    assert json.loads((tmp_path / "i.json").read_text())["files"][0]["path"].endswith(f"{name}.csv")
    assert run("--workspace", tmp_path / "ws", "ingest", tmp_path / "logs", *machine) == 2
    assert run("init", tmp_path / "out", "--name", "n", "--from", tmp_path / f"{name}.xml") == 2
    errors = capsys.readouterr().err
    assert errors.count("bytes that are no UTF-8") == 2
    assert errors.count("Rename it.") == 2
