"""From files to a stored version: canonical folders, bad input, the same again."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Store, ingest
from sysid.errors import AlignmentError, InputError, SettingsError

MACHINE = """schema = 1
name = "demo"
rate_hz = 50.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "cylinder"
gain = 0.05
stroke = [0.0, 0.5]
"""


def motion(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    time = np.arange(int(seconds * 50)) / 50.0
    rng = np.random.default_rng(seed)
    command = np.clip(
        np.interp(time, np.arange(0, seconds + 1, 1.5), rng.normal(size=len(np.arange(0, seconds + 1, 1.5)))), -1, 1
    )
    cylinder = 0.25 + 0.05 * np.cumsum(command - command.mean()) / 50
    return time, command, cylinder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three recordings with canonical headers, one of them in two files, millimetres, and the machine beside them."""
    root = tmp_path / "logs"
    for index in range(3):
        (root / f"run-{index}").mkdir(parents=True)
        time, command, cylinder = motion(20.0, index)
        table = pd.DataFrame({"time": time + 100.0, "boom.command": command, "boom.cylinder [mm]": 1e3 * cylinder})
        table.to_csv(root / f"run-{index}" / "log.csv", index=False)
    (root / "machine.toml").write_text(MACHINE)
    return root


def test_a_canonical_folder_needs_no_recipe(folder: Path, tmp_path: Path) -> None:
    steps: list[tuple[float, str]] = []
    dataset = ingest(folder, tmp_path / "ws", progress=lambda done, text: steps.append((done, text)))
    assert dataset.reference == "demo@1"
    assert dataset.splits == {"run-0": "fit", "run-1": "select", "run-2": "held_out"}
    assert dataset.units == {"time": "s", "boom.command": "1", "boom.cylinder": "m"}
    recording = dataset.recording("run-1")
    time, command, cylinder = motion(20.0, 1)
    np.testing.assert_allclose(recording.values("time"), time)
    np.testing.assert_allclose(recording.values("boom.command"), command)
    np.testing.assert_allclose(recording.values("boom.cylinder"), cylinder, atol=1e-9)
    assert recording.start_ns == 100_000_000_000
    assert recording.table.attrs["units"]["boom.cylinder"] == "m"
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert steps[-1] == (1.0, "stored demo@1")


def test_a_recipe_may_say_no_more_than_the_splits(folder: Path, tmp_path: Path) -> None:
    plain = ingest(folder, tmp_path / "plain")
    (folder / "recipe.toml").write_text('schema = 1\nmachine = "machine.toml"\n[splits]\nheld_out = ["run-0"]\n')
    dataset = ingest(folder, tmp_path / "split")
    assert [r.name for r in dataset.recordings] == [r.name for r in plain.recordings]
    assert [name for name, role in dataset.splits.items() if role == "held_out"] == ["run-0"]


def test_what_is_stored_is_what_was_made(folder: Path, tmp_path: Path) -> None:
    made = ingest(folder, tmp_path / "ws")
    loaded = Store(tmp_path / "ws").load("demo@1")
    assert (loaded.digest, loaded.splits, loaded.units, loaded.sources, loaded.clocks) == (
        made.digest, made.splits, made.units, made.sources, made.clocks,
    )  # fmt: skip
    assert loaded.machine == made.machine
    for a, b in zip(made.recordings, loaded.recordings, strict=True):
        pd.testing.assert_frame_equal(a.table, b.table)
        assert b.table.attrs["units"] == {"time": "s", "boom.command": "1", "boom.cylinder": "m"}
        assert (a.name, a.rate_hz, a.kind, a.start_ns) == (b.name, b.rate_hz, b.kind, b.start_ns)
    assert loaded.quality["recordings"]["run-0"]["signals"]["boom.cylinder"]["missing"] == 0.0
    assert all(len(source.sha256) == 64 and source.size > 0 for source in loaded.sources)


def test_the_same_files_again_are_the_same_version_and_no_copy(folder: Path, tmp_path: Path) -> None:
    first = ingest(folder, tmp_path / "ws")
    files = sorted(path for path in (tmp_path / "ws").rglob("*") if path.is_file())
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder, moved)
    again = ingest(moved, tmp_path / "ws")
    assert again.reference == first.reference == "demo@1"
    assert sorted(path for path in (tmp_path / "ws").rglob("*") if path.is_file()) == files


@pytest.mark.parametrize("change", ["log", "machine", "recipe"])
def test_other_logs_another_machine_or_recipe_are_a_new_version(folder: Path, tmp_path: Path, change: str) -> None:
    first = ingest(folder, tmp_path / "ws")
    if change == "log":
        path = folder / "run-0/log.csv"
        path.write_text(path.read_text().replace("100.02,", "100.021,"))
    elif change == "machine":
        (folder / "machine.toml").write_text(MACHINE.replace("0.05", "0.06"))
    else:
        text = 'schema = 1\n[[streams]]\nfiles = "*.csv"\n[streams.signals]\n"boom.command" = {field = "boom.command"}\n'
        (folder / "recipe.toml").write_text(text)
    second = ingest(folder, tmp_path / "ws", machine=folder / "machine.toml")
    assert second.reference == "demo@2"
    assert second.digest != first.digest
    store = Store(tmp_path / "ws")
    assert [entry.reference for entry in store.list()] == ["demo@1", "demo@2"]
    assert store.load("demo").version == 2
    assert store.load("demo@1").digest == first.digest


