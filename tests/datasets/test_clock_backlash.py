"""Alignment of clocks through a play: the offset is that of the clocks, not the wait at every reversal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt
from scipy.stats import t

from sysid.datasets.channel import Channel
from sysid.datasets.clocks.alignment import Pair, estimate
from sysid.datasets.clocks.measured_motion import directions, turning_rows
from sysid.datasets.clocks.records import RecordingClocks, align
from sysid.datasets.clocks.resets import pieces
from sysid.datasets.clocks.residual import clock_residuals

Array = npt.NDArray[np.float64]
DEGREE = np.pi / 180.0
NOISE = 0.05 * DEGREE
OFFSET, SKEW = 0.3, 20e-6


def strokes(seconds: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Joint of an operator's strokes at 0.05 to 0.3 rad/s with rests between them, 200 times a second."""
    time, speed, place, k = np.arange(-5.0, seconds + 5.0, 0.005), np.zeros(round(200 * (seconds + 10.0))), 0.0, 0
    while k < len(time):
        count = round(200 * rng.uniform(0.5, 2.5))
        size = rng.choice([0.05, 0.1, 0.2, 0.3]) if rng.uniform() < 0.8 else 0.0
        speed[k : k + count] = -size if place > 0.0 else size
        place += float(speed[k : k + count].sum()) / 200.0
        k += count
    return time, np.cumsum(sosfiltfilt(butter(2, 2.0, fs=200.0, output="sos"), speed[: len(time)])) / 200.0


def smooth(seconds: float, rng: np.random.Generator) -> tuple[Array, Array]:
    time = np.arange(-5.0, seconds + 5.0, 0.005)
    values = sosfiltfilt(butter(2, 0.4, fs=200.0, output="sos"), rng.normal(size=len(time)))
    return time, 0.3 * values / values.std()


def behind(motion: Array, width: float) -> Array:
    """What a play of ``width`` drives."""
    out, place = np.empty_like(motion), motion[0]
    for k, value in enumerate(motion):
        place = min(max(place, value - 0.5 * width), value + 0.5 * width)
        out[k] = place
    return out


def pair(seed: int, degrees: float, kind: str = "strokes", behind_is: str = "stream", seconds: float = 60.0) -> Pair:
    """A joint on either side of a play: at 100 Hz on the machine's clock, at 120 Hz on the other one."""
    rng = np.random.default_rng(seed)
    time, ahead = (strokes if kind == "strokes" else smooth)(seconds, rng)
    after = behind(ahead, degrees * DEGREE)
    machine, other = (ahead, after) if behind_is == "stream" else (after, ahead)
    x_times, y_times = np.arange(0.0, seconds, 0.01), np.arange(0.0, seconds - OFFSET, 1.0 / 120.0)
    x = np.interp(x_times, time, machine) + NOISE * rng.normal(size=len(x_times))
    y = np.interp(y_times * (1.0 + SKEW) + OFFSET, time, other) + NOISE * rng.normal(size=len(y_times))
    return Pair("slew.joint~slew.joint", x_times, x, y_times, y, 7, 0.035)


@pytest.mark.parametrize("kind", ["strokes", "smooth"])
@pytest.mark.parametrize("behind_is", ["stream", "machine"])
@pytest.mark.parametrize("degrees", [0.2, 1.0])
def test_a_play_does_not_shift_the_offset(degrees: float, behind_is: str, kind: str) -> None:
    """It did so by 6 to 43 ms. The other way round it leads: the machine's sensor is the one that waits."""
    errors, inside, count = [], 0, 8
    for seed in range(count):
        found = estimate([pair(seed, degrees, kind, behind_is)])
        error = found.at(found.mid_time) - (OFFSET + SKEW * found.mid_time)
        errors.append(error)
        inside += abs(error) < t.ppf(0.975, found.degrees_of_freedom) * np.sqrt(found.covariance[0, 0])
        (play,) = found.backlash
        assert play.found
        assert play.width == pytest.approx(
            (1.0 if behind_is == "stream" else -1.0) * degrees * DEGREE, rel=0.1, abs=5.0 * play.error
        )
    assert abs(np.mean(errors)) < 0.4e-3
    assert inside >= count - 3


def test_where_there_is_no_play_the_offset_stays_that_without_one() -> None:
    errors, wrong = [], 0
    for seed in range(12):
        found = estimate([pair(seed, 0.0)])
        errors.append(found.at(found.mid_time) - (OFFSET + SKEW * found.mid_time))
        wrong += found.backlash[0].found
    assert np.sqrt(np.mean(np.square(errors))) < 0.25e-3
    assert wrong <= 3


def test_two_strokes_do_not_tell_a_play_from_the_map() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    motion = 0.3 * np.interp(time, [0.0, 5.0, 15.0, 20.0, 35.0, 40.0], [0.0, 0.0, 1.0, 1.0, 0.2, 0.2])
    rng = np.random.default_rng(0)
    x, y = motion + 1e-4 * rng.normal(size=len(time)), motion + 1e-4 * rng.normal(size=len(time))
    assert estimate([Pair("slew.joint~slew.joint", time, x, time, y, 7, 0.035)]).backlash == ()


