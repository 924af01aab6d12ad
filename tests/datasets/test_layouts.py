"""Recordings of one machine in several layouts: the draft has one entry for each, and they are one dataset."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets import Store, append, ingest
from sysid.datasets.layouts import layouts_of
from sysid.datasets.recipe import load_recipe
from sysid.errors import InputError, SettingsError
from sysid.execution import LocalExecutor
from sysid.logs.inspection import ClockSummary, FieldSummary, FileSummary, StreamSummary

MACHINE = """schema = 1
name = "rig"
rate_hz = 50.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "cylinder"
gain = 0.05
stroke = [0.0, 0.5]
"""


def motion(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], command and cylinder [m] of 12 s."""
    command = np.repeat(np.random.default_rng(seed).uniform(-1, 1, 30), 20)
    return np.arange(600) / 50.0, command, 0.25 + np.cumsum(command) * 0.05 / 50.0


def monday(path: Path, seed: int) -> None:
    time, command, cylinder = motion(seed)
    table = pd.DataFrame({"Time (ms)": 1000 * time, "boom cmd": command, "boom cyl (mm)": 1000 * cylinder})
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, sep=";", decimal=",")


def tuesday(path: Path, seed: int) -> None:
    time, command, cylinder = motion(seed)
    table = pd.DataFrame({"stamp": (1e6 * time).astype(int), "boom_command": command, "stroke_boom [cm]": 100 * cylinder})
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False)


def wednesday(path: Path, seed: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(motion(seed)), delimiter=",")


def drafted(folder: Path) -> Path:
    """The draft for ``folder``/logs, with the columns of files without a header filled in."""
    (folder / "machine.toml").write_text(MACHINE)
    assert run("ingest", "--inspect", folder / "logs", "--draft", folder / "recipe.toml") == 0
    text = (folder / "recipe.toml").read_text("utf-8")
    for column, signal, unit in (("2", "command", ""), ("3", "cylinder", ', unit = "m"')):
        entry = rf'# "[^"]*" = \{{ field = "column {column}"[^}}]*\}}'
        text = re.sub(entry, f'"boom.{signal}" = {{ field = "column {column}"{unit} }}', text)
    (folder / "recipe.toml").write_text(text, "utf-8")
    return folder / "recipe.toml"


@pytest.mark.parametrize(
    "files",
    [
        {"monday/run1.csv": monday, "monday/run2.csv": monday, "tuesday/run1.csv": tuesday, "wednesday/log.csv": wednesday},
        {"r1.csv": monday, "r2.csv": tuesday, "r3.csv": wednesday, "r4.csv": monday},
        {"a/log.csv": monday, "b/log.csv": tuesday, "c/log.csv": wednesday, "d/log.csv": tuesday},
        {"a/x.csv": monday, "b/y.csv": tuesday, "c/z.csv": wednesday},
    ],
)
def test_the_draft_of_several_layouts_is_one_dataset(tmp_path: Path, files: dict[str, Callable[[Path, int], None]]) -> None:
    for seed, (name, write) in enumerate(files.items()):
        write(tmp_path / "logs" / name, seed)
    recipe = load_recipe(drafted(tmp_path))
    assert len(recipe.streams) == len({*files.values()})
    dataset = ingest(tmp_path, tmp_path / "ws")
    assert len(dataset.sources) == len(files)
    ranges = {tuple(map(float, np.round(motion(seed)[2][[0, -1]], 6))) for seed in range(len(files))}
    found = Store(tmp_path / "ws").channels(dataset.reference)
    cylinders = found[found["signal"] == "boom.cylinder"].groupby("recording", observed=True)["value"]
    assert {(round(float(v.iloc[0]), 6), round(float(v.iloc[-1]), 6)) for _, v in cylinders} == ranges
    manifest = Store(tmp_path / "ws").manifest(dataset.reference)
    assert manifest["parts"][0]["made"]["recipe"] == recipe.text


def test_ranges_are_those_of_all_files_of_a_layout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in range(4):
        (monday if seed % 2 else tuesday)(tmp_path / f"logs/r{seed}.csv", seed)
    text = drafted(tmp_path).read_text("utf-8")
    values = np.concatenate([1000 * motion(seed)[2] for seed in (1, 3)])
    assert f'"boom cyl (mm)", unit = "mm" }}   # {values.min():.4g} … {values.max():.4g}' in text
    assert 'time_unit = "ms"' in text
    assert 'time_unit = "us"' in text
    shown = capsys.readouterr().out
    assert "found: cells separated by ';'; decimal commas" in shown


def test_two_sensors_with_one_header_are_two_entries(tmp_path: Path) -> None:
    for seed, folder in enumerate(("a", "b", "c")):
        for side in ("left", "right"):
            monday(tmp_path / f"logs/{folder}/{side}.csv", seed)
    recipe = load_recipe(drafted(tmp_path))
    assert [stream.files for stream in recipe.streams] == ["left.csv", "right.csv"]
    assert not recipe.recordings.files


