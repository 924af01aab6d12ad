"""Tables without and with a recipe: the same stamps, the same losses, and no signal left out in silence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import run

from sysid.datasets import Dataset, ingest
from sysid.errors import InputError

MACHINE = """schema = 1
name = "demo"
rate_hz = 100.0
[[axes]]
name = "a"
actuation = "velocity"
drives = "joint"
limits = [-9.0, 9.0]
"""
RECIPE = """schema = 1
[[streams]]
files = "*.csv"
time = "time"
[streams.signals]
"a.command" = { field = "a.command" }
"a.joint" = { field = "a.joint" }
"""
TIME = np.arange(3000) / 100.0
COMMAND = np.sin(TIME) * np.sin(0.3 * TIME)
JOINT = np.cumsum(COMMAND) / 100.0


def folder(path: Path, time: object, header: str = "time", **more: object) -> Path:
    (path / "r").mkdir(parents=True)
    (path / "machine.toml").write_text(MACHINE)
    table = pd.DataFrame({header: time, "a.command": COMMAND, "a.joint": JOINT, **more})
    table.to_csv(path / "r/log.csv", index=False)
    return path


def stored(dataset: Dataset) -> pd.DataFrame:
    return pd.concat([recording.table for recording in dataset.recordings])


def losses(dataset: Dataset) -> tuple[str, ...]:
    return dataset.sources[0].losses


#: Why → stamps as they are logged, and the header of their column.
CLOCKS: dict[str, tuple[Callable[[], object], str]] = {
    "32 bits of microseconds": (lambda: (4_280_000_000 + np.rint(1e6 * TIME).astype(np.int64)) % 2**32, "time [us]"),
    "16 bits of milliseconds": (lambda: (60_000 + np.rint(1e3 * TIME).astype(np.int64)) % 2**16, "time [ms]"),
    "midnight": (lambda: pd.date_range("2026-03-01 23:59:45", periods=3000, freq="10ms").strftime("%H:%M:%S.%f"), "time"),
    "GPS week": (lambda: np.round((604_790.0 + TIME) % 604_800.0, 3), "time [s]"),
    "a stray stamp": (lambda: np.where(np.arange(3000) == 700, 1e8, TIME), "time [s]"),
    "whole seconds": (lambda: np.floor(TIME), "time [s]"),
    "float32": (lambda: (1e6 + TIME).astype(np.float32).astype(np.float64), "time [s]"),
}  # fmt: skip


@pytest.mark.parametrize("why", CLOCKS)
def test_a_recipe_changes_nothing_about_stamps(tmp_path: Path, why: str) -> None:
    stamps, header = CLOCKS[why]
    path = folder(tmp_path / "logs", stamps(), header)
    plain = ingest(path, tmp_path / "plain")
    (path / "recipe.toml").write_text(RECIPE)
    mapped = ingest(path, tmp_path / "mapped")
    pd.testing.assert_frame_equal(stored(plain), stored(mapped))
    assert losses(plain) == losses(mapped)
    np.testing.assert_equal(plain.quality["streams"], mapped.quality["streams"])  # also NaN
    assert len(losses(plain)) == (0 if why in ("whole seconds", "float32") else 1)


def test_rows_of_equal_stamps_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder(tmp_path / "logs", np.floor(TIME))
    assert run("--workspace", tmp_path / "ws", "ingest", path) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "2970 with the stamp of another" in out
    assert "state `rate_hz` there in place of `time`" in out
    (path / "recipe.toml").write_text(RECIPE.replace('time = "time"', "rate_hz = 100.0"))
    read = ingest(path, tmp_path / "again")
    assert losses(read) == ()
    assert len(stored(read)) > 2500


#: What a column of a signal has instead of numbers → as values of Arrow, or None where only CSV has it.
TEXTS: dict[str, tuple[list[object], pa.DataType | None, str]] = {
    "hexadecimal": ([f"0x{k % 256:02X}" for k in range(3000)], pa.string(), "text, for example '0x00'"),
    "words": (["up", "down"] * 1500, pa.string(), "text, for example 'up'"),
    "categories": (["up", "down"] * 1500, pa.dictionary(pa.int8(), pa.string()), "text, for example 'up'"),
    "two units": (["1 mm", "2 mm", "3"] * 1000, None, r"2000 numbers with the unit \[mm\] and 1000 without"),
    "lists": ([[1.0, 2.0]] * 3000, pa.list_(pa.float64()), "values of type list<element: double>"),
    "records": ([{"x": 1.0}] * 3000, pa.struct({"x": pa.float64()}), "values of type struct<x: double>"),
    "dates": (list(pd.date_range("2026-01-01", periods=3000, freq="s")), pa.timestamp("us"), "dates or times"),
    "bytes": ([b"1"] * 3000, pa.binary(), "values of type binary"),
}


@pytest.mark.parametrize("what", TEXTS)
def test_a_signal_without_numbers_is_refused_and_another_column_is_said(tmp_path: Path, what: str) -> None:
    values, kind, reason = TEXTS[what]
    for suffix in ("csv", "parquet"):
        if (suffix == "parquet" and kind is None) or (suffix == "csv" and what in ("lists", "records", "bytes")):
            continue
        for name in ("a.joint", "note"):
            path = folder(tmp_path / f"{suffix}-{name}", TIME)
            table = pd.read_csv(path / "r/log.csv").assign(**{name: 0.0})
            if suffix == "csv":
                table.assign(**{name: pd.Series(values)}).to_csv(path / "r/log.csv", index=False)
            else:
                (path / "r/log.csv").unlink()
                columns = {column: pa.array(table[column]) for column in table}
                pq.write_table(pa.table({**columns, name: pa.array(values, kind)}), path / "r/log.parquet")
            if name == "note":
                assert any("column 'note' left out: " in loss for loss in losses(ingest(path, tmp_path / f"ws-{suffix}")))
                continue
            with pytest.raises(
                InputError, match=rf"log\.{suffix}: column 'a\.joint': {reason}.*; expected numbers\. Export it"
            ):
                ingest(path, tmp_path / "ws")


@pytest.mark.parametrize("kind", [pa.decimal128(20, 9), pa.float32(), pa.dictionary(pa.int16(), pa.float64())])
def test_numbers_of_any_type_of_parquet_are_read(tmp_path: Path, kind: pa.DataType) -> None:
    path = folder(tmp_path / "logs", TIME)
    (path / "r/log.csv").unlink()
    joint = pa.array(np.round(JOINT, 6))
    joint = joint.dictionary_encode() if pa.types.is_dictionary(kind) else joint.cast(kind, safe=False)
    pq.write_table(pa.table({"time": TIME, "a.command": COMMAND, "a.joint": joint}), path / "r/log.parquet")
    np.testing.assert_allclose(stored(ingest(path, tmp_path / "ws"))["a.joint"].max(), JOINT.max(), atol=1e-6)


@pytest.mark.parametrize("cell", ["inf", "-Infinity", "1e300", "1e400", "-1e16", "1.#INF", "NAN", "ERR"])
def test_what_is_no_value_is_missing_at_every_stage(tmp_path: Path, cell: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder(tmp_path / "logs", TIME)
    lines = (path / "r/log.csv").read_text().splitlines()
    for row in (100, 101, 2000):
        lines[row] = ",".join([*lines[row].split(",")[:2], cell])
    (path / "r/log.csv").write_text("\n".join(lines) + "\n")
    assert run("--workspace", tmp_path / "ws", "ingest", path) == 0
    out = capsys.readouterr().out
    assert "3 overflows" in out or "3 cells are not numbers" in " ".join(out.split())
    assert run("--workspace", tmp_path / "ws", "datasets", "demo@1", "--quality") == 0
    assert run("ingest", "--inspect", path) == 0
    assert "e+" not in capsys.readouterr().out
