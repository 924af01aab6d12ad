"""Where the logs are said to be, and what can go wrong with them on the disk: each is named, and nothing is half written."""

from __future__ import annotations

import errno
import importlib
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Store, ingest
from sysid.errors import InputError, SettingsError, SysidError
from sysid.logs.inspection import inspect_file

MACHINE = """schema = 1
name = "demo"
rate_hz = 100.0
[[axes]]
name = "a"
actuation = "velocity"
drives = "joint"
"""


def write_log(path: Path, times: Any = None, rows: int = 600) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    times = np.arange(rows) / 100.0 if times is None else np.asarray(times)
    values = np.sin(np.arange(len(times)) / 10.0 + 1e-6 * zlib.crc32(path.parent.name.encode()))  # no two are copies
    pd.DataFrame({"time": times, "a.command": values, "a.joint": values}).to_csv(path, index=False)
    return path


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Three recordings of a machine with one axis."""
    for name in ("r1", "r2", "r3"):
        write_log(tmp_path / "logs" / name / "log.csv")
    (tmp_path / "logs" / "machine.toml").write_text(MACHINE)
    return tmp_path / "logs"


def refused(logs: Path, workspace: Path, error: type[SysidError], message: str, **options: Any) -> None:
    with pytest.raises(error, match=message):
        ingest(logs, workspace, **options)
    assert Store(workspace).list() == ()


def test_a_path_that_does_not_exist_is_named(tmp_path: Path) -> None:
    refused(
        tmp_path / "nowhere", tmp_path / "ws", InputError, "nowhere: no such file or folder; expected a folder of recordings"
    )


def test_what_is_no_log_is_said_to_be_what_it_is(tmp_path: Path, logs: Path) -> None:
    refused(logs / "machine.toml", tmp_path / "ws", InputError, r"machine\.toml: a recipe or a machine description, not a log")
    (logs / "bus.dbc").write_text("VERSION")
    expected = r"bus\.dbc: a database of CAN messages, not a log; .*`dbc = \"bus\.dbc\"`"
    refused(logs / "bus.dbc", tmp_path / "ws", InputError, expected)
    (logs / "metadata.yaml").write_text("x")
    refused(logs / "metadata.yaml", tmp_path / "ws", InputError, r"metadata\.yaml\), not a log; .*Give the \.db3 or \.mcap")
    for name in ("log.json", "log.log", "log.gz"):
        (logs / name).write_text("x")
    with pytest.raises(InputError, match=r'`reader = "json"`'):
        inspect_file(logs / "log.json")
    with pytest.raises(InputError, match=r'`reader = "can"`'):
        inspect_file(logs / "log.log")
    with pytest.raises(InputError, match=r"a packed file; .*Unpack it first"):
        inspect_file(logs / "log.gz")


def test_folders_where_files_should_be(tmp_path: Path, logs: Path) -> None:
    refused(logs, tmp_path / "ws", SettingsError, "r1: is a folder; expected a TOML file", machine=logs / "r1")
    refused(logs, tmp_path / "ws", SettingsError, "r1: is a folder; expected a TOML file", recipe=logs / "r1")
    for name in ("r1", "r2", "r3"):
        (logs / name / "log.csv").unlink()
        (logs / name / "log.csv").mkdir()
    refused(logs, tmp_path / "ws", InputError, "logs: no log files; expected recordings")


def test_globs_of_a_recipe_that_match_nothing(tmp_path: Path, logs: Path) -> None:
    recipe = logs / "recipe.toml"
    head = 'schema = 1\n[[streams]]\nfiles = "*.mcpa"\n[streams.signals]\n"a.joint" = {field = "a.joint"}\n'
    recipe.write_text(head)
    refused(logs, tmp_path / "ws", InputError, r"logs: no file '\*\.mcpa' of the recipe's `files`; expected one of: log\.csv")
    given: dict[str, Any] = {"recipe": recipe, "machine": logs / "machine.toml"}
    refused(logs / "r1/log.csv", tmp_path / "ws", InputError, r"no entry of the recipe .* files \*\.mcpa", **given)
    more = '[[streams]]\nfiles = "*.csv"\n[streams.signals]\n"a.command" = {field = "a.command"}\n'
    recipe.write_text(head + more)
    dataset = ingest(logs, tmp_path / "ws")
    assert dataset.quality["notes"] == ["no recording has a file '*.mcpa': its entry is not used"]
    recipe.write_text(head.replace("*.mcpa", "*.csv") + "[recordings]\nmotion = ['s*']\n")
    refused(logs, tmp_path / "other", InputError, r"logs: no file '\*\.csv'")


@pytest.mark.parametrize("with_recipe", [False, True])
def test_links_out_of_the_folder_are_not_followed(tmp_path: Path, logs: Path, with_recipe: bool) -> None:
    outside = write_log(tmp_path / "elsewhere" / "log.csv")
    if with_recipe:
        text = 'schema = 1\n[[streams]]\nfiles = "*.csv"\n[streams.signals]\n"a.joint" = {field = "a.joint"}\n'
        (logs / "recipe.toml").write_text(text + '"a.command" = {field = "a.command"}\n')
    (logs / "r2/log.csv").unlink()
    (logs / "r2/log.csv").symlink_to(outside)
    refused(logs, tmp_path / "ws", SettingsError, r"r2/log\.csv: path .*elsewhere/log\.csv' leaves the folder .*Copy it there")
    (logs / "r2/log.csv").unlink()
    (logs / "r2").rmdir()
    (logs / "r2").symlink_to(outside.parent)
    refused(logs, tmp_path / "ws", SettingsError, r"logs/r2: path .*elsewhere' leaves the folder")
    # Who names a link on the command line means the file.
    link = logs / "named.csv"
    link.symlink_to(outside)
    assert [
        source.path for source in ingest(link, tmp_path / "ws", machine=logs / "machine.toml", recipe=whole(tmp_path)).sources
    ]


def whole(folder: Path) -> Path:
    """A recipe that does not cut a short recording."""
    text = 'schema = 1\n[splits]\nfit = ["*"]\n[[streams]]\nfiles = "*.csv"\n[streams.signals]\n'
    path = folder / "whole.toml"
    path.write_text(text + "".join(f'"a.{what}" = {{field = "a.{what}"}}\n' for what in ("command", "joint")))
    return path


@pytest.mark.parametrize("what", ["grow", "rewrite", "vanish"])
def test_a_log_that_changes_while_it_is_read_is_refused(
    tmp_path: Path, logs: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = logs / "r2/log.csv"
    module = importlib.import_module("sysid.datasets.ingestion")
    read_channels = module.read_channels

    def read(files: Any, *others: Any) -> Any:
        reading = read_channels(files, *others)
        if files.name == "r2":
            if what == "grow":
                path.write_text(path.read_text() + "6.0,0.0,0.0\n")
            elif what == "rewrite":
                text = path.read_text()
                path.write_text(text)
                os.utime(path, ns=(0, 1))
            else:
                path.unlink()
        return reading

    monkeypatch.setattr(module, "read_channels", read)
    done = "removed" if what == "vanish" else "written"
    refused(logs, tmp_path / "ws", InputError, rf"r2/log\.csv: {done} while it was read; .*Wait until it is recorded")


#: name → stamps [s] of a recording with 600 rows.
STAMPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "unordered": lambda t: np.random.default_rng(1).permutation(t),
    "all the same": lambda t: np.zeros_like(t),
    "negative": lambda t: t - 1000.0,
    "huge": lambda t: t * 1e8,
    "one huge": lambda t: np.where(np.arange(len(t)) == 300, 1e9, t),
    "beyond 64 bits": lambda t: t + 1e12,
    "missing": lambda t: np.where(np.arange(len(t)) == 5, np.nan, t),
    "doubled": lambda t: np.repeat(t[::2], 2),
    "one row": lambda t: t[:1],
    "no rows": lambda t: t[:0],
}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("unordered", r"log: stamps go back in time \d+ times"),
        ("all the same", r"a\.joint: 600 samples with 1 stamp in 'log'; expected two at least"),
        ("negative", ""),
        ("huge", r"log\.csv: time: stamps of no stated unit; as seconds 1e-06 Hz .*expected ns \(1000 Hz, 0\.599 s\)"),
        ("one huge", ""),
        ("beyond 64 bits", r"a time of 1e\+12 s; expected times that fit into 64 bits"),
        ("missing", r"no time in row 6"),
        ("doubled", ""),
        ("one row", r"a\.joint: 1 sample with 1 stamp"),
        ("no rows", r"log\.csv: a header but no rows"),
    ],
)
def test_stamps_of_every_kind(tmp_path: Path, logs: Path, name: str, message: str) -> None:
    write_log(logs / "r1/log.csv", STAMPS[name](np.arange(600) / 100.0))
    if message:
        refused(logs, tmp_path / "ws", InputError, message)
    else:
        assert len(ingest(logs, tmp_path / "ws").recordings[0].table) > 500


def test_a_log_that_may_not_be_read_is_named(tmp_path: Path, logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the operating system refuses it; the owner of these files may be allowed everything."""
    locked = logs / "r2/log.csv"
    opened = Path.open

    def guarded(path: Path, *arguments: Any, **options: Any) -> Any:
        if path == locked:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opened(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", guarded)
    with pytest.raises(PermissionError, match=r"r2/log\.csv"):
        ingest(logs, tmp_path / "ws")
    assert Store(tmp_path / "ws").list() == ()
    seen = inspect_file(locked)
    assert seen.refusal == f"{locked}: may not be read (permission denied)"
    assert inspect_file(logs / "r1/log.csv").streams[0].samples == 600
