"""CSV files as loggers, spreadsheets and scripts write them: delimiters, decimal marks, encodings, units, ragged rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.inspection import inspect_file
from sysid.logs.reader import ALL
from sysid.logs.table import CUT_ROW


def read(path: Path, options: ReadOptions = ALL) -> Stream:
    (stream,) = reader_for(path).read(path, options)
    return stream


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


#: Form → its text and encoding; all have two rows: time 0 and 0.5 s, boom 1.5 and 2.5 mm.
FORMS = {
    "semicolons and decimal commas": ("time;boom [mm]\n0,0;1,5\n0,5;2,5\n", "utf-8"),
    "tabs and decimal commas": ("time\tboom [mm]\n0,0\t1,5\n0,5\t2,5\n", "utf-8"),
    "a spreadsheet's separator line": ("sep=;\r\ntime;boom [mm]\r\n0;1.5\r\n0.5;2.5\r\n", "utf-8"),
    "decimal commas in quotes": ('time,boom [mm]\n"0,0","1,5"\n"0,5","2,5"\n', "utf-8"),
    "UTF-16 of a spreadsheet": ("time\tboom [mm]\r\n0.0\t1.5\r\n0.5\t2.5\r\n", "utf-16"),
    "UTF-16 without a mark": ("time\tboom [mm]\r\n0.0\t1.5\r\n0.5\t2.5\r\n", "utf-16-le"),
    "a byte order mark": ("time,boom [mm]\n0,1.5\n0.5,2.5\n", "utf-8-sig"),
    "western letters in another column": ("time;boom [mm];Öl in °C\n0,0;1,5;20\n0,5;2,5;20\n", "latin-1"),
    "a row of units": ("time,boom,state\n[s],[mm],-\n0,1.5,a\n0.5,2.5,b\n", "utf-8"),
    "a row of units without brackets": ("time;boom\ns;mm\n0,0;1,5\n0,5;2,5\n", "utf-8"),
    "a row of types": ("time,boom [mm]\nfloat64,float64\n0,1.5\n0.5,2.5\n", "utf-8"),
    "remarks before, between and after": ("# rig 3\n# run 1\ntime,boom [mm]\n0,1.5\n# a, b, c, d\n0.5,2.5\n# end\n", "utf-8"),
    "a title and settings": ("Logger 2.1\nDate;2026-03-01\n\ntime;boom [mm]\n0,0;1,5\n0,5;2,5\n", "utf-8"),
    "white space": ("time boom\n  0.0   1.5\n  0.5   2.5\n", "utf-8"),
    "a header in a remark (numpy.savetxt)": ("# time,boom [mm]\n0.0,1.5\n0.5,2.5\n", "utf-8"),
    "bars": ("time|boom [mm]\n0|1.5\n0.5|2.5\n", "utf-8"),
    "a delimiter at the end of every row": ("time,boom [mm]\n0,1.5,\n0.5,2.5,\n", "utf-8"),
    "a delimiter at the end of every line": ("time,boom [mm],\n0,1.5,\n0.5,2.5,\n", "utf-8"),
    "a delimiter at the end of the header": ("time,boom [mm],\n0,1.5\n0.5,2.5\n", "utf-8"),
    "empty rows of a spreadsheet": ("time,boom [mm]\n0,1.5\n,\n0.5,2.5\n,\n,\n", "utf-8"),
    "the header again after a restart": ("time,boom [mm]\n0,1.5\ntime,boom [mm]\n0.5,2.5\n", "utf-8"),
    "other delimiters in quotes": ('time,boom [mm],note\n0,1.5,"a;b;c"\n0.5,2.5,"d;e;f"\n', "utf-8"),
    "dates with time": ("time,boom [mm]\n2026-03-01T12:00:00.0,1.5\n2026-03-01T12:00:00.5,2.5\n", "utf-8"),
    "times of the day": ("time;boom [mm]\n12:00:00,0;1,5\n12:00:00,5;2,5\n", "utf-8"),
    "whole numbers first": ("time;boom [mm]\n0;1,5\n0,5;2,5\n", "utf-8"),
    "many columns without values": ("time\tboom [mm]\ta\tb\tc\n0,0\t1,5\t\t\t\n0,5\t2,5\t\t\t\n", "utf-8"),
    "line ends of old systems": ("time,boom [mm]\r0,1.5\r0.5,2.5\r", "utf-8"),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_form_of_a_file_is_found(tmp_path: Path, form: str) -> None:
    stream = read(write(tmp_path / "log.csv", *FORMS[form]))
    stamps = stream.stamps["time"]
    np.testing.assert_allclose(stamps - stamps[0], [0, 500_000_000], atol=500)
    np.testing.assert_array_equal(stream.columns["boom"], [1.5, 2.5])
    assert stream.units.get("boom") == (None if form == "white space" else "mm")


def test_what_was_found_is_shown(tmp_path: Path) -> None:
    summary = inspect_file(write(tmp_path / "log.csv", "x;Öl\ns;bar\n0,5;1\n1,0;2\n", "latin-1"))
    assert summary.remarks == ("text in cp1252", "cells separated by ';'", "decimal commas", "units in line 2")


def test_the_recipe_overrides_what_is_found(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", "time;x\n1;1,234\n2;2,345\n")
    np.testing.assert_array_equal(read(path).columns["x"], [1.234, 2.345])
    stream = read(path, ReadOptions(decimal="."))
    np.testing.assert_array_equal(stream.columns["x"], [1234.0, 2345.0])
    assert stream.losses == ("log.csv: column 'x': 2 cells with separators of thousands, '1,234' is 1234",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b,c\n0,1,2\n1,2\n2,3,4\n", r"log\.csv: line 3: 2 values; expected 3, as many as the header in line 1 .*Repair"),
        ("a,b,c\n0,1,2\n1,2,3,4\n2,3,4\n", r"line 3: 4 values; expected 3, as many as the header in line 1 .*Repair"),
        ("a,b,c\n0,1,2\n1,2,3,4,5,6\n2,3,4\n", r"line 3: 6 values; expected 3"),
        ("# x\n\na,b,c\n0,1,2\n\n1,2\n2,3,4\n", r"line 6: 2 values; expected 3, as many as the header in line 3"),
        ('a,b,c\n0,"1\n1",2\n1,2\n2,3,4\n', r"line 4: 2 values; expected 3"),
        ("a,b,c,d\n0,1,2\n1,2,3\n2,3,4\n", r"line 2: 3 values; expected 4.*Most rows are like this: repair the header"),
        ("a,b\n0,5,1,2\n1,0,1,3\n1,5,1,4\n", r"line 2: 4 values; expected 2.*Is the decimal mark a comma, too\?"),
    ],
)
def test_a_ragged_row_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path / "log.csv", text), ReadOptions(rate_hz=1.0))


def test_a_last_row_that_is_cut_is_left_out(tmp_path: Path) -> None:
    for end, loss in (("2,3", CUT_ROW), ("2,3\n", "line 4, the last row, has 2 of 3 values and may be cut: left out")):
        stream = read(write(tmp_path / "log.csv", f"time,b,c\n0,1,2\n1,2,3\n{end}"))
        assert stream.losses == (f"log.csv: {loss}",)
        np.testing.assert_array_equal(stream.columns["c"], [2.0, 3.0])


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    counts=st.lists(st.integers(1, 6), min_size=2, max_size=12),
    form=st.sampled_from([(",", "."), (";", ","), ("\t", "."), (" ", ".")]),
    quoted=st.booleans(),
    cells=st.sampled_from([1, 9, 2**20]),
)
def test_the_first_row_of_another_length_is_named(
    tmp_path: Path, counts: list[int], form: tuple[str, str], quoted: bool, cells: int
) -> None:
    """Rows of 4 values are read, others are refused by the line of the first; in pieces of any size, quoted or not."""
    delimiter, decimal = form
    rows = [[0.5 + row + 0.1 * column for column in range(count)] for row, count in enumerate([4, 4, 4, *counts, 4, 4])]
    lines = [delimiter.join(f"{value:.1f}".replace(".", decimal) for value in row) for row in rows]
    if quoted:
        lines = [delimiter.join(f'"{cell}"' for cell in line.split(delimiter)) for line in lines]
    path = write(tmp_path / "log.csv", "\n".join([delimiter.join(["time", "b", "c", "d"]), *lines]) + "\n")
    first = next((number for number, row in enumerate(rows) if len(row) != 4), None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid.logs.table.CELLS", cells)
        stream, refusal = attempt(InputError, lambda: read(path, ReadOptions(delimiter=delimiter, decimal=decimal)))
    if first is None:
        assert stream is not None
        assert len(stream) == len(rows)
    else:
        assert f"line {first + 2}: {len(rows[first])} value" in refusal


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(
        st.tuples(*[st.one_of(st.none(), st.floats(-1e6, 1e6).map(lambda x: round(x, 3)))] * 3), min_size=3, max_size=30
    ),
    form=st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", ","), ("|", ".")]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
    units=st.booleans(),
)
def test_a_table_is_the_same_in_every_form(
    tmp_path: Path, values: list[tuple[float | None, ...]], form: tuple[str, str], encoding: str, units: bool
) -> None:
    """Also where any value is missing: rows keep their length, so that nothing is refused."""
    delimiter, decimal = form
    table = pd.DataFrame(
        [(0.25 * row, *cells) for row, cells in enumerate(values)], columns=["time", "a", "b", "ü"], dtype=float
    )
    text = table.to_csv(index=False, sep=delimiter, decimal=decimal, lineterminator="\n")
    if units:
        header, _, rest = text.partition("\n")
        text = "\n".join([header, delimiter.join(["s", "mm", "deg", "bar"]), rest])
    stream = read(write(tmp_path / "log.csv", text, encoding))
    np.testing.assert_array_equal(stream.stamps["time"], 250_000_000 * np.arange(len(table)))
    for name in ("a", "b", "ü"):
        np.testing.assert_array_equal(stream.columns[name], table[name].to_numpy())
    assert stream.units == ({"a": "mm", "b": "deg", "ü": "bar"} if units else {})


def test_a_file_without_a_header_row_asks_for_names(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", "0,1,2\n0.1,2,3\n0.2,3,4\n")
    with pytest.raises(InputError, match=r"line 1: no header row above the numbers 0, 1, 2; expected names of the 3 columns"):
        read(path)
    stream = read(path, ReadOptions(header=("time", "a", "b")))
    np.testing.assert_array_equal(stream.columns["a"], [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match=r"line 1: 3 values; expected 2, as many as the recipe's `columns` has names"):
        read(path, ReadOptions(header=("time", "a")))
    summary = inspect_file(path)
    assert summary.columns == ("column 1", "column 2", "column 3")
    assert summary.stated == {"time": "column 1"}
    assert [field.low for field in summary.streams[0].fields] == [1.0, 2.0]


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(InputError, match="bytes that are no text; expected a CSV file in UTF-8"):
        read(path)


def test_a_real_log_without_header(shared_data: Path) -> None:
    path = shared_data / "ur10e_arm/ur-20_01_22-joint_1.csv"
    with pytest.raises(InputError, match="no header row above the numbers"):
        read(path)
    stream = read(path, ReadOptions(header=("t", *(f"c{i}" for i in range(30)))))
    assert len(stream.columns) == 30
    assert len(stream) > 1000
