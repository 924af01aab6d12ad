"""Plain tables: CSV, Parquet, MATLAB."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from sysid.errors import InputError, SettingsError
from sysid.logs import ReadOptions, Stream, reader_for, reader_named
from sysid.logs.csv import CsvReader
from sysid.logs.limits import Budget
from sysid.logs.table import CUT_ROW, to_ns


def read(path: Path, **options: str) -> Stream:
    (stream,) = reader_for(path).read(path, ReadOptions(**options))  # type: ignore[arg-type]
    return stream


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_csv_with_units_gaps_and_labels(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "wires.csv"
    rows = ["time [ms]|boom.cylinder [mm]|note", "0|1.5|start", "10||", "20|2.5|end"]
    path.write_text("# a remark\n" + "\n".join(rows).replace("|", separator) + "\n", encoding="utf-8-sig")
    stream = read(path)
    np.testing.assert_array_equal(stream.stamps["time"], [0, 10_000_000, 20_000_000])
    np.testing.assert_array_equal(stream.columns["boom.cylinder"], [1.5, np.nan, 2.5])
    assert stream.units == {"boom.cylinder": "mm"}
    assert set(stream.columns) == {"boom.cylinder"}


def test_cells_that_are_no_numbers_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,x\n0,1\n1,ERR\n2,3\n")
    stream = read(path)
    assert stream.losses == ("a.csv: column 'x': 1 cell is not a number, for example 'ERR': taken as missing",)
    np.testing.assert_array_equal(stream.columns["x"], [1.0, np.nan, 3.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"a\.csv: the file is empty"),
        ("\n\n", "no header row"),
        ("time,x\n", "a header but no rows"),
        ("x,y\n1,2\n", "no time column; expected a column named 'time'; found x, y"),
        ("time,x\n0,1\n,2\n", "no time in row 2"),
        ("time,x,x\n0,1,2\n", "two columns are named 'x'"),
        ("time [m],x\n0,1\n", r"a unit of \[m\]; expected a unit of time"),
    ],
)
def test_what_is_no_table_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read(path)


def test_an_unknown_time_column_suggests_the_nearest(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Tme,x\n0,1\n")
    with pytest.raises(InputError, match=r"no time column 'Time'; expected 'Tme'\?"):
        read(path, time="Time")


def test_parquet_is_read_like_csv(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pd.DataFrame({"time": [0.0, 0.5], "boom.joint [deg]": [1.0, np.nan], "label": ["a", "b"]}).to_parquet(path)
    stream = read(path)
    np.testing.assert_array_equal(stream.columns["boom.joint"], [1.0, np.nan])
    assert stream.units == {"boom.joint": "deg"}
    path.write_bytes(b"no parquet at all")
    with pytest.raises(InputError, match="not readable as Parquet"):
        read(path)


def test_matlab_vectors_structures_and_matrices(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    time = np.array([[0.0], [0.1], [0.2]])
    savemat(path, {"t": time, "log": {"u": time * 2}, "q": np.hstack([time, -time]), "gain": 3.0, "other": np.ones(7)})
    stream = read(path)
    assert set(stream.columns) == {"log.u", "q[0]", "q[1]"}
    np.testing.assert_allclose(stream.columns["q[1]"], [0.0, -0.1, -0.2])
    path.write_bytes(b"x" * 200)
    with pytest.raises(InputError, match="not readable as a MATLAB file"):
        read(path)


def test_real_matlab_file(shared_data: Path) -> None:
    stream = read(shared_data / "emps/DATA_EMPS.mat")
    assert len(stream) == 24841
    assert {"qm", "vir", "qg"} <= set(stream.columns)
    assert stream.stamps["time"][1] == pytest.approx(1_000_020, abs=20)


@given(st.lists(st.integers(0, 4 * 10**18), min_size=1, max_size=20))
def test_stamps_in_seconds_keep_the_precision_of_a_float(stamps: list[int]) -> None:
    seconds = np.array(stamps, dtype=np.int64) * 1e-9
    error = np.abs(to_ns(seconds, 1.0, "test") - np.array(stamps))
    assert np.all(error <= 2.0 * np.spacing(seconds) * 1e9 + 1)


def test_whole_units_are_converted_without_rounding() -> None:
    milliseconds = np.array([1_700_000_000_001.0, 1_700_000_000_002.5])
    np.testing.assert_array_equal(to_ns(milliseconds, 1e-3, "test"), [1_700_000_000_001_000_000, 1_700_000_000_002_500_000])
    with pytest.raises(InputError, match=r"test: a time of 1\.7e\+18 s; expected times that fit into 64 bits"):
        to_ns(np.array([1.7e18]), 1.0, "test")


def test_a_row_longer_than_the_header_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,x\n0,1\n1,2,3\n")
    with pytest.raises(InputError, match="line 3: 3 values; expected 2, as many as the header in line 1"):
        read(path)


def test_tables_of_more_numbers_than_are_read_are_refused(tmp_path: Path) -> None:
    small = ReadOptions(budget=replace(Budget.of(1), memory=160_000))  # 10 000 numbers
    table = pd.DataFrame({"time": np.arange(6000.0), "x": np.zeros(6000)})
    savemat(tmp_path / "a.mat", {name: table[name].to_numpy() for name in table}, do_compression=True)
    table.to_parquet(tmp_path / "a.parquet")
    for name in ("a.mat", "a.parquet"):
        path = tmp_path / name
        with pytest.raises(InputError, match=rf"{name}: 12000 numbers; expected at most 10000 numbers. Name fewer signals"):
            reader_for(path).read(path, small)
        (stream,) = reader_for(path).read(path, replace(small, columns=frozenset({"x"}), rate_hz=1.0))
        assert (len(stream), list(stream.columns), stream.fields) == (6000, ["x"], ("time", "x"))


def test_lists_in_cells_become_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text('timestamp,positions [deg],q[0],q[1]\n0,"[1, 2.5]",5,6\n1,,7,8\n2,"[3, bad]",9,10\n')
    stream = read(path)
    np.testing.assert_array_equal(stream.columns["positions[0]"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(stream.columns["positions[1]"], [2.5, np.nan, np.nan])
    np.testing.assert_array_equal(stream.columns["q[1]"], [6.0, 8.0, 10.0])
    assert stream.units == {"positions[0]": "deg", "positions[1]": "deg"}
    assert stream.losses == ("a.csv: column positions[1]: 1 elements are not numbers",)


def test_lists_that_unpack_without_measure_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,q\n" + '0,"[1]"\n' * 99 + '1,"[' + "," * 99 + ']"\n')
    small = replace(Budget.of(1), memory=9999 * 16)
    with pytest.raises(InputError, match=r"a\.csv: q: 10000 numbers; expected at most 9999 numbers"):
        CsvReader().read(path, ReadOptions(budget=small))
    with pytest.raises(InputError, match=r"a\.csv: q: 100 elements of a list; expected at most 99 elements of a list"):
        CsvReader().read(path, ReadOptions(budget=replace(small, columns=99)))


def test_rows_without_stamps_are_spaced_by_the_stated_rate(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"X": np.arange(8.0).reshape(2, 4), "y": np.ones((1, 4)), "gain": 3.0})
    (stream,) = reader_for(path).read(path, ReadOptions(rate_hz=30.0))
    np.testing.assert_array_equal(stream.stamps["time"], [0, 33_333_333, 66_666_667, 100_000_000])
    np.testing.assert_array_equal(stream.columns["X[1]"], [4.0, 5.0, 6.0, 7.0])
    with pytest.raises(InputError, match=r"no time column; .* or the rate of evenly spaced rows: `rate_hz = …`"):
        read(path)


def test_json_records_are_streams(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(
        '{"mass": 0.5, "log": [{"t": 0, "on": true, "arm": {"q": [1, null]}, "label": "x"}, {"t": 0.5, "arm": {"q": [2, 3]}}],'
        ' "other": [{"t": 1, "x": 1e400}]}'
    )
    log, other = reader_named("json", path).read(path, ReadOptions())
    assert (log.name, other.name) == ("log", "other")
    np.testing.assert_array_equal(log.stamps["time"], [0, 500_000_000])
    assert set(log.columns) == {"on", "arm.q[0]", "arm.q[1]"}
    np.testing.assert_array_equal(log.columns["arm.q[1]"], [np.nan, 3.0])
    np.testing.assert_array_equal(log.columns["on"], [1.0, np.nan])
    (alone,) = reader_named("json", path).read(path, ReadOptions(streams=frozenset({"other"})))
    np.testing.assert_array_equal(alone.columns["x"], [np.inf])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", r"a\.json: not readable as JSON \(Expecting property name"),
        ("\xff", "not readable as JSON"),
        ("[" * 100_000, r"not readable as JSON \(maximum recursion"),
        ('{"log": [1, 2]}', "no list of records; expected a list of objects with numbers"),
        ('[{"t": 0}, {"x": 1}]', "no time in row 2"),
    ],
)
def test_json_that_is_no_log_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=message):
        reader_named("json", path).read(path, ReadOptions())


def test_a_json_file_is_a_log_only_where_a_recipe_says_so() -> None:
    with pytest.raises(InputError, match="no log unless its reader is named"):
        reader_for(Path("a.json"))


def test_unknown_formats_and_readers() -> None:
    with pytest.raises(InputError, match=r"a spreadsheet; expected one of \.\w+, .*\.csv, .*Save the sheet as CSV"):
        reader_for(Path("a.xlsx"))
    with pytest.raises(SettingsError, match=r"unknown reader 'mcp'; expected 'mcap'\?"):
        reader_named("mcp", "recipe.toml")


def test_a_table_is_the_same_in_pieces_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    rows = [
        f'{0.1 * k},{k if k % 7 else ""},{k if k % 5 else "x"},"[{k}, {k + 1}]",name{k % 2},{"[1]" if k > 50 else k},'
        for k in range(100)
    ]
    path.write_text("time,a [mm],b,list,label,mixed,empty\n" + "\n".join(rows) + "\n1.5,2,3", "utf-8")
    table = CsvReader().table(path)
    whole, losses = table.numbers, table.losses
    names = [name for name, _ in whole]
    assert names == ["time", "a [mm]", "b", "list[0]", "list[1]", "mixed", "empty"]
    assert [loss.partition(": ")[2] for loss in losses] == [
        CUT_ROW,
        "column 'b': 20 cells are not numbers, for example 'x': taken as missing",
        "column 'mixed': 49 cells are not numbers, for example '[1]': taken as missing",
    ]  # fmt: skip
    assert all(len(values) == 100 for _, values in whole)
    for cells in (1, 70, 96, 500, 800):
        monkeypatch.setattr("sysid.logs.table.CELLS", cells)
        table = CsvReader().table(path)
        pieces, said = table.numbers, table.losses
        assert said == losses
        assert [name for name, _ in pieces] == names
        for (_, found), (_, expected) in zip(pieces, whole, strict=True):
            np.testing.assert_array_equal(found, expected)
    path.write_text(path.read_text("utf-8") + ",4,5,6,7\n9,9,9,9,9,9,9,9\n", "utf-8")
    with pytest.raises(InputError, match="line 103: 8 values; expected 7, as many as"):
        CsvReader().table(path)