RECIPE = """schema = 1
[[streams]]
files = "*.csv"
{first}time = "Time (ms)"
time_unit = "ms"
[streams.signals]
"boom.command" = {{ field = "boom cmd" }}
"boom.cylinder" = {{ field = "boom cyl (mm)", unit = "mm" }}
[[streams]]
files = "*.csv"
{second}time = "stamp"
time_unit = "us"
[streams.signals]
"boom.command" = {{ field = "boom_command" }}
"boom.cylinder" = {{ field = "stroke_boom" }}
"""


def two_days(folder: Path, first: str, second: str) -> Path:
    for seed, write in enumerate((monday, monday, tuesday)):
        write(folder / f"logs/{write.__name__}-{seed}/log.csv", seed)
    (folder / "machine.toml").write_text(MACHINE)
    (folder / "logs/recipe.toml").write_text(RECIPE.format(first=first, second=second))
    return folder / "logs"


def test_entries_apply_to_their_recordings(tmp_path: Path) -> None:
    logs = two_days(tmp_path, 'recordings = ["monday-*"]\n', 'recordings = ["tuesday-*"]\n')
    dataset = ingest(logs, tmp_path / "ws")
    assert [recording.name for recording in dataset.recordings] == ["monday-0", "monday-1", "tuesday-2"]
    made = Store(tmp_path / "ws").manifest(dataset.reference)["parts"][0]["made"]
    assert set(made["settings"]["streams"]) == {"*.csv in monday-*", "*.csv in tuesday-*"}
    tuesday(tmp_path / "more/tuesday-3/log.csv", 3)
    longer = append(tmp_path / "more", tmp_path / "ws", dataset.name, role="fit")
    assert [recording.name for recording in longer.recordings][-1] == "tuesday-3"


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (
            "",
            "",
            r"two primary sources for 'boom\.command' in recording 'monday-0'.*`recordings = \[\"monday-0\"\]`, with globs",
        ),
        ('recordings = ["mondy-*"]\n', "", r"recordings: no recording 'mondy-\*'; expected 'monday-[01]'\?"),
        ('recording = ["monday-*"]\n', "", r"unknown key 'streams\[0\]\.recording'; expected 'recordings'\?"),
    ],
)
def test_what_does_not_separate_layouts_is_refused(tmp_path: Path, first: str, second: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        ingest(two_days(tmp_path, first, second), tmp_path / "ws")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('files = "monday/*.csv"', r'Write `files = "\*\.csv"` and `recordings = \["monday"\]`'),
        ('files = "a"\ntime_unit = "<s or ms>"', r"time_unit: unknown unit '<s or ms>'.*Fill in the unit"),
        ('files = "a"\ntime_unit = "mm"', r"time_unit: 'mm', a unit of \[m\]"),
        ('files = "a"\ncolumns = ["a", "b", "a"]', r"columns: 'a' twice; expected a name for each column"),
        ('files = "a"\ndecimal = ";"', r"decimal = ';'; expected '\.' or ','"),
        ('files = "a"\ndecimal = ","\ndelimiter = ","', r"',' as `decimal` and as `delimiter`"),
    ],
)
def test_wrong_keys_of_an_entry_are_refused(tmp_path: Path, lines: str, message: str) -> None:
    (tmp_path / "recipe.toml").write_text(f"schema = 1\n[[streams]]\n{lines}\n")
    with pytest.raises(SettingsError, match=message):
        load_recipe(tmp_path / "recipe.toml")


def test_a_unit_that_nothing_decides_is_requested(tmp_path: Path) -> None:
    path = tmp_path / "logs/log.csv"
    path.parent.mkdir()
    pd.DataFrame({"time": 0.5 * np.arange(60), "boom cylinder [m]": np.arange(60.0)}).to_csv(path, index=False)
    assert run("ingest", "--inspect", path, "--draft", tmp_path / "recipe.toml") == 0
    text = (tmp_path / "recipe.toml").read_text("utf-8")
    assert 'time_unit = "<s or ms>"   # not stated in the file: s (2 Hz, 29.5 s) or ms (2000 Hz, 0.0295 s)' in text
    with pytest.raises(SettingsError, match="Fill in the unit"):
        load_recipe(tmp_path / "recipe.toml")


