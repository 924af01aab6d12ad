"""Splits: by recording, by contiguous block with a guard, as the recipe says."""

from __future__ import annotations

import zlib
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Recording
from sysid.datasets.splits import split
from sysid.errors import InputError, SettingsError


def recording(name: str, seconds: float = 30.0) -> Recording:
    time = np.arange(int(seconds * 50)) / 50.0
    joint = np.cos(time) + 0.1 * time + 1e-6 * zlib.crc32(name.encode())  # no two are copies
    table = pd.DataFrame({"time": time, "a.command": np.sign(np.sin(time)), "a.joint": joint})
    return Recording(name, table, 50.0, start_ns=10**18)


@pytest.mark.parametrize(("count", "expected"), [(3, "fsh"), (4, "ffsh"), (5, "ffssh"), (6, "fffssh"), (8, "ffffsshh")])
def test_whole_recordings_are_shared_out(count: int, expected: str) -> None:
    recordings = [recording(f"r{index}") for index in range(count)]
    parts, roles = split(recordings, Splits(), "test")
    assert [part.name for part in parts] == [r.name for r in recordings]
    assert "".join(roles[part.name][0] for part in parts) == expected


@given(st.integers(1, 20), st.integers(0, 3))
def test_every_role_is_filled_and_every_recording_has_one(count: int, named: int) -> None:
    recordings = [recording(f"r{index:02d}") for index in range(count + named)]
    held = tuple(f"r{index:02d}" for index in range(count, count + named))
    parts, roles = split(recordings, Splits(held_out=held), "test")
    assert set(roles) == {part.name for part in parts}
    assert set(roles.values()) == {"fit", "select", "held_out"}
    assert all(roles[name] == "held_out" for name in held)


def test_one_recording_is_cut_into_blocks_with_a_guard() -> None:
    whole = recording("only", 90.0)
    parts, roles = split([whole], Splits(guard_s=1.0), "test")
    assert [part.name for part in parts] == [f"only#{k}" for k in range(1, 6)]
    assert [roles[part.name] for part in parts] == ["fit", "select", "fit", "select", "held_out"]
    seconds = {role: sum(len(p) / 50 for p in parts if roles[p.name] == role) for role in ("fit", "select", "held_out")}
    assert seconds["fit"] == pytest.approx(45, abs=5)
    assert seconds["held_out"] == pytest.approx(22, abs=4)
    assert sum(seconds.values()) == pytest.approx(90 - 4 * 1.0, abs=0.1)
    for part in parts:  # each block is a piece of the whole, on its own time from zero
        first = round((part.start_ns - whole.start_ns) * 1e-9 * 50)
        np.testing.assert_array_equal(part.values("a.joint"), whole.values("a.joint")[first : first + len(part)])
        np.testing.assert_allclose(part.values("time"), np.arange(len(part)) / 50)
    for before, after in pairwise(parts):
        guard = (after.start_ns - before.start_ns) * 1e-9 - len(before) / 50
        assert guard == pytest.approx(1.0, abs=0.021)


@given(st.floats(18.6, 20.8), st.floats(0.6, 2.0), st.sampled_from([0.5, 1.0, 2.0]))
def test_blocks_begin_where_the_machine_is_at_rest(begin: float, rest: float, guard: float) -> None:
    time = np.arange(0.0, 30.0, 0.02)
    moving = np.cumsum(np.where((time > begin) & (time < begin + rest), 0.0, 0.01))
    whole = Recording("r", pd.DataFrame({"time": time, "a.joint": moving}), 50.0)
    parts, _ = split([whole, recording("h")], Splits(held_out=("h",), guard_s=guard), "test")
    first = (parts[1].start_ns - parts[0].start_ns) * 1e-9
    assert begin < first < begin + rest
    assert len(parts[0]) / 50 == pytest.approx(first - guard, abs=0.021)


def test_the_last_part_can_be_held_out() -> None:
    recordings = [recording("manual", 90.0), recording("steps", 6.0)]
    parts, roles = split(recordings, Splits(held_out=("steps",), held_out_last={"manual": 1 / 3}), "test")
    assert [roles[part.name] for part in parts] == ["fit", "select", "fit", "select", "held_out", "held_out"]
    assert len(parts[4]) / 50 == pytest.approx(30, abs=2)


def test_poses_are_no_part_of_it() -> None:
    poses = Recording("poses", pd.DataFrame({"time": [0.0]}), 50.0, "poses")
    parts, roles = split([recording("a"), poses, recording("b"), recording("c")], Splits(), "test")
    assert [part.name for part in parts] == ["a", "poses", "b", "c"]
    assert "poses" not in roles


def test_mistakes_are_named() -> None:
    recordings = [recording("manual-1"), recording("manual-2")]
    with pytest.raises(SettingsError, match=r"splits\.held_out: no recording 'manual-3'; expected 'manual-[12]'\?"):
        split(recordings, Splits(held_out=("manual-3",)), "recipe")
    with pytest.raises(SettingsError, match="'manual-1' is both fit and held_out"):
        split(recordings, Splits(fit=("manual-1",), held_out=("manual-*",)), "recipe")
    with pytest.raises(SettingsError, match="held_out_last: no recording 'x'"):
        split(recordings, Splits(held_out_last={"x": 0.5}), "recipe")
    with pytest.raises(InputError, match=r"14\.0 s are too short for 3 blocks; expected 15 s.*three recordings of 4 s or more"):
        split([recording("short", 14.0)], Splits(held_out_last={"short": 0.25}), "recipe")


def test_what_is_too_short_to_be_cut_is_kept_for_the_fit() -> None:
    parts, roles = split([recording("short", 14.9)], Splits(), "recipe")
    assert [part.name for part in parts] == ["short"]
    assert roles == {"short": "fit"}
    parts, roles = split([recording("short", 14.9), recording("long", 30.0)], Splits(), "recipe")
    assert roles == {"short": "fit", "long#1": "fit", "long#2": "select", "long#3": "held_out"}


@given(st.floats(15.0, 120.0), st.sampled_from([20.0, 50.0, 190.0]))
def test_every_block_has_the_least_length(seconds: float, rate: float) -> None:
    """Also where the machine rests at places that would make a block shorter."""
    time = np.arange(int(np.ceil(seconds * rate))) / rate
    table = pd.DataFrame({"time": time, "a.joint": np.sin(0.3 * time) + 0.2 * np.sign(np.sin(0.5 * time))})
    parts, roles = split([Recording("only", table, rate)], Splits(), "test")
    assert set(roles.values()) == {"fit", "select", "held_out"}
    assert min(len(part) for part in parts) >= 4.0 * rate - 1
