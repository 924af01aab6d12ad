"""Cells of text: numbers as they are written in any country, and cells that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for
from sysid.logs.inspection import inspect_file
from sysid.logs.reader import ALL

BAD = ("ERR", "#NV", "#WERT!", "0x1F", "n.v.", "1.2.3,4", "12 34", "--5", "1x", "5..", "²", "(5", "5)", "(-5)", "-5-", "()")
#: Where the sign of a negative number stands.
SIGNS = {"before": "{minus}{number}", "behind": "{number}{minus}", "apart": "{number} {minus}", "around": "({number})"}


def read(path: Path, text: str, options: ReadOptions = ALL) -> Stream:
    path.write_bytes(text.encode())
    (stream,) = reader_for(path).read(path, options)
    return stream


def written(value: float, decimals: int, decimal: str, thousands: str, minus: str, plus: str, sign: str = "before") -> str:
    text = f"{abs(value):,.{decimals}f}".replace(",", "T").replace(".", decimal).replace("T", thousands)
    return SIGNS[sign].format(minus=minus, number=text) if value < 0 else f"{plus}{text}"


@settings(max_examples=examples(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_numbers_of_any_locale_are_read_and_other_cells_are_missing_and_counted(tmp_path: Path, data: st.DataObject) -> None:
    """Decimal mark × thousands × signs × decimals × place of the cells that are no numbers × size of the pieces."""
    decimal = data.draw(st.sampled_from([".", ","]))
    other = "," if decimal == "." else "."
    thousands = data.draw(st.sampled_from(["", other, " ", "\u00a0", "\u202f", "\u2009", "'", "\u2019"]))
    minus = data.draw(st.sampled_from(["-", "\u2212", "\u2013", "\uff0d"]))
    plus = data.draw(st.sampled_from(["", "+"]))
    sign = data.draw(st.sampled_from(list(SIGNS)))
    decimals = data.draw(st.integers(0, 4))
    delimiter = data.draw(st.sampled_from([";", "\t", "|"]))
    values = data.draw(st.lists(st.floats(-1e7, 1e7).map(lambda x: round(x, decimals) + 0.0), min_size=3, max_size=30))
    bad = data.draw(st.sets(st.integers(1, len(values) - 1), max_size=len(values) - 1))
    cells = [written(value, decimals, decimal, thousands, minus, plus, sign) for value in values]
    for row in bad:
        cells[row] = data.draw(st.sampled_from(BAD))
        values[row] = np.nan
    lines = [f"{row / 10:.1f}".replace(".", decimal) + delimiter + cell for row, cell in enumerate(cells)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid.logs.table.CELLS", data.draw(st.sampled_from([1, 9, 2**20])))
        stream = read(tmp_path / "log.csv", "\n".join([f"time{delimiter}x", *lines]) + "\n", ReadOptions(delimiter=delimiter))
    np.testing.assert_allclose(stream.columns["x"], values, rtol=1e-14)
    np.testing.assert_array_equal(stream.stamps["time"], 100_000_000 * np.arange(len(values)))
    told = [loss for loss in stream.losses if "not a number" in loss or "are not numbers" in loss]
    separated = [cell for row, cell in enumerate(cells) if thousands and thousands in cell and row not in bad]
    assert any("separators of thousands" in loss for loss in stream.losses) == any(
        thousands != other or (cell.count(other) == 1 and decimal not in cell) for cell in separated
    )
    negative = [cell for value, cell in zip(values, cells, strict=True) if value < 0.0 and sign != "before"]
    said = [loss for loss in stream.losses if "sign of accounting" in loss]
    assert [loss.partition(", ")[0] for loss in said] == (
        [f"log.csv: column 'x': {len(negative)} cells with the sign of accounting"] if negative else []
    )
    assert all(repr(negative[0]) in loss for loss in said)
    if bad:
        count = f"{len(bad)} cells are not numbers" if len(bad) > 1 else "1 cell is not a number"
        assert told == [f"log.csv: column 'x': {count}, for example {cells[min(bad)]!r}: taken as missing"]
    else:
        assert told == []


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(st.integers(-999_999, 999_999), min_size=3, max_size=20),
    decimal=st.sampled_from([".", ","]),
    small=st.booleans(),
    first=st.booleans(),
    pieces=st.sampled_from([1, 9, 2**20]),
)
def test_the_marks_of_the_file_decide_unless_the_column_contradicts(
    tmp_path: Path, values: list[int], decimal: str, small: bool, first: bool, pieces: int
) -> None:
    """1.234 is 1234 beside decimal commas, except in a column with 0.917: there the point is the decimal mark."""
    other = "," if decimal == "." else "."
    cells = [f"{value:,}".replace(",", other) for value in values]
    truth: list[float] = [float(value) for value in values]
    if small:
        cells.insert(0 if first else len(cells), f"0{other}917")
        truth = [float(cell.replace(other, ".")) if cell.count(other) < 2 else np.nan for cell in cells]
    lines = [f"{row / 10:.1f}".replace(".", decimal) + "|" + cell for row, cell in enumerate(cells)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid.logs.table.CELLS", pieces)
        stream = read(tmp_path / "log.csv", "\n".join(["time|x", *lines]) + "\n")
    np.testing.assert_array_equal(stream.columns["x"], truth)
    marks = {".": "decimal points", ",": "decimal commas"}
    assert (f"log.csv: column 'x': {marks[other]}, while the file has {marks[decimal]}" in stream.losses) == small
    thousands = [loss for loss in stream.losses if "separators of thousands" in loss]
    assert bool(thousands) == (not small and any(other in cell for cell in cells))


@pytest.mark.parametrize(
    ("text", "found", "mark"),
    [
        ("time;x\n0;1,234\n10;999\n", "1,234 beside 999", ","),
        ("time;x\n0;1.234\n10;999\n", "1.234 beside 999", "."),
        ("time\tx\n0\t1,234\n10\t2,345\n", "1,234", ","),
        ('time,x\n0,"1,234"\n1,"2,345"\n', "1,234", ","),
    ],
)
def test_numbers_with_two_readings_are_refused_and_the_remedy_works(tmp_path: Path, text: str, found: str, mark: str) -> None:
    path = tmp_path / "log.csv"
    _, refusal = attempt(InputError, lambda: read(path, text))
    assert f"column 2: numbers such as {found}, and no cell that shows whether {mark!r} is the decimal mark" in refusal
    assert f'State `decimal = "{mark}"` in the recipe' in refusal
    assert read(path, text, ReadOptions(decimal=mark)).columns["x"][0] == 1.234
    assert read(path, text, ReadOptions(decimal="," if mark == "." else ".")).columns["x"][0] == 1234.0
    assert "numbers such as" in inspect_file(path).refusal


def test_a_mark_that_comes_late_is_not_guessed(tmp_path: Path) -> None:
    """The form is found from the first rows; where these have no mark, a column has to show its own."""
    rest = "".join(f"{10 * row};0;0\n" for row in range(300))
    stream = read(tmp_path / "log.csv", f"time [ms];x;y\n{rest}3000;1,234;0,012\n3010;2,345;0,024\n")
    assert stream.columns["y"][-1] == 0.024
    assert stream.unread["x"].startswith(
        "numbers such as '1,234', where no cell shows whether the mark is that of decimals (`decimal`"
    )
    points = read(tmp_path / "log.csv", f"time [ms];x;y\n{rest}3000;1.234;0\n3010;ERR;0\n")
    assert points.columns["x"][-2] == 1.234, "a point is the decimal mark unless other cells have decimal commas"
    stated = read(tmp_path / "log.csv", f"time [ms];x;y\n{rest}3000;1,234;0,012\n", ReadOptions(decimal=","))
    assert stated.columns["x"][-1] == 1.234


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("time,x\n0,1.234\n10,999\n", [1.234, 999.0]),
        ("time;x\n0;1,234\n10;2,345\n", [1.234, 2.345]),
        ('time,x\n0.5,"1,234"\n1.5,"999"\n', [1234.0, 999.0]),
        ("time;x\n0;1.234.567\n10;999\n", [1_234_567.0, 999.0]),
        ("time;x\n0;1.234,5\n10;999\n", [1234.5, 999.0]),
        ("time;x\n0,5;true\n1,5;FALSE\n2,5;ERR\n", [1.0, 0.0, np.nan]),
        ("time,x\n\u0660.\u0665,\u0661\n\u0660.\u0666,\u0662\n", [1.0, 2.0]),
        ("time;x\n\uff10\uff0c\uff15;\uff11\n\uff10\uff0c\uff16;\uff12\n", [1.0, 2.0]),
    ],
)
def test_numbers_with_one_reading(tmp_path: Path, text: str, values: list[float]) -> None:
    np.testing.assert_array_equal(read(tmp_path / "log.csv", text).columns["x"], values)


@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(st.floats(-1e6, 1e6).map(lambda x: round(x, 3)), min_size=2, max_size=20),
    unit=st.sampled_from(["rad", "mm", "°", "%", "m/s", "N·m"]),
    space=st.sampled_from(["", " ", "\u00a0"]),
    decimal=st.sampled_from([".", ","]),
    bad=st.sets(st.integers(0, 18)),
    pieces=st.sampled_from([1, 12, 2**20]),
)
def test_a_unit_in_every_cell_is_that_of_the_column(
    tmp_path: Path, values: list[float], unit: str, space: str, decimal: str, bad: set[int], pieces: int
) -> None:
    """Unit × space × decimal mark × place of the cells that are no numbers × size of the pieces."""
    bad = {row for row in bad if row < len(values) - 1}
    cells = [f"{value:.3f}{space}{unit}".replace(".", decimal) for value in values]
    for row in bad:
        cells[row], values[row] = "ERR", np.nan
    lines = [f"{row / 10:.1f}".replace(".", decimal) + ";" + cell for row, cell in enumerate(cells)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid.logs.table.CELLS", pieces)
        stream = read(tmp_path / "log.csv", "\n".join(["time;x", *lines]) + "\n")
    np.testing.assert_array_equal(stream.columns["x"], values)
    assert stream.units == {"x": unit}
    assert f"log.csv: column 'x': {len(values) - len(bad)} cells state the unit [{unit}]" in stream.losses
    assert any("for example 'ERR'" in loss for loss in stream.losses) == bool(bad)


def test_units_in_cells(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    for header in ("x", "x [rad]"):
        stream = read(path, f"time,{header}\n0,0.1 rad\n1,-2.5e-1rad\n2,\n3,ERR\n")
        np.testing.assert_array_equal(stream.columns["x"], [0.1, -0.25, np.nan, np.nan])
        assert stream.units == {"x": "rad"}
        assert f"log.csv: column {header!r}: 2 cells state the unit [rad]" in stream.losses
        assert any("1 cell is not a number, for example 'ERR'" in loss for loss in stream.losses)
    stream = read(path, "time;x [%]\n0,1;45,5 %\n1,1;46 %\n")
    np.testing.assert_array_equal(stream.columns["x"], [45.5, 46.0])
    stream = read(path, "time,x\n0,1\n1,2\n2,3 mm\n3,4x\n")
    np.testing.assert_array_equal(stream.columns["x"], [1.0, 2.0, np.nan, np.nan])
    assert stream.losses == ("log.csv: column 'x': 2 cells are not numbers, for example '4x': taken as missing",)
    for text, reason in (
        ("time,x [m]\n0,1 mm\n1,2 mm\n", "2 numbers with the unit [mm] below a header in [m]"),
        ("time,x\n0,1 mm\n1,2 mm\n2,3\n", "2 numbers with the unit [mm] and 1 without"),
    ):
        assert read(path, text).unread == {"x": reason}
        with pytest.raises(
            InputError, match=r"column 'x'.*expected numbers. Export it as numbers, with their unit in the header"
        ):
            read(path, text, ReadOptions(columns=frozenset({"x"})))


def test_what_ingest_reads_is_what_the_inspection_shows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    stream = read(path, "time;x;note;y\n0,1;1.234;start;inf\n0,2;ERR;;1e300\n0,3;1,5;end;2\n")
    summary = inspect_file(path)
    assert summary.losses == (*stream.losses, "column 'note' left out: text, for example 'start'")
    x, y = summary.streams[0].fields
    assert (x.low, x.high) == (1.5, 1234.0)
    assert x.missing == pytest.approx(1 / 3)
    assert (y.low, y.high) == (2.0, 2.0), "what ingest takes as missing"
    assert y.missing == pytest.approx(2 / 3)