@pytest.mark.parametrize(("rate", "noted"), [(2.0, True), (50.0, False), (900.0, False)])
def test_a_rate_that_fits_the_machine_in_another_unit_is_noted(tmp_path: Path, rate: float, noted: bool) -> None:
    """2 Hz in seconds are 2 kHz in milliseconds; a log of 900 Hz for a machine of 500 Hz is as usual."""
    (tmp_path / "machine.toml").write_text(MACHINE.replace("rate_hz = 50.0", "rate_hz = 500.0"))
    for seed in range(3):
        time, command, cylinder = motion(seed)
        path = tmp_path / f"logs/r{seed}/log.csv"
        path.parent.mkdir(parents=True)
        table = pd.DataFrame({"time": time * 50.0 / rate, "boom.command": command, "boom.cylinder": cylinder})
        table.to_csv(path, index=False)
    notes = ingest(tmp_path / "logs", tmp_path / "ws").quality["notes"]
    expected = "r0/log.csv: 2 samples a second, machine.toml states 500 Hz. Are the stamps in ms?"
    assert [expected in note for note in notes[:1]] == [True] * noted


def test_commands_between_the_rows_of_the_grid_are_noted(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE.replace("rate_hz = 50.0", "rate_hz = 25.0"))
    for seed in range(2):
        time, command, cylinder = motion(seed)
        path = tmp_path / f"logs/r{seed}/log.csv"
        path.parent.mkdir(parents=True)
        pd.DataFrame({"time": time, "boom.command": command, "boom.cylinder": cylinder}).to_csv(path, index=False)
    (note,) = ingest(tmp_path / "logs", tmp_path / "ws").quality["notes"]
    assert note.startswith(
        "log.csv: commands at 50 Hz in 2 recordings, the grid has 25 Hz: a command between two rows acts up to"
    )
    assert note.endswith("40 ms later. State rate_hz = 50 in machine.toml")
    by_tasks = ingest(tmp_path / "logs", tmp_path / "tasks", executor=LocalExecutor())
    assert list(by_tasks.quality["notes"]) == [note]


def test_a_damaged_file_does_not_become_a_layout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in range(3):
        monday(tmp_path / f"logs/r{seed}.csv", seed)
    damaged = tmp_path / "logs/r1.csv"
    lines = damaged.read_text().splitlines(keepends=True)
    damaged.write_text("".join([*lines[:50], "1,0;2\n", *lines[50:]]))
    text = drafted(tmp_path).read_text("utf-8")
    assert "# left out: " in text
    assert "line 51: 2 values; expected 3" in text
    recipe = tomllib.loads(text)
    assert (len(recipe["streams"]), set(recipe["recordings"]["files"])) == (1, {"r0", "r1", "r2"})
    assert recipe["recordings"]["left_out"] == ["r1/r1.csv"]
    assert "cannot be ingested" in capsys.readouterr().out
    recipe_of_it = tmp_path / "other.toml"
    recipe_of_it.write_text(text.replace("left_out = ", "# left_out = "), "utf-8")
    with pytest.raises(InputError, match="line 51: 2 values; expected 3"):
        ingest(damaged.parent, tmp_path / "ws", tmp_path / "machine.toml", recipe_of_it)


NAMES = st.text("ab1*?[]_", min_size=1, max_size=3)


@given(
    st.dictionaries(st.tuples(NAMES, NAMES.map(lambda name: f"{name}.csv")), st.sampled_from("xyz"), min_size=1, max_size=9),
)
def test_the_entries_match_each_file_once(layouts: dict[tuple[str, str], str]) -> None:
    """Each file of any names is matched by the entries of its layout and by no other."""
    clock = ClockSummary("time", 0, 1.0, 10.0, 0.0, 0, 0.0, 0.0, 0)
    files, recordings = [], {}
    for number, ((recording, name), field) in enumerate(layouts.items()):
        path = Path(f"folder{number}") / name
        streams = (StreamSummary(path.stem, "", 3, (clock,), (FieldSummary(field, None, 0.0, 1.0, 0.0),)),)
        files.append(FileSummary(path, "csv", 10, streams))
        recordings[path] = recording
    found = layouts_of(files, recordings)
    for file in files:
        matched = [
            layout.whole.streams[0].fields[0].name
            for layout in found
            for pattern, names in layout.entries
            if fnmatchcase(file.path.name, pattern)
            and (not names or any(fnmatchcase(recordings[file.path], one) for one in names))
        ]
        assert {*matched} == {file.streams[0].fields[0].name}


def test_a_file_without_numbers_gets_no_entry(tmp_path: Path) -> None:
    """Events beside a log: the draft says so, and needs no correction."""
    tuesday(tmp_path / "logs/run/log.csv", 1)
    (tmp_path / "logs/run/event.csv").write_text("type,time,event\nEVENT,0,START\nEVENT,11.9,STOP\n")
    (tmp_path / "machine.toml").write_text(MACHINE)
    assert run("ingest", "--inspect", tmp_path / "logs", "--draft", tmp_path / "recipe.toml") == 0
    text = (tmp_path / "recipe.toml").read_text("utf-8")
    assert text.count("[[streams]]") == 1
    assert "# left out: event.csv: no column of numbers beside the stamps" in text
