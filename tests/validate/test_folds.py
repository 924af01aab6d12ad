"""Folds by whole recordings and by blocks of time: every row once, no neighbour on both sides."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.errors import ExcitationError, SettingsError
from sysid.networks.estimator import NetworkRegressor, cross_validate
from sysid.networks.split import SignalRows
from sysid.validate import folds


def rows(lengths: tuple[int, ...]) -> SignalRows:
    names = np.concatenate([np.full(n, f"run-{k}") for k, n in enumerate(lengths)])
    row = np.concatenate([np.arange(n) for n in lengths])
    rng = np.random.default_rng(0)
    x = rng.normal(size=len(row))
    return SignalRows(("a.cylinder", "a.joint"), np.column_stack([x, 2.0 * x]), names, row, row / 100.0)


@pytest.mark.parametrize("by", ["recording", "block"])
def test_every_row_is_held_out_once(by: str) -> None:
    data = rows((300, 500, 400, 450))
    found = folds(data, 3, by)  # type: ignore[arg-type]
    assert sorted(np.concatenate([held for _, held in found]).tolist()) == list(range(len(data)))
    assert all(not set(fit.tolist()) & set(held.tolist()) for fit, held in found)


def test_a_recording_is_never_split() -> None:
    data = rows((300, 500, 400, 450))
    for fit, held in folds(data, 4):
        assert not set(data.recording[fit]) & set(data.recording[held])
        assert len(fit) + len(held) == len(data)


def test_blocks_keep_their_distance() -> None:
    data = rows((800, 600))
    for fit, held in folds(data, 4, "block", guard_s=0.5):
        for name in ("run-0", "run-1"):
            times = [data.time[index[data.recording[index] == name]] for index in (fit, held)]
            assert np.abs(times[0][:, None] - times[1]).min() >= 0.5
            assert np.ptp(times[1]) < 0.26 * np.ptp(data.time[data.recording == name])  # one stretch of it


def test_too_few_recordings_or_rows_are_refused() -> None:
    with pytest.raises(ExcitationError, match=r"2 recordings; expected at least 5, one a fold. Use fewer folds, or split"):
        folds(rows((100, 100)))
    with pytest.raises(SettingsError, match=r"folds: 1; expected two and more"):
        folds(rows((100, 100)), 1)


def test_they_are_what_cross_validation_takes() -> None:
    data = rows((200, 200))
    network = NetworkRegressor((8,), epochs=5, batch=32)
    scores = cross_validate(network, data.values[:, :1], data.values[:, 1], cv=folds(data, 2))
    assert isinstance(scores, dict)
    assert len(scores["test_score"]) == 2
