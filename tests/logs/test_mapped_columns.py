"""What a recipe maps is read alone, and to the bit as in the whole file; other readers of the same files give the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for
from sysid.logs.limits import Budget
from sysid.logs.mat import find_variables, read_variables

ROWS = 5000


def columns() -> dict[str, np.ndarray[Any, Any]]:
    rng = np.random.default_rng(3)
    values = {f"x{i}": rng.standard_normal(ROWS) * 10.0 ** (3 * i - 9) for i in range(5)}
    return {"time": np.arange(ROWS) / 128.0, **values, "count": rng.integers(-(2**40), 2**40, ROWS)}


def write(path: Path) -> None:
    table = pd.DataFrame(columns())
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    elif path.suffix == ".parquet":
        table.to_parquet(path, row_group_size=700)
    else:
        savemat(path, {name: table[name].to_numpy() for name in table}, do_compression=path.stem == "packed")


@pytest.mark.parametrize("name", ["log.csv", "log.parquet", "log.mat", "packed.mat"])
def test_mapped_columns_are_those_of_the_whole_file(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    write(path)
    reader = reader_for(path)
    (whole,) = reader.read(path, ReadOptions())
    (some,) = reader.read(path, ReadOptions(columns=frozenset({"x1", "count"})))
    assert list(whole.columns) == ["x0", "x1", "x2", "x3", "x4", "count"]
    assert list(some.columns) == ["x1", "count"]
    assert some.fields == ("time", *whole.columns)
    assert some.stamps["time"].tobytes() == whole.stamps["time"].tobytes()
    for column, values in some.columns.items():
        assert values.tobytes() == whole.columns[column].tobytes()
    if name != "log.csv":
        for column, values in whole.columns.items():
            assert values.tobytes() == columns()[column].astype(np.float64).tobytes()


def test_a_table_in_pieces_is_what_pandas_reads_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    write(path)
    monkeypatch.setattr("sysid.logs.table.CELLS", 1000)
    (stream,) = reader_for(path).read(path, ReadOptions())
    at_once = pd.read_csv(path)
    for column, values in stream.columns.items():
        assert values.tobytes() == at_once[column].to_numpy(dtype=np.float64).tobytes()


@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}])
def test_variables_of_matlab_are_numbers_or_named(options: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    rng = np.random.default_rng(4)
    content: dict[str, Any] = {"t": np.arange(9.0), "q": rng.standard_normal((9, 3)), "z": np.arange(9) * 1j, "gain": 2.0}
    if not options.get("format"):
        content |= {"log": {"a": rng.standard_normal(9), "text": "abc" * 1000, "in": {"b": np.arange(9, dtype=np.uint8)}}}
        content |= {"cell": np.array([1, "a"], dtype=object), "steps": np.array([(1,), (2,)], [("n", "f8")]), "word": "abc"}
    savemat(path, content, **options)
    budget, unread = Budget.of(path.stat().st_size), dict[str, str]()
    variables, others = find_variables(path, budget)
    numbers = read_variables(path, variables, budget, unread)
    assert unread == {"z": "complex numbers"}
    np.testing.assert_array_equal(numbers.pop("q"), content["q"])
    np.testing.assert_array_equal(numbers.pop("t"), content["t"])
    if "log" in content:
        assert numbers["log.in.b"].dtype == np.uint8
        np.testing.assert_array_equal(numbers.pop("log.in.b"), content["log"]["in"]["b"])
        np.testing.assert_array_equal(numbers.pop("log.a"), content["log"]["a"])
        assert others == {
            "log.text": "text", "cell": "a cell array", "steps": "an array of structures", "word": "text",
        }  # fmt: skip
    assert not numbers


def test_elements_of_lists_and_of_matrices_are_mapped_by_index(tmp_path: Path) -> None:
    table, matrix = tmp_path / "log.csv", tmp_path / "log.mat"
    table.write_text('time,q [deg],p\n0,"[1, 2]",5\n1,"[3, 4]",6\n')
    savemat(matrix, {"time": [0.0, 1.0], "q": [[1.0, 2.0], [3.0, 4.0]], "p": [5.0, 6.0]})
    for path in (table, matrix):
        (stream,) = reader_for(path).read(path, ReadOptions(columns=frozenset({"q[1]"})))
        np.testing.assert_array_equal(stream.columns["q[1]"], [2.0, 4.0])
        assert "p" not in stream.columns


def test_a_column_that_is_not_there_is_said_with_those_that_are(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("stamp,a,b\n0,1,2\n")
    with pytest.raises(InputError, match=r"no time column; .* found stamp, a, b\."):
        reader_for(path).read(path, ReadOptions(columns=frozenset({"a"})))
    with pytest.raises(InputError, match=r"no time column 'stmp'; expected 'stamp'\? \(valid: a, b, stamp\)"):
        reader_for(path).read(path, ReadOptions(columns=frozenset({"a"}), time="stmp"))
