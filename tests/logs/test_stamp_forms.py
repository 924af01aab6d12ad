"""Time columns of every table format: whole numbers, dates, durations, days; and what is no time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from sysid.datasets.clocks.set_clocks import WRAPS, continued
from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for, reader_named
from sysid.logs.reader import ALL

Stamps = npt.NDArray[np.int64]
NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def read(path: Path, options: ReadOptions = ALL) -> Stream:
    reader = reader_named("json", path) if path.suffix == ".json" else reader_for(path)
    (stream,) = reader.read(path, options)
    return stream


def _x(stamps: Stamps) -> npt.NDArray[np.float64]:
    return np.arange(0.5, len(stamps), 1.0, dtype=np.float64)


def _csv(path: Path, stamps: Stamps, unit: str) -> Path:
    pd.DataFrame({f"time [{unit}]": stamps // NS[unit], "x": _x(stamps)}).to_csv(path, index=False)
    return path


def _csv_dates(path: Path, stamps: Stamps, unit: str) -> Path:
    zone = 3600 * 10**9 if unit == "ms" else 0
    times = np.datetime_as_string((stamps + zone).view("M8[ns]").astype(f"M8[{unit}]"))
    texts = [f"{text}{'+01:00' if zone else ''}" for text in times]
    pd.DataFrame({"time": texts, "x": _x(stamps)}).to_csv(path, index=False)
    return path


def _parquet(path: Path, stamps: Stamps, unit: str) -> Path:
    pq.write_table(pa.table({f"time [{unit}]": stamps // NS[unit], "x": _x(stamps)}), path, row_group_size=7)
    return path


def _parquet_dates(path: Path, stamps: Stamps, unit: str) -> Path:
    kind = pa.timestamp(unit, tz="Europe/Berlin" if unit in ("us", "ns") else None)
    pq.write_table(pa.table({"time": pa.array(stamps // NS[unit]).cast(kind), "x": _x(stamps)}), path, row_group_size=7)
    return path


def _parquet_durations(path: Path, stamps: Stamps, unit: str) -> Path:
    pq.write_table(pa.table({"time": pa.array(stamps // NS[unit]).cast(pa.duration(unit)), "x": _x(stamps)}), path)
    return path


def _parquet_index(path: Path, stamps: Stamps, unit: str) -> Path:
    index = pd.DatetimeIndex(stamps.view("M8[ns]"), name="time" if unit == "s" else None)
    pd.DataFrame({"x": _x(stamps)}, index=index).to_parquet(path)
    return path


def _npz(path: Path, stamps: Stamps, unit: str) -> Path:
    np.savez(path, time=stamps.view("M8[ns]").astype(f"M8[{unit}]"), x=_x(stamps))
    return path


def _npz_whole(path: Path, stamps: Stamps, unit: str) -> Path:
    np.savez(path, time=stamps, x=_x(stamps))
    return path


def _mat(path: Path, stamps: Stamps, unit: str) -> Path:
    savemat(path, {"time": stamps[:, None], "x": _x(stamps)[:, None]})
    return path


def _json(path: Path, stamps: Stamps, unit: str) -> Path:
    path.write_text(json.dumps([{"time": stamp, "x": x} for stamp, x in zip(stamps.tolist(), _x(stamps), strict=True)]))
    return path


def _json_dates(path: Path, stamps: Stamps, unit: str) -> Path:
    texts = np.datetime_as_string(stamps.view("M8[ns]"))
    path.write_text(json.dumps([{"time": f"{text}Z", "x": x} for text, x in zip(texts, _x(stamps), strict=True)]))
    return path


WRITERS: dict[str, tuple[Callable[[Path, Stamps, str], Path], str]] = {
    "CSV, whole numbers": (_csv, "csv"),
    "CSV, dates": (_csv_dates, "csv"),
    "Parquet, whole numbers": (_parquet, "parquet"),
    "Parquet, timestamps": (_parquet_dates, "parquet"),
    "Parquet, durations": (_parquet_durations, "parquet"),
    "Parquet, index of pandas": (_parquet_index, "parquet"),
    "NumPy, datetime64": (_npz, "npz"),
    "NumPy, whole numbers": (_npz_whole, "npz"),
    "MATLAB, whole numbers": (_mat, "mat"),
    "JSON, whole numbers": (_json, "json"),
    "JSON, dates": (_json_dates, "json"),
}
WITHOUT_UNIT = (_npz_whole, _mat, _json)


@settings(max_examples=examples(200), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    writer=st.sampled_from(sorted(WRITERS)),
    unit=st.sampled_from(sorted(NS)),
    start=st.one_of(st.integers(0, 10**6), st.integers(1_700_000_000 * 10**9, 1_800_000_000 * 10**9)),
    steps=st.lists(st.integers(1, 10**6), min_size=2, max_size=30),
)
def test_whole_stamps_and_dates_are_exact_in_every_format(
    tmp_path: Path, writer: str, unit: str, start: int, steps: list[int]
) -> None:
    """Format × resolution × epoch: no stamp goes through a float, which in 2023 resolves 256 ns."""
    stamps = (start // NS[unit] + np.cumsum([0, *steps])) * NS[unit]
    write, suffix = WRITERS[writer]
    path = write(tmp_path / f"log.{suffix}", stamps.astype(np.int64), unit)
    stated = "ns" if write in WITHOUT_UNIT else unit if write in (_csv, _parquet) else None
    stream = read(path, ReadOptions(time_unit=stated))
    np.testing.assert_array_equal(stream.stamps["time"], stamps)
    np.testing.assert_array_equal(stream.columns["x"], _x(stamps))
    assert stream.losses == ()


@given(
    wrap=st.sampled_from(sorted(WRAPS)),
    share=st.floats(0.05, 0.95),
    period=st.integers(10**5, 10**8),
    start=st.integers(0, 3),
)
def test_clocks_that_roll_over_are_continued(wrap: int, share: float, period: int, start: int) -> None:
    """A counter, midnight or a GPS week, anywhere in the log; the step is named by its cause."""
    rows = max(400, 4 * 10**9 // period)
    if wrap < 2 * rows * period:
        return  # rolls over again at once, or by less than a late message
    first = (start + 1) * wrap - round(share * rows) * period - period // 3
    true = first + np.arange(rows, dtype=np.int64) * period
    found = continued(true % wrap)
    np.testing.assert_array_equal(np.diff(found.stamps), period)
    assert found.periods_ns == (wrap,)
    assert f"({WRAPS[wrap]}): continued" in found.texts[0]


@pytest.mark.parametrize(
    ("times", "why"),
    [
        ([f"23:59:59.{9000 + k}" for k in range(0, 1000, 100)] + [f"00:00:00.{k:04}" for k in range(0, 1000, 100)], "midnight"),
        ([604_799.9 + 0.01 * k for k in range(10)] + [0.01 * k for k in range(10)], "a new GPS week"),
    ],
)
def test_midnight_and_gps_weeks(tmp_path: Path, times: list[object], why: str) -> None:
    path = tmp_path / "log.csv"
    pd.DataFrame({"time": times, "x": np.arange(len(times))}).to_csv(path, index=False)
    found = continued(read(path).stamps["time"])
    np.testing.assert_allclose(np.diff(found.stamps), 10_000_000, atol=100)
    assert why in found.texts[0]


@pytest.mark.parametrize(("origin", "calendar"), [(25_569.0, "spreadsheet"), (719_529.0, "datenum")])
@pytest.mark.parametrize("suffix", ["csv", "mat", "parquet"])
def test_days_of_spreadsheets_and_matlab_are_dates(tmp_path: Path, origin: float, calendar: str, suffix: str) -> None:
    seconds = 1_772_366_400.0 + np.arange(200) / 50.0
    days = origin + seconds / 86400.0
    path = tmp_path / f"log.{suffix}"
    if suffix == "csv":
        pd.DataFrame({"time": days, "x": 1.0}).to_csv(path, index=False)
    elif suffix == "mat":
        savemat(path, {"time": days, "x": np.ones(200)})
    else:
        pd.DataFrame({"time": days, "x": 1.0}).to_parquet(path)
    with pytest.raises(InputError, match=r"stamps of no stated unit.*expected day \(50.* Hz.*`time_unit = \"day\"`"):
        read(path)
    stream = read(path, ReadOptions(time_unit="day"))
    np.testing.assert_allclose(stream.stamps["time"] * 1e-9 - 1_772_366_400.0, seconds - seconds[0], atol=2e-5)
    assert calendar in stream.losses[0]
    assert "taken as dates in UTC" in stream.losses[0]


def test_days_from_any_other_origin_stay(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    pd.DataFrame({"time [day]": np.arange(20) / 86400.0, "x": 1.0}).to_csv(path, index=False)
    stream = read(path)
    np.testing.assert_allclose(stream.stamps["time"], 10**9 * np.arange(20), atol=1)
    assert stream.losses == ()


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rate=st.integers(20, 2000),
    start=st.sampled_from([0, 12, 1_700_000_000]),
    phase=st.integers(0, 10**6),
    padded=st.booleans(),
    late=st.integers(0, 3),
)
def test_unpadded_nanoseconds_are_refused(tmp_path: Path, rate: int, start: int, phase: int, padded: bool, late: int) -> None:
    stamps = start * 10**9 + phase + np.arange(10 * rate, dtype=np.int64) * (10**9 // rate)
    texts = [f"{stamp // 10**9}.{stamp % 10**9:09}" if padded else f"{stamp // 10**9}.{stamp % 10**9}" for stamp in stamps]
    for row in range(late):  # late messages are none of this
        texts[5 + 7 * row], texts[6 + 7 * row] = texts[6 + 7 * row], texts[5 + 7 * row]
    path = tmp_path / "log.csv"
    path.write_text("time,x\n" + "".join(f"{text},{row}\n" for row, text in enumerate(texts)))
    if padded:
        assert len(read(path)) == len(stamps)
    elif not late:
        with pytest.raises(InputError, match=r"in each to its first tenth, as nanoseconds without leading zeros"):
            read(path)


@pytest.mark.parametrize("text", ["03/01/2026 12:00:00.5", "12:00:00.5 PM", "1. März 2026, 12:00", "yesterday"])
@pytest.mark.parametrize("suffix", ["csv", "parquet", "json"])
def test_a_time_in_words_is_refused_with_an_example(tmp_path: Path, text: str, suffix: str) -> None:
    path = tmp_path / f"log.{suffix}"
    table = pd.DataFrame({"time": [text] * 5, "x": 1.0})
    if suffix == "csv":
        table.to_csv(path, index=False)
    elif suffix == "parquet":
        table.to_parquet(path)
    else:
        path.write_text(table.to_json(orient="records"))
    with pytest.raises(
        InputError, match=r"column 'time': text, for example .*dates with time in ISO 8601.*Write the time as"
    ) as e:
        read(path)
    assert repr(text) in str(e.value)


def test_the_only_column_of_dates_is_the_time(tmp_path: Path) -> None:
    dates = pd.date_range("2026-03-01", periods=5, freq="10ms")
    table = pd.DataFrame({"when": dates, "x": 1.0})
    table.to_parquet(tmp_path / "one.parquet")
    table.to_csv(tmp_path / "one.csv", index=False)
    for name in ("one.parquet", "one.csv"):
        np.testing.assert_array_equal(read(tmp_path / name).stamps["time"], dates.astype("M8[ns]").astype(np.int64))
    table.assign(other=dates).to_parquet(tmp_path / "two.parquet")
    with pytest.raises(InputError, match="no time column; expected a column named 'time'; found when, x, other"):
        read(tmp_path / "two.parquet")
    table.assign(time=np.arange(5.0)).to_parquet(tmp_path / "beside.parquet")
    stream = read(tmp_path / "beside.parquet")
    np.testing.assert_array_equal(stream.stamps["time"], 10**9 * np.arange(5))
    assert stream.unread == {"when": "dates or times, which only a time column has"}
