"""Static poses: bursts matched by their values, still phases, one row each."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.datasets.channel import Channel
from sysid.datasets.poses import match_bursts, pose_table, still_phases
from sysid.datasets.recipe import StillPhases
from sysid.errors import InputError


def holds(offset: float, count: int = 30, seed: int = 0, period: float = 0.2, function: str = "joint") -> Channel:
    """Bursts of six samples, one a pose; the time between poses varies."""
    rng = np.random.default_rng(seed)
    begin = np.cumsum(rng.uniform(4.0, 9.0, count))
    values = rng.uniform(0.0, 0.1, count)
    times = (begin[:, None] + np.arange(6) * period).ravel() - offset
    measured = np.repeat(values if function == "cylinder" else -np.sqrt(values), 6)
    noise = 1e-5 * np.random.default_rng(seed + 1).normal(size=len(measured))
    stamps = np.rint(times * 1e9).astype(np.int64)
    domain = "machine" if function == "cylinder" else "mocap"
    return Channel(f"boom.{function}", "file", domain, stamps, measured + noise)


def test_bursts_are_matched_by_their_values() -> None:
    machine, other = holds(0.0, function="cylinder"), holds(1.37)
    match = match_bursts([machine], [other], int(machine.stamps[0]), int(other.stamps[0]))
    assert (match.matched, match.total) == (30, 30)
    offset_of_starts = (machine.stamps[0] - other.stamps[0]) * 1e-9
    assert match.offset + offset_of_starts == pytest.approx(1.37, abs=match.half_width)


def test_a_log_that_starts_later_is_matched_too() -> None:
    machine, other = holds(0.0, function="cylinder"), holds(0.5)
    late = Channel(other.signal, other.source, other.domain, other.stamps[42:], other.values[42:])
    match = match_bursts([machine], [late], int(machine.stamps[0]), int(late.stamps[0]))
    assert match.matched == 23
    assert match.offset + (machine.stamps[0] - late.stamps[0]) * 1e-9 == pytest.approx(0.5, abs=match.half_width)


def test_other_poses_are_refused() -> None:
    machine, other = holds(0.0, function="cylinder"), holds(0.0, seed=7)
    assert "holds match at best" in match_bursts([machine], [other], 0, 0).refused
    assert "no joint or cylinder" in match_bursts([machine], [], 0, 0).refused
    few = holds(0.0, count=3)
    assert "3 separate holds are too few" in match_bursts([machine], [few], 0, 0).refused


def test_still_phases_of_a_continuous_log() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    position = np.interp(time, [0, 4, 6, 10, 12, 30, 33, 40], [0, 0, 1, 1, -1, -1, 0.5, 0.5])
    rng = np.random.default_rng(0)
    signals = {"a.joint": (time, position + 1e-4 * rng.normal(size=len(time)))}
    phases = still_phases(signals, StillPhases(), "test")
    assert len(phases) == 4
    np.testing.assert_allclose([begin for begin, _ in phases], [0.0, 6.0, 12.0, 33.0], atol=0.3)
    swinging = np.where(time < 8.0, 0.1 * np.sin(6 * time), 0.0)
    table = pose_table(phases, signals | {"tool.x": (time, swinging)}, {}, {"tool.x": 1e-3}, 2e-3)
    np.testing.assert_allclose(table["a.joint"], [0.0, 1.0, -1.0, 0.5], atol=1e-4)
    np.testing.assert_array_equal(np.isnan(table["tool.x"]), [True, True, False, False])


def test_a_log_in_which_nothing_stands_still_is_refused() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    with pytest.raises(InputError, match=r"no phase at rest of 0\.4 s.*set \[still\] in the recipe"):
        still_phases({"a.joint": (time, np.sin(3 * time))}, StillPhases(), "test")
    with pytest.raises(InputError, match="no measured signal on the machine's clock"):
        still_phases({}, StillPhases(), "test")