def test_another_file_of_one_recording_has_a_clock_of_its_own(tmp_path: Path) -> None:
    """The second file is 0.35 s late and sees the joint that the cylinder moves: both are found from the motion."""
    root = tmp_path / "logs" / "run"
    root.mkdir(parents=True)
    time, command, cylinder = motion(60.0, 4)
    cylinder = 0.25 + 0.2 * np.sin(6.0 * cylinder + 0.4 * np.sin(time))
    noise = np.random.default_rng(0).normal(size=(2, len(time)))
    pd.DataFrame({"time": time, "boom.command": command, "boom.cylinder": cylinder + 1e-4 * noise[0]}).to_csv(
        root / "machine.csv", index=False
    )
    pd.DataFrame({"time": time - 0.35, "boom.joint [deg]": 90 * np.sqrt(cylinder) + 0.03 * noise[1]}).to_csv(
        root / "inclino.csv", index=False
    )
    (root.parent / "machine.toml").write_text(MACHINE)
    dataset = ingest(root.parent, tmp_path / "ws")
    (record,) = dataset.clocks
    assert (record.stream, record.applied) == ("inclino.csv", True)
    start = record.stream_start_ns * 1e-9
    assert record.offset_s - start == pytest.approx(0.35, abs=5e-3)
    joint = np.concatenate([r.values("boom.joint") for r in dataset.recordings])
    moved = np.concatenate([r.values("boom.cylinder") for r in dataset.recordings])
    residual = joint - np.deg2rad(90 * np.sqrt(moved))
    assert np.nanstd(residual) < 2e-3
    channels = Store(tmp_path / "ws").channels("demo")
    raw = channels[channels["source"] == "inclino.csv"]["stamp_ns"].to_numpy()
    np.testing.assert_array_equal(raw, np.rint((time - 0.35) * 1e9).astype(np.int64))  # raw stamps are kept


def other_clock(root: Path, run: str, moves: bool) -> None:
    """A joint that the cylinder turns, on a clock of another epoch; where nothing moves it has no place in time."""
    time, command, cylinder = motion(60.0, 4)
    noise = np.random.default_rng(0).normal(size=(2, len(time)))
    sway = cylinder + 0.1 * np.sin(time) if moves else np.full(len(time), 0.25)
    (root / run).mkdir(parents=True)
    pd.DataFrame({"time": time, "boom.command": command, "boom.cylinder": sway + 1e-4 * noise[0]}).to_csv(
        root / run / "machine.csv", index=False
    )
    pd.DataFrame({"time": time + 1e6, "boom.joint [deg]": 90 * np.sqrt(sway) + 0.03 * noise[1]}).to_csv(
        root / run / "inclino.csv", index=False
    )
    (root / "machine.toml").write_text(MACHINE)


def test_a_recording_in_which_nothing_moves_is_left_out_and_said(tmp_path: Path) -> None:
    root = tmp_path / "logs"
    other_clock(root, "moves", True)
    other_clock(root, "stands", False)
    dataset = ingest(root, tmp_path / "ws")
    assert {recording.name.partition("#")[0] for recording in dataset.recordings} == {"moves"}
    (note,) = (note for note in dataset.quality["notes"] if note.startswith("left out"))
    assert "recording stands: inclino.csv" in note
    assert "nothing moves" in note
    (root / "recipe.toml").write_text('schema = 1\n[splits]\nheld_out = ["stands"]\n')
    with pytest.raises(AlignmentError, match="recording stands"):
        ingest(root, tmp_path / "other", recipe=root / "recipe.toml")
    shutil.rmtree(root / "moves")
    (root / "recipe.toml").unlink()
    with pytest.raises(AlignmentError, match="recording stands"):
        ingest(root, tmp_path / "other")


def write(path: Path, text: str) -> None:
    path.write_text(text)