def two_axes(seed: int, degrees: float, until: float) -> list[Pair]:
    """One axis that moves for 30 s, then another one behind backlash that moves from 34 s ``until`` a time."""
    rng = np.random.default_rng(seed)
    slew = pair(seed, 0.0, seconds=50.0)
    time, ahead = strokes(50.0, rng)
    slow = np.interp(np.clip(time, 34.0, until), time, 0.3 * ahead)
    after = behind(slow, degrees * DEGREE)
    first, stick = slew.x_times < 30.0, 0.2 * NOISE
    held = np.interp(np.minimum(slew.x_times, 30.0), slew.x_times[first], slew.x[first])
    x = held + np.where(first, 0.0, NOISE * rng.normal(size=len(held)))
    rest = slew.y_times + OFFSET > 30.0
    y = np.where(rest, np.median(held[~first]) + NOISE * rng.normal(size=len(slew.y)), slew.y)
    x2 = np.interp(slew.x_times, time, slow) + stick * rng.normal(size=len(slew.x))
    y2 = np.interp(slew.y_times * (1.0 + SKEW) + OFFSET, time, after) + stick * rng.normal(size=len(slew.y))
    return [
        Pair("slew.joint~slew.joint", slew.x_times, x, slew.y_times, y, 7, 0.035),
        Pair("stick.cylinder~stick.joint", slew.x_times, x2, slew.y_times, y2, 9, 0.035),
    ]


@pytest.mark.parametrize("until", [38.0, 50.0])
@pytest.mark.parametrize("degrees", [0.5, 1.5])
def test_backlash_of_an_axis_that_moves_last_is_no_step_of_the_clock(degrees: float, until: float) -> None:
    for seed in range(3):
        (found,) = pieces(two_axes(seed, degrees, until))
        error = found.estimate.at(found.estimate.mid_time) - (OFFSET + SKEW * found.estimate.mid_time)
        width = t.ppf(0.999, found.estimate.degrees_of_freedom) * np.sqrt(found.estimate.covariance[0, 0])
        assert abs(error) < max(width, 2e-3)


def test_one_pair_that_seldom_turns_does_not_hide_the_backlash_of_another() -> None:
    turning = pair(1, 1.0)
    line = np.clip(turning.x_times, 10.0, 20.0)
    there = np.clip(turning.y_times * (1.0 + SKEW) + OFFSET, 10.0, 20.0)
    once = replace(turning, name="boom.joint~boom.joint", x=0.02 * line, y=0.02 * there)
    found = estimate([turning, once])
    assert [item.name for item in found.backlash if item.found] == [turning.name]
    assert found.backlash[0].width == pytest.approx(DEGREE, rel=0.1)


@settings(deadline=None)
@given(st.lists(st.floats(0.2, 1.0), min_size=2, max_size=12), st.booleans())
def test_reversals_and_directions_of_a_zigzag(legs: list[float], first_up: bool) -> None:
    signs = [(1.0 if (k % 2 == 0) == first_up else -1.0) for k in range(len(legs))]
    corners = np.concatenate([[0.0], np.cumsum(np.array(legs) * signs)])
    path = np.interp(np.arange(0.0, len(legs) + 0.01, 0.02), np.arange(len(corners)), corners)
    rows, first = turning_rows(path, 0.1)
    assert rows.tolist() == [50 * (k + 1) for k in range(len(legs) - 1)]
    assert first == signs[0]
    direction, settled = directions(path, 0.1)
    speed = np.gradient(path)
    assert (np.sign(speed[settled]) == direction[settled]).all()
    gone = np.abs(path - np.interp(np.floor(np.arange(len(path)) / 50.0), np.arange(len(corners)), corners))
    assert not settled[(gone < 0.1) & (np.arange(len(path)) % 50 != 0)].any(), "the play is not taken up there"


def test_what_never_turns_has_one_direction() -> None:
    assert turning_rows(np.zeros(5), 0.1)[0].tolist() == []
    assert directions(np.linspace(1.0, 0.0, 50), 0.1)[0].tolist() == [-1.0] * 50


def clocked(degrees: float) -> RecordingClocks:
    source = pair(3, degrees, seconds=120.0)
    stamps = [np.rint(times * 1e9).astype(np.int64) for times in (source.x_times, source.y_times)]
    return RecordingClocks(
        "log",
        "motion",
        (
            Channel("slew.joint", "log.mcap", "machine", stamps[0], source.x, primary=False),
            Channel("slew.joint", "mocap.csv", "mocap", stamps[1], source.y),
        ),
    )


def test_the_record_says_what_was_allowed_for_and_its_residual_is_level() -> None:
    recording = clocked(1.0)
    (record,) = align([recording])
    assert "with backlash of 0.017 (SI) between slew.joint and slew.joint" in record.reason
    assert record.offset_interval95[0] < OFFSET < record.offset_interval95[1]
    rows = [
        pd.DataFrame(
            {
                "recording": "log",
                "source": c.source,
                "domain": c.domain,
                "signal": c.signal,
                "stamp_ns": c.stamps,
                "value": c.values,  # noqa: PD011
            }
        )
        for c in recording.channels
    ]
    (residual,) = clock_residuals(pd.concat(rows), [record])
    assert abs(np.average(residual.shift, weights=residual.error**-2.0)) < 1e-3
    assert "backlash" not in align([replace(clocked(0.0), name="other")])[0].reason
