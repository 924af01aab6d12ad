"""Overflows of a logger, which are infinite or the largest number of their type: missing values, counted and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run
from edge_machines import from_bytes, write_machine

from sysid.datasets import Store


def ingested(folder: Path, value: float) -> pd.DataFrame:
    """The stored table of a machine whose log has ``value`` in eleven rows of a joint."""
    write_machine(from_bytes(b""), folder / "edge")
    path = folder / "edge/logs/r0/log.csv"
    log = pd.read_csv(path)
    log.loc[100:110, "a0.joint"] = value
    log.to_csv(path, index=False)
    assert run("--workspace", folder / "ws", "ingest", folder / "edge") == 0
    return Store(folder / "ws").load("edge").recording("r0").table


@pytest.mark.parametrize("value", [np.inf, -np.inf, 9.91e37, 1e16])
def test_an_overflow_is_missing(value: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, missing = ingested(tmp_path / "overflow", value), ingested(tmp_path / "missing", np.nan)
    pd.testing.assert_frame_equal(found, missing)
    assert capsys.readouterr().out.count("a0.joint: 11 overflows (beyond 1e+15) taken as missing") == 1


@pytest.mark.parametrize("value", [1e15, -1e15, 1e9])
def test_a_large_value_is_a_value(value: float, tmp_path: Path) -> None:
    assert ingested(tmp_path, value)["a0.joint"].abs().max() == pytest.approx(abs(value), rel=1e-12)
