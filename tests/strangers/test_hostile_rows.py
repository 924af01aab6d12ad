"""A workspace made to do harm: its rows are listed as broken, nothing reaches the terminal, nothing ends in a traceback."""

from __future__ import annotations

import json
import shutil
import sqlite3
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from stored import small_dataset

from sysid.cli import main
from sysid.cli.ui import page_server
from sysid.datasets import Store, lineage
from sysid.datasets.versions.manifest import PartRecord, to_text
from sysid.errors import StoreError
from sysid.foreign import escaped_json, shown, visible
from sysid.registry import Registry
from sysid.root import Root

ESCAPE = "\x1b]52;c;aGFyaQ==\x07\x1b[31m\x9b2J\u202eevil"
#: What a terminal would obey or a reader would be deceived by.
OBEYED = ("\x1b", "\x07", "\x9b", "\u202e", "\x7f")


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    code = stop.value.code
    assert isinstance(code, int)
    return code


def said(capsys: pytest.CaptureFixture[str]) -> str:
    """What was printed; whoever asks for it asks that it be harmless."""
    captured = capsys.readouterr()
    text = captured.out + captured.err
    assert not any(character in text for character in OBEYED), ascii(text)
    assert "Traceback" not in text
    return text


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """``demo@1``, which is whole, and a copy of its manifest as ``demo@2`` for each test to spoil."""
    Store(tmp_path / "ws").save(*small_dataset(1), PartRecord(1))
    return tmp_path / "ws"


