"""Long curves are thinned: no peak is lost, gaps stay gaps, and the seconds that are played are whole."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.view import thinning
from sysid.view.thinning import bucket, shown_rows, stride


def test_short_curves_are_whole() -> None:
    values = np.array([0.0, np.nan, 2.0, np.inf, 1.0])
    rows, shown = shown_rows(len(values), lambda a, b: values[a:b])
    assert (rows.tolist(), shown.tolist()) == ([0, 2, 4], [0.0, 2.0, 1.0])
    assert (bucket(2**20), stride(2**20)) == (1, 1)


def test_extremes_of_every_bucket_and_a_whole_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thinning, "MOST", 1000)
    count, rng = 200_003, np.random.default_rng(0)
    values = rng.standard_normal(count)
    values[50_000:60_000] = np.nan
    size = bucket(count)
    assert (stride(count), size) == (201, 402)
    rows, shown = shown_rows(count, lambda a, b: values[a:b], (100_000, 100_500))
    np.testing.assert_array_equal(shown, values[rows])
    assert np.all(np.diff(rows) > 0)
    assert not np.any((rows >= 50_000) & (rows < 60_000))
    assert set(range(100_000, 100_500)) <= set(rows.tolist())
    assert len(rows) < 1000 + 500 + 10
    assert {int(np.nanargmin(values)), int(np.nanargmax(values))} <= set(rows.tolist())
    block = values[: thinning.PIECE // size * size].reshape(-1, size)
    there = ~np.isnan(block).all(axis=1)
    lowest = np.nanargmin(block[there], axis=1) + np.flatnonzero(there) * size
    assert set(lowest.tolist()) <= set(rows.tolist())
