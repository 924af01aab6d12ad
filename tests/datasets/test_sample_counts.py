"""Every sample is counted: from the rows of a file to the rows of the dataset, at any rate, phase, gap and order."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_logs import LOGS, STATED, write_log

from sysid.datasets import Dataset, ingest
from sysid.datasets.channels import read_channels
from sysid.datasets.checks.run import check_plausibility
from sysid.datasets.discover import RecordingFiles
from sysid.datasets.quality.sample_counts import SampleCounts, stored_counts
from sysid.datasets.recipe import SignalMap, StreamMap
from sysid.errors import SettingsError
from sysid.logs import ReadOptions, reader_named
from sysid.machine import load_machine
from sysid.reports.dataset_texts import sample_table

MACHINE = (
    'schema = 1\nname = "press"\nrate_hz = 100.0\n[[axes]]\nname = "ram"\nactuation = "velocity"\ndrives = "joint"\n'
    'limits = [-9.0, 9.0]\njoint_type = "revolute"\n'
)


def ingested(tmp_path: Path, tables: Mapping[str, Mapping[str, Any]]) -> Dataset:
    tmp_path.mkdir(exist_ok=True)
    (tmp_path / "machine.toml").write_text(MACHINE)
    for name, columns in tables.items():
        (tmp_path / "logs" / name).mkdir(parents=True, exist_ok=True)
        pd.DataFrame(columns).to_csv(tmp_path / f"logs/{name}/log.csv", index=False)
    return ingest(tmp_path / "logs", tmp_path / "ws", machine=tmp_path / "machine.toml")


def counts(dataset: Dataset, signal: str, recording: str = "run") -> SampleCounts:
    return stored_counts(dataset.quality["streams"][recording][f"log.csv/{signal}"])


def parts_of(found: SampleCounts) -> int:
    return (
        found.empty + found.overflows + found.repeated + found.conflicting + found.turns
        + found.outside + found.between + found.alone + found.used
    )  # fmt: skip


def smooth(times: np.ndarray) -> np.ndarray:
    return np.sin(1.3 * times) + 0.2 * np.sin(4.1 * times + 0.5)


@pytest.mark.parametrize("kept", [3, *(pytest.param(kept, marks=pytest.mark.slow) for kept in (1, 2, 7, 10, 40))])
@given(phase=st.integers(0, 39), late=st.floats(0.0, 9e-3))
def test_a_signal_has_the_rate_of_its_own_samples(
    tmp_path_factory: pytest.TempPathFactory, kept: int, phase: int, late: float
) -> None:
    """A column that is filled in every k-th row is interpolated between its own samples, at any phase of the stamps."""
    times = late + np.arange(8000) / 1000.0
    joint = smooth(times)
    joint[(np.arange(8000) - phase) % kept != 0] = np.nan
    command = np.sign(np.sin(times))
    dataset = ingested(tmp_path_factory.mktemp("sparse"), {"run": {"time": times, "ram.command": command, "ram.joint": joint}})
    found = counts(dataset, "ram.joint")
    assert parts_of(found) == found.rows == 8000
    assert (found.samples, found.used, found.alone) == (int(np.isfinite(joint).sum()),) * 2 + (0,)
    table = dataset.recordings[0]
    values = table.values("ram.joint")
    inside = (table.values("time") >= 0.08) & (table.values("time") <= 7.9)
    assert not np.isnan(values[inside]).any()
    np.testing.assert_allclose(values[inside], smooth(late + table.values("time"))[inside], atol=4e-3)


@given(data=st.data())
def test_the_counts_add_up_whatever_the_rows_hold(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    rows, rate = data.draw(st.integers(60, 4000)), data.draw(st.sampled_from([3.0, 20.0, 100.0, 130.0, 1000.0]))
    times = np.arange(rows) / rate
    for _ in range(data.draw(st.integers(0, 2))):  # pauses
        times[rng.integers(1, rows) :] += rng.uniform(0.0, 30.0)
    values = smooth(times)
    values[rng.random(rows) < data.draw(st.sampled_from([0.0, 0.1, 0.7]))] = np.nan
    values[rng.random(rows) < data.draw(st.sampled_from([0.0, 0.02]))] = 1e300
    values[:2] = 0.5, 0.6
    again = rng.random(rows) < data.draw(st.sampled_from([0.0, 0.3]))
    again[:3] = False
    stamps = times.copy()
    for row in np.flatnonzero(again):
        stamps[row] = stamps[row - 1]
        if rng.random() < 0.5:
            values[row] = values[row - 1]
    table = {"time": stamps, "ram.command": np.sign(np.sin(times)), "ram.joint": values}
    dataset = ingested(tmp_path_factory.mktemp("rows"), {"run": table})
    for signal in ("ram.command", "ram.joint"):
        found = counts(dataset, signal)
        assert parts_of(found) == found.rows == rows
        assert min(getattr(found, name) for name in SampleCounts.__dataclass_fields__) >= 0
    found = counts(dataset, "ram.joint")
    assert found.empty + found.overflows == int(np.count_nonzero(~(np.abs(values) < 1e15)))
    assert {row[0] for row in sample_table(dataset).rows} == {"ram.command", "ram.joint"}
    lost = found.used < 0.95 * (found.samples - found.between)
    assert any("ram.joint:samples" in finding.keys for finding in check_plausibility(dataset)) == lost


def test_stamps_that_are_coarser_than_the_rows_are_severe_and_repeated_messages_are_not(tmp_path: Path) -> None:
    times = np.arange(3000) / 100.0
    joint, command = smooth(times), np.sign(np.sin(times))
    coarse = ingested(tmp_path / "coarse", {"run": {"time": np.floor(times), "ram.command": command, "ram.joint": joint}})
    finding = next(f for f in check_plausibility(coarse) if "ram.joint:samples" in f.keys)
    assert finding.severity == "severe"
    assert "2970 with the stamp of another" in finding.evidence[0].text
    assert "`rate_hz`" in finding.causes[0].remedy
    twice = {"time": np.repeat(times, 2), "ram.command": np.repeat(command, 2), "ram.joint": np.repeat(joint, 2)}
    repeated = ingested(tmp_path / "twice", {"run": twice})
    found = counts(repeated, "ram.joint")
    assert (found.rows, found.repeated, found.samples, found.conflicting) == (6000, 3000, 3000, 0)
    assert not any("ram.joint:samples" in f.keys for f in check_plausibility(repeated))


def test_guards_and_pauses_have_reasons_of_their_own(tmp_path: Path) -> None:
    """Single samples in a pause are alone; those that the guards leave out are all that lie in no block."""
    times = np.concatenate([np.arange(3000) / 100.0, [40.0037, 70.0037, 71.5037], 100.0 + np.arange(3000) / 100.0])
    command = np.sign(np.sin(0.7 * times))
    command[3000:3003] = np.nan
    dataset = ingested(tmp_path, {"run": {"time": times, "ram.command": command, "ram.joint": smooth(times)}})
    found = counts(dataset, "ram.joint")
    assert (parts_of(found), found.alone, found.outside) == (found.rows, 3, 0)
    assert 0 < found.between < 400
    assert found.used + found.between == len(times) - 3
    (row,) = (row for row in sample_table(dataset).rows if row[0] == "ram.joint")
    assert row[-1] == f"{found.between} in guards between blocks, 3 alone between gaps"


def test_samples_alone_between_gaps_are_counted_with_their_remedy(tmp_path: Path) -> None:
    times = np.concatenate([np.arange(700) / 100.0, 7.0 + np.arange(1, 600) * 0.2013])
    table = {"time": times, "ram.command": np.sign(np.sin(times)), "ram.joint": smooth(times)}
    dataset = ingested(tmp_path, {"run": table})
    finding = next(f for f in check_plausibility(dataset) if "ram.joint:samples" in f.keys)
    assert finding.severity == "notice"
    assert "alone between gaps" in finding.evidence[0].text
    assert "`max_gap_s`" in finding.causes[0].remedy


def test_a_recording_is_cut_at_its_pause(tmp_path: Path) -> None:
    """No block contains the pause, all have a value in nearly every row, and no sample outside the guards is left out."""
    times = np.concatenate([np.arange(3000) / 100.0, 150.0 + np.arange(3000) / 100.0])
    command = np.sign(np.sin(0.7 * times))
    dataset = ingested(tmp_path, {"run": {"time": times, "ram.command": command, "ram.joint": smooth(times)}})
    assert {dataset.splits[recording.name] for recording in dataset.recordings} == {"fit", "select", "held_out"}
    for recording in dataset.recordings:
        assert np.isnan(recording.values("ram.joint")).mean() < 0.05
        assert len(recording) > 400
    found = counts(dataset, "ram.joint")
    assert (found.outside, found.alone) == (0, 0)
    assert found.between <= 200


@pytest.mark.parametrize("tasks", [False, True])
def test_copies_get_no_role(tmp_path: Path, tasks: bool) -> None:
    from sysid.execution import LocalExecutor

    times = np.arange(1000) / 100.0
    tables = {
        name: {"time": times, "ram.command": np.sign(np.sin(times + seed)), "ram.joint": smooth(times + seed)}
        for name, seed in (("a", 0), ("b", 0), ("c", 1), ("d", 2), ("e", 0))
    }
    ingested(tmp_path, tables)
    executor = LocalExecutor() if tasks else None
    dataset = ingest(tmp_path / "logs", tmp_path / "other", machine=tmp_path / "machine.toml", executor=executor)
    assert dataset.splits == {"a": "fit", "c": "select", "d": "held_out"}
    assert [note for note in dataset.quality["notes"] if "copy" in note] == [
        "b has the same samples as a: a copy gets no role",
        "e has the same samples as a: a copy gets no role",
    ]
    (tmp_path / "logs/recipe.toml").write_text(
        'schema = 1\n[splits]\nfit = ["a"]\nheld_out = ["b"]\n[[streams]]\nfiles = "log.csv"\n[streams.signals]\n'
        '"ram.command" = { field = "ram.command" }\n"ram.joint" = { field = "ram.joint" }\n'
    )
    with pytest.raises(SettingsError, match="'b' is held_out and has the samples of 'a'"):
        ingest(tmp_path / "logs", tmp_path / "more", machine=tmp_path / "machine.toml")


@pytest.mark.parametrize("name", LOGS)
def test_every_reader_accounts_for_its_rows(tmp_path: Path, name: str) -> None:
    """Every numeric field of every format: the samples are the rows without those that are counted as something else."""
    if LOGS[name][0] in ("ulog", "ardupilot"):
        pytest.importorskip({"ulog": "pyulog", "ardupilot": "pymavlink"}[LOGS[name][0]])
    (tmp_path / "machine.toml").write_text(MACHINE)
    machine, path = load_machine(tmp_path / "machine.toml"), write_log(tmp_path, name)
    stated: dict[str, Any] = STATED.get(name, {})
    streams = reader_named(LOGS[name][0], path).read(path, ReadOptions(**stated))
    checked = 0
    for stream in streams:
        for field, values in stream.columns.items():
            topic = stream.name if len(streams) > 1 or LOGS[name][0] not in ("csv", "parquet", "mat", "npz") else None
            entry = SignalMap(topic=topic, field=field, scale=2.0, unit="rad")
            mapping = StreamMap(files=name, reader=LOGS[name][0], signals={"ram.joint": entry}, **stated)
            reading = read_channels(RecordingFiles("run", "motion", tmp_path, ((path, mapping),)), machine, {})
            if reading.refused:
                (error,) = reading.refused.values()
                assert any(why in str(error) for why in ("no number", "two at least", "in others")), error
                continue
            (channel,) = reading.channels
            counts = channel.counts
            assert counts.rows == len(values)
            assert counts.empty == int(np.count_nonzero(np.isnan(values)))
            gone = counts.empty + counts.overflows + counts.repeated + counts.conflicting
            assert len(channel.stamps) == counts.rows - gone
            checked += 1
    assert checked
