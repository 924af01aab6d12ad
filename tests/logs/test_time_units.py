"""The unit of stamps that state none: found from rate, date and name, else requested."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for
from sysid.logs.inspection import inspect_file
from sysid.logs.time_unit import SECONDS, likely_units


def log(path: Path, stamps: np.ndarray, name: str = "time") -> Path:
    pd.DataFrame({name: stamps, "x": np.sin(np.arange(len(stamps)))}).to_csv(path, index=False)
    return path


@given(
    rate=st.floats(1.0, 20e3),
    unit=st.sampled_from(["s", "ms", "us", "ns"]),
    jitter=st.floats(0.0, 0.2),
    start=st.floats(0.0, 1e4),
)
def test_the_true_unit_is_always_among_the_likely_ones(rate: float, unit: str, jitter: float, start: float) -> None:
    """Except for what is not expected of a machine: more than 5 kHz where a thousandth of it is usual."""
    rng = np.random.default_rng(1)
    stamps = start + (np.arange(500) + jitter * rng.uniform(-0.5, 0.5, 500)) / rate
    found = [likely.unit for likely in likely_units(stamps / SECONDS[unit], "t")]
    if 1.3 <= rate < 4.5e3:
        assert unit in found
    if 5.5 <= rate <= 900.0:
        assert found == [unit]


@pytest.mark.parametrize(("unit", "rate"), [("s", 2.0), ("ms", 2000.0), ("us", 1500.0)])
def test_the_machines_rate_decides_where_two_units_are_plausible(unit: str, rate: float) -> None:
    stamps = np.arange(300) / rate / SECONDS[unit]
    assert len(likely_units(stamps)) == 2
    assert [likely.unit for likely in likely_units(stamps, expected_hz=2.0 * rate)] == [unit]


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        (1_700_000_000_000_000_000 + 10_000_000 * np.arange(300), "ns"),
        (1_700_000_000_000_000 + 1000 * np.arange(300), "us"),
        (1_700_000_000_000 + np.arange(300), "ms"),
        (1_700_000_000.5 + np.arange(300), "s"),
        (45_292.5 + np.arange(300) / 86400.0 / 50.0, "day"),
    ],
)
def test_dates_decide(tmp_path: Path, stamps: np.ndarray, unit: str) -> None:
    assert [likely.unit for likely in likely_units(stamps.astype(float), "stamp")] == [unit]
    (clock,) = inspect_file(log(tmp_path / "a.csv", stamps, "stamp")).streams[0].clocks
    assert 0.9 < clock.rate_hz < 1100.0


@pytest.mark.parametrize("name", ["t_us", "TimeUS", "time (us)", "micros", "Zeit [us]"])
def test_the_name_of_the_column_decides(tmp_path: Path, name: str) -> None:
    summary = inspect_file(log(tmp_path / "a.csv", 500.0 * np.arange(300), name))  # 2 kHz in us, 2 Hz in ms
    assert summary.streams[0].clocks[0].rate_hz == pytest.approx(2000.0)
    assert summary.time_units == ()


def test_stamps_of_no_plausible_rate_are_refused_with_the_likely_unit(tmp_path: Path) -> None:
    path = log(tmp_path / "a.csv", 20_000 * np.arange(300))
    with pytest.raises(InputError, match=r'a\.csv: time: stamps of no stated unit; as seconds 5e-05 Hz.*`time_unit = "us"`'):
        reader_for(path).read(path, ReadOptions())
    for options in (ReadOptions(time_unit="us"), ReadOptions(time_unit="s")):
        (stream,) = reader_for(path).read(path, options)
        assert len(stream) == 300
    slow = log(tmp_path / "b.csv", 7.0 * np.arange(3))  # two steps show no rate
    assert len(reader_for(slow).read(slow, ReadOptions())[0]) == 3


def test_real_stamps_in_microseconds(shared_data: Path) -> None:
    summary = inspect_file(shared_data / "sage_so101/step_response/state_motor.csv")
    assert summary.stated == {"time_unit": "us"}
    assert summary.streams[0].clocks[0].rate_hz == pytest.approx(50.0, rel=0.05)