def spoiled(place: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """``demo@2``: the manifest of ``demo@1`` with a change and a seal that fits."""
    versions = place / "datasets/demo/versions"
    manifest = json.loads((versions / "000001.json").read_text())
    del manifest["seal"]
    manifest["version"] = 2
    change(manifest)
    (versions / "000002.json").write_text(to_text(manifest))


def rename(path: str, to: object) -> Callable[[dict[str, Any]], object]:
    """Set a value by its dotted path."""

    def change(manifest: dict[str, Any]) -> None:
        *keys, last = path.split(".")
        value: Any = manifest
        for key in keys:
            value = value[int(key)] if isinstance(value, list) else value[key]
        value[int(last) if isinstance(value, list) else last] = to

    return change


#: What is set in a manifest → what the list says of it.
HOSTILE: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "recording leads outside": (rename("recordings.0.name", "../../../x"), "expected the name of one file"),
    "recording with escapes": (rename("recordings.0.name", ESCAPE), "expected the name of one file"),
    "dataset leads outside": (rename("name", "../../x"), "expected letters, digits"),
    "another dataset": (rename("name", "other"), "which is not of this dataset"),
    "folder outside": (rename("parts.0.folder", "datasets/demo/data/.."), "which is not of this dataset"),
    "file outside": (rename("parts.0.samples.files.0.path", "../../../../../etc/passwd"), "expected the name of one file"),
    "based on itself": (rename("base", {"version": 2, "digest": "0", "by": "split"}), "which is no earlier one"),
    "based on a later one": (rename("base", {"version": 7, "digest": "0", "by": "split"}), "which is no earlier one"),
    "no list": (rename("recordings", None), "recordings: input should be a valid list"),
    "rate of zero": (rename("recordings.0.rate_hz", 0.0), "greater than 0"),
    "text for a number": (rename("recordings.0.rows", "many"), "valid integer"),
    "part that is not there": (rename("recordings.0.part", 9), "lies in part 9 of 1"),
    "clock of nothing": (rename("clocks", [{"offset": 1}]), "damaged"),
    "two of one name": (lambda m: m["recordings"].append(m["recordings"][0]), "two recordings are named"),
    "machine file outside": (rename("machine", {"../machine.toml": ""}), "no path inside its folder"),
    "unknown role": (rename("splits.s1-r0", "both"), "input should be"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_manifest_is_one_broken_row(place: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    change, reason = HOSTILE[name]
    spoiled(place, change)
    assert run("--workspace", place, "datasets") == 0
    text = " ".join(said(capsys).split())
    assert "demo@1 demo" in text, "the others are listed"
    assert "demo@2 cannot be read:" in text
    assert reason in text
    for verb in (("report", "demo@2"), ("datasets", "demo@2"), ("datasets", "lineage", "demo@2"), ("view", "demo@2")):
        assert run("--workspace", place, *verb) == 2
        assert "000002.json" in said(capsys)
    assert {path.name for path in place.parent.iterdir()} == {"ws"}, "nothing was written outside"


@pytest.mark.parametrize(
    "content",
    [
        "[" * 100_000,
        '{"schema": ' + "1" * 400 + "}",
        '{"schema": 2, "name": "\\ud800"}',
        "null",
        "[]",
        '{"schema": true}',
        "\x00",
    ],
    ids=["deep", "400 digits", "half a pair", "null", "list", "a truth", "zero byte"],
)
def test_json_that_is_no_manifest_is_one_broken_row(place: Path, content: str, capsys: pytest.CaptureFixture[str]) -> None:
    (place / "datasets/demo/versions/000002.json").write_text(content)
    assert run("--workspace", place, "datasets") == 0
    assert "demo@2 cannot be read:" in said(capsys)
    assert run("--workspace", place, "datasets", "demo@2") == 2
    said(capsys)


def test_a_folder_with_a_name_of_escapes_is_one_broken_row(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(place / "datasets/demo", place / "datasets" / ESCAPE)
    assert run("--workspace", place, "datasets") == 0
    text = said(capsys)
    assert "\\x1b[31m" in text
    assert "demo@1" in text
    assert run("--workspace", place, "datasets", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["datasets"][0]["damage"]


def test_a_lineage_ends(place: Path) -> None:
    spoiled(place, rename("base", {"version": 2, "digest": "0", "by": "split"}))
    with pytest.raises(StoreError, match="is based on version 2, which is no earlier one"):
        lineage(Store(place), "demo@2")
    spoiled(place, rename("base", {"version": 1, "digest": "0", "by": "split"}))
    assert [step.reference for step in lineage(Store(place), "demo@2").steps] == ["demo@1"]


def test_a_version_number_is_a_number(place: Path) -> None:
    (place / "datasets/demo/versions/²².json").write_text("{}")
    (place / ("datasets/demo/versions/" + "9" * 200 + ".json")).write_text("{}")
    assert Store(place).versions("demo") == [1]
    for number in ("²", "9" * 5000, "-1", "1.0"):
        with pytest.raises(StoreError, match="no version"):
            Store(place).load(f"demo@{number}")


@pytest.fixture(scope="module")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("registry")
    for name in ("arm", "boom"):
        Registry(place).register(name, "plant", {"plant.json": b"{}"}, {"dataset": "demo@1", "dataset_digest": "ab"})
    return place


TAG = "INSERT OR REPLACE INTO model_version_tags (key, value, name, version, workspace) VALUES"
#: SQL that spoils a row → what the list says.
ROWS = {
    "manifest changed": ("UPDATE model_version_tags SET value = '{}' WHERE name = 'boom' AND key = 'sysid.manifest'", "sha256"),
    "metrics are text": (
        f"{TAG} ('sysid.metrics', '{{\"rmse\": \"low\"}}', 'boom', 1, 'default')",
        "not figures",
    ),
    "metrics are deep": (
        f"{TAG} ('sysid.metrics', '" + "[" * 4000 + "', 'boom', 1, 'default')",
        "not figures",
    ),
    "decision is no decision": (
        f"{TAG} ('sysid.decision.1', '{{\"checks\": [], \"promoted\": \"x\"}}', 'boom', 1, 'default')",
        "not a decision",
    ),
    "text that is not UTF-8": (f"{TAG} ('sysid.metrics', CAST(x'7bff' AS TEXT), 'boom', 1, 'default')", "not figures"),
    "a deep seal": (
        "UPDATE registered_model_tags SET value = '" + "[" * 4000 + "' WHERE name = 'boom'",
        "the seal of its aliases is missing or damaged",
    ),
    "an alias of no number": (
        "UPDATE registered_model_aliases SET version = 'x' WHERE name = 'boom'",
        "its aliases were changed",
    ),
    "made on no date": (
        "UPDATE model_versions SET creation_time = 1 << 60 WHERE name = 'boom'",
        "a number from 1 on and a date",
    ),
    "a quote in the name": (
        "INSERT INTO registered_models (name, creation_time, last_updated_time, workspace) VALUES ('o''boom', 1, 1, 'default')",
        "expected letters, digits",
    ),
    "escapes in the name": (
        "INSERT INTO registered_models (name, creation_time, last_updated_time, workspace)"
        " VALUES (char(27) || '[31mx', 1, 1, 'default')",
        "expected letters, digits",
    ),
}


@pytest.mark.parametrize("name", ROWS)
def test_a_hostile_row_of_the_registry_is_one_broken_row(
    registry: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "ws"
    shutil.copytree(registry, place)
    statement, reason = ROWS[name]
    with sqlite3.connect(place / "registry.db") as connection:
        connection.execute(statement)
    connection.close()
    assert run("--workspace", place, "models") == 0
    text = " ".join(said(capsys).split())
    assert "arm@1 plant demo@1" in text
    assert "damaged: " in text
    assert reason in text
    assert run("--workspace", place, "models", "--json", "-") == 0
    damaged = json.loads(capsys.readouterr().out)["damaged"]
    assert any(reason in row["damage"] for row in damaged)
    assert "arm@1" not in [row["reference"] for row in damaged]
    if "name" not in name:
        assert run("--workspace", place, "models", "boom") == 2, "no other version is taken for it"
        said(capsys)
        Store(place).save(*small_dataset(1), PartRecord(1))
        assert run("--workspace", place, "datasets", "vacuum", "demo@1") == 2, "it may be what a model was made from"
        assert "Nothing was removed" in said(capsys)


@pytest.mark.parametrize("name", ["o'brien", "a/b", "..", ESCAPE, "x" * 500, "a@b@c", ""])
def test_a_name_on_the_command_line_is_no_traceback(place: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for verb in (("datasets",), ("models",), ("report",), ("models", "card"), ("datasets", "lineage"), ("gap",)):
        if name:
            assert run("--workspace", place, *verb, name) == 2
            assert len(said(capsys)) < 3000


@pytest.mark.parametrize(
    ("host", "path", "status"),
    [
        ("[", "/", 400),
        ("localhost:[", "/", 400),
        ("evil.example", "/", 403),
        ("localhost", "/a", 404),
        ("localhost", "/link", 404),
    ],
)
def test_the_web_server_answers_every_request(tmp_path: Path, host: str, path: str, status: int) -> None:
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "link").symlink_to(tmp_path / "secret")
    (tmp_path / "page").write_text("page")
    root = Root(tmp_path)
    with page_server({"/": partial(root.read, "page"), "/link": partial(root.read, "link")}) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        request = urllib.request.Request(f"http://127.0.0.1:{server.server_address[1]}{path}", headers={"Host": host})
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(request)
        assert refused.value.code == status
        refused.value.close()
        server.shutdown()
        thread.join()


def test_what_a_terminal_would_obey_is_written_out() -> None:
    assert visible("boom, Ausleger, 腕, 1 µm ± 2°") == "boom, Ausleger, 腕, 1 µm ± 2°"
    assert visible("a\x1b[31m\nb\u202e") == "a\\x1b[31m\\nb\\u202e"
    assert visible("a\nb", keep="\n") == "a\nb"
    assert visible("x" * 300, 10) == "x" * 10 + "… (290 characters more)"
    assert shown(ESCAPE) == ascii(ESCAPE)
    assert shown(10**5000).startswith("an integer of ")
    value = {"name": ESCAPE, "ok": "µ", "far": "\U000e0001"}
    text = json.dumps(value, ensure_ascii=False)
    assert json.loads(escaped_json(text)) == value
    assert not any(character in escaped_json(text) for character in OBEYED)


def test_tables_that_are_not_what_the_manifest_says_are_a_message(place: Path) -> None:
    def change(manifest: dict[str, Any]) -> None:
        manifest["recordings"][0]["signals"].append("b.joint")
        manifest["units"]["b.joint"] = "rad"

    spoiled(place, change)
    with pytest.raises(StoreError, match=r"dataset demo@2: not readable .*expected tables with the columns"):
        Store(place).load("demo@2")
