"""What stands behind each sample: measured, bridged, held, missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets import Store, ingest
from sysid.datasets.channel import Channel
from sysid.datasets.resample import resample
from sysid.datasets.validity import BRIDGED, HELD, MEASURED, MISSING, states, validity_of
from sysid.errors import StoreError

MACHINE = """schema = 1
name = "press"
rate_hz = 100.0
[[axes]]
name = "ram"
actuation = "velocity"
drives = "joint"
limits = [-1.0, 1.0]
"""


@given(st.lists(st.integers(5, 120), min_size=4, max_size=60), st.floats(0.02, 0.2), st.integers(0, 100))
def test_the_mask_agrees_with_the_gaps(steps: list[int], limit: float, seed: int) -> None:
    """Steps of the source in milliseconds: bridged only inside allowed gaps, missing only outside them."""
    times = np.cumsum(steps) * 1e-3
    values = np.random.default_rng(seed).normal(size=len(times))
    at = np.arange(0.0, times[-1] + 0.1, 0.01)
    stamps = np.rint(times * 1e9).astype(np.int64)
    made = resample(Channel("ram.joint", "a", "machine", stamps, values, max_gap_s=limit), times, at, 100.0, 0.5)
    found = states(made, at, times, 100.0)
    np.testing.assert_array_equal(found == MISSING, np.isnan(made))
    usual = np.median(np.diff(times))
    for instant, state in zip(at, found, strict=True):
        before, after = times[times <= instant + 1e-9], times[times >= instant - 1e-9]
        if state == MISSING:
            assert not len(before) or not len(after) or after[0] - before[-1] > limit - 1e-9 or usual < 0.0077
        else:
            step = after[0] - before[-1]
            assert state == (BRIDGED if step > 1.5 * usual + 1e-12 else MEASURED) or step == pytest.approx(1.5 * usual)


def test_a_command_is_measured_when_it_came_and_held_after() -> None:
    at = np.arange(10) / 10.0
    sent = np.array([0.2, 0.35, 0.4])
    values = np.array([np.nan, np.nan, 1, 1, 2, 2, 2, np.nan, np.nan, np.nan])
    expected = [MISSING, MISSING, MEASURED, HELD, MEASURED, HELD, HELD, MISSING, MISSING, MISSING]
    np.testing.assert_array_equal(states(values, at, sent, 10.0, command=True), expected)


def test_of_a_stored_version(tmp_path: Path) -> None:
    """A sensor with a lost sample, a hole, and a command that stops; blocks count from where they begin."""
    (tmp_path / "machine.toml").write_text(MACHINE)
    time = np.arange(0, 2000) * 0.01
    position = np.sin(time)
    position[500] = np.nan
    position[700:750] = np.nan
    lines = ["time,ram.command [1],ram.joint [rad]"]
    lines += [f"{t:.2f},{'' if 900 <= k < 1000 else round(0.5 * np.cos(t), 6)},{'' if np.isnan(p) else round(p, 6)}"
              for k, (t, p) in enumerate(zip(time, position, strict=True))]  # fmt: skip
    (tmp_path / "logs/run").mkdir(parents=True)
    (tmp_path / "logs/run/log.csv").write_text("\n".join(lines) + "\n")
    made = ingest(tmp_path / "logs", tmp_path / "ws", machine=tmp_path / "machine.toml")
    store = Store(tmp_path / "ws")
    for recording in made.recordings:
        mask = validity_of(store, made.reference, recording.name)
        first = round(recording.start_ns * 1e-7)
        rows = np.arange(len(recording)) + first
        joint = np.where(rows == 500, "bridged", np.where((rows >= 700) & (rows < 750), "missing", "measured"))
        np.testing.assert_array_equal(mask["ram.joint"].to_numpy(), joint)
        command = np.where((rows >= 900) & (rows < 950), "held", np.where((rows >= 950) & (rows < 1000), "missing", "measured"))
        np.testing.assert_array_equal(mask["ram.command"].to_numpy(), command)
        np.testing.assert_array_equal(mask["time"].to_numpy(), recording.values("time"))
    assert len(made.recordings) > 1  # it was cut into blocks
    with pytest.raises(StoreError, match="no recording 'walk'"):
        validity_of(store, made.reference, "walk")
