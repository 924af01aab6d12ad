"""A disk that takes no more: each verb that writes names the file and a remedy that works, and leaves no part of it."""

from __future__ import annotations

import errno
import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import run
from sample_workspace import sample_workspace

from sysid.cli.app import run_command
from sysid.errors import REMEDIES, StorageError, written_to
from sysid.files import written_whole
from sysid.root import Root


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("full") / "ws"
    sample_workspace(folder)
    return folder


@contextmanager
def room(size: int) -> Iterator[None]:
    """Files of at most ``size`` bytes, as on a disk that is full; the system raises EFBIG at the next one."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


#: Verb → arguments, and what they write, in a folder.
VERBS: dict[str, tuple[tuple[str, ...], str]] = {
    "view": (("view", "autolog@1", "--out"), "run.rrd"),
    "report": (("report", "autolog@1", "--out"), "report.html"),
    "card": (("models", "card", "autolog-actuator", "--out"), "card.html"),
    "onnx": (("models", "export", "autolog-actuator", "--out"), "onnx"),
    "json": (("datasets", "--json"), "datasets.json"),
    **{f"export {to}": (("export", "autolog@1", "--to", to, "--out"), to) for to in ("json", "urdf", "sdf", "mjcf", "lut")},
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_names_the_file_and_what_to_do(
    verb: str, workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, name = VERBS[verb]
    with room(300):
        assert run("--workspace", workspace, *arguments, tmp_path / name) == 1
    shown = capsys.readouterr().err.splitlines()[-1]
    assert shown.startswith(f"sysid: {tmp_path / name}")
    assert "File too large" in shown
    assert shown.endswith((REMEDIES[errno.EFBIG], "Make room, or name another folder with --out."))
    assert list(tmp_path.iterdir()) == []


def test_the_pages_of_a_workspace_are_written_or_named(
    workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with room(5000):
        assert run("--workspace", workspace, "ui", "--out", tmp_path / "site") == 1
    assert f"{tmp_path / 'site'}/" in (shown := capsys.readouterr().err)
    assert REMEDIES[errno.EFBIG] in shown
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_the_files_of_a_new_machine_are_written_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with room(200):
        assert run("init", tmp_path / "arm") == 1
    shown = capsys.readouterr().err
    assert f"sysid: {tmp_path / 'arm'}/" in shown
    assert REMEDIES[errno.EFBIG] in shown
    assert ".part" not in shown
    assert not list(tmp_path.rglob("*.toml*"))


@pytest.mark.parametrize("number", sorted(REMEDIES))
@pytest.mark.parametrize("named", [True, False])
def test_each_error_of_the_disk_has_its_remedy(number: int, named: bool, tmp_path: Path) -> None:
    """A write names no file, opening one names the unfinished one; both mean the file that the user knows."""

    def write() -> None:
        with written_whole(path) as half:
            half.write_text("half")
            refuse(half)

    def refuse(half: Path) -> None:
        raise OSError(number, os.strerror(number), *([str(half)] if named else []))

    path = tmp_path / "result.json"
    path.write_text("before")
    with pytest.raises(StorageError) as stop:
        write()
    assert str(stop.value) == f"{path}: {os.strerror(number)}. {REMEDIES[number]}"
    assert [entry.read_text() for entry in tmp_path.iterdir()] == ["before"]


@pytest.mark.parametrize("write", [Root.write, Root.write_new])
def test_a_file_below_a_root_is_named(write: Callable[[Root, str, bytes], None], tmp_path: Path) -> None:
    with room(10), pytest.raises(OSError, match="File too large") as stop:
        write(Root(tmp_path), "a/b.json", b"x" * 100)
    assert stop.value.filename == str(tmp_path / "a/b.json")


def test_a_library_that_does_not_say_why_is_asked_of_the_disk(tmp_path: Path) -> None:
    """An error of ours stays what it is; that of a library on a full disk is one of the disk."""
    path, half = tmp_path / "model.pt", tmp_path / ".model.pt.part"
    half.write_bytes(b"x")
    with pytest.raises(RuntimeError, match="writer failed"), written_to(half, path):
        raise RuntimeError("writer failed")
    with room(1), pytest.raises(StorageError, match=r"model\.pt: File too large\. Raise"), written_to(half, path):
        raise RuntimeError("writer failed")


def test_an_error_outside_the_output_is_left_alone(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), written_to(tmp_path / "half", tmp_path / "whole"):
        (tmp_path / "input.csv").read_text()


def test_a_file_that_may_not_be_read_is_named_with_a_remedy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "/logs/a.csv")

    monkeypatch.setattr("sysid.cli.app.app.main", refused)
    assert run_command(["datasets"]) == 1
    assert capsys.readouterr().err == f"sysid: /logs/a.csv: Permission denied. {REMEDIES[errno.EACCES]}\n"