CASES: dict[str, tuple[Callable[[Path], None], type[Exception], str]] = {
    "empty file": (lambda f: write(f / "run-0/log.csv", ""), InputError, r"run-0/log\.csv: the file is empty"),
    "unknown column": (
        lambda f: write(f / "run-0/log.csv", "time,boom.cylindr\n0,1\n"),
        InputError,
        r"unknown column 'boom\.cylindr'; expected 'boom\.cylinder'\?.*Rename the column, or map the file with a recipe",
    ),
    "wrong unit": (
        lambda f: write(f / "run-0/log.csv", "time,boom.cylinder [deg]\n0,1\n"),
        InputError,
        r"boom\.cylinder: a unit of \[rad\] \(deg\); expected a unit of \[m\]",
    ),
    "unknown unit": (
        lambda f: write(f / "run-0/log.csv", "time,boom.cylinder [furlongz]\n0,1\n"),
        InputError,
        "unknown unit 'furlongz'",
    ),
    "stamps that go back": (
        lambda f: write(f / "run-0/log.csv", "time,boom.cylinder\n0,1\n1,1\n0.5,1\n0.2,1\n2,1\n"),
        InputError,
        r"stamps go back in time 2 times, first in row 3 by 0\.5 s; expected increasing stamps",
    ),
    "two sources": (
        lambda f: shutil.copy(f / "run-0/log.csv", f / "run-0/copy.csv") and None,
        InputError,
        r"run-0: boom\.command: two sources",
    ),
    "no machine": (lambda f: os.remove(f / "machine.toml"), SettingsError, "no machine description; expected machine.toml"),
    "outside": (
        lambda f: write(f / "recipe.toml", 'schema = 1\nmachine = "../machine.toml"\n'),
        SettingsError,
        r"path '\.\./machine\.toml' leaves the folder",
    ),
    "link to outside": (
        lambda f: (
            (shutil.move(f / "run-0/log.csv", f.parent / "x.csv"), os.symlink(f.parent / "x.csv", f / "run-0/log.csv"), None)[
                -1
            ]
            or write(f / "recipe.toml", 'schema = 1\n[[streams]]\nfiles = "log.csv"\n')
        ),
        SettingsError,
        "leaves the folder",
    ),
    "unknown field": (
        lambda f: write(
            f / "recipe.toml", 'schema = 1\n[[streams]]\nfiles = "*.csv"\nsignals = {"boom.joint" = {field = "bom"}}\n'
        ),
        InputError,
        r"no field 'bom' in 'log'; expected",
    ),
    "unit mismatch": (
        lambda f: write(
            f / "recipe.toml",
            'schema = 1\n[[streams]]\nfiles = "*.csv"\nsignals = {"boom.cylinder" = {field = "boom.cylinder", unit = "m"}}\n',
        ),
        InputError,
        r"the file states \[mm\]; expected \[m\] as in the recipe",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_named_and_leaves_nothing_behind(folder: Path, tmp_path: Path, case: str) -> None:
    spoil, error, message = CASES[case]
    spoil(folder)
    with pytest.raises(error, match=message):
        ingest(folder, tmp_path / "ws")
    assert Store(tmp_path / "ws").list() == ()


def test_missing_paths_and_folders_without_logs(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    with pytest.raises(InputError, match="no such file or folder"):
        ingest(tmp_path / "none", tmp_path / "ws", machine=tmp_path / "machine.toml")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no log files"):
        ingest(tmp_path / "empty", tmp_path / "ws", machine=tmp_path / "machine.toml")
    with pytest.raises(SettingsError, match=r"dataset name: 'a/\.\./b'"):
        ingest(tmp_path / "empty", tmp_path / "ws", machine=tmp_path / "machine.toml", name="a/../b")


def test_few_late_rows_are_sorted_and_reported(folder: Path, tmp_path: Path) -> None:
    path = folder / "run-0/log.csv"
    lines = path.read_text().splitlines()
    lines[500], lines[501] = lines[501], lines[500]
    path.write_text("\n".join([*lines[:700], lines[699], *lines[700:]]) + "\n")
    dataset = ingest(folder, tmp_path / "ws")
    assert dataset.quality["streams"]["run-0"]["log.csv/boom.command"]["late"] == 1
    np.testing.assert_allclose(dataset.recording("run-0").values("boom.command"), motion(20.0, 0)[1])


def test_a_stuck_sensor_and_one_beyond_its_range_are_flagged(folder: Path, tmp_path: Path) -> None:
    for name, change in (("run-0", lambda x: np.where(np.arange(len(x)) < 500, x, x[500])), ("run-1", lambda x: x + 0.4)):
        time, command, cylinder = motion(20.0, int(name[-1]))
        table = pd.DataFrame({"time": time, "boom.command": command, "boom.cylinder": change(cylinder)})
        table.to_csv(folder / name / "log.csv", index=False)
    quality = ingest(folder, tmp_path / "ws").quality["recordings"]
    assert "one value for" in quality["run-0"]["flags"][0]
    assert "are outside [0, 0.5]" in quality["run-1"]["flags"][0]
    assert quality["run-2"]["flags"] == []


def test_an_object_store_url_is_a_workspace(folder: Path, tmp_path: Path) -> None:
    url = f"file://{tmp_path}/bucket"
    (tmp_path / "bucket").mkdir()
    made = ingest(folder, url)
    assert ingest(folder, url).version == 1
    loaded = Store(url).load("demo@1")
    pd.testing.assert_frame_equal(loaded.recordings[0].table, made.recordings[0].table)
    assert [entry.reference for entry in Store(url).list()] == ["demo@1"]
