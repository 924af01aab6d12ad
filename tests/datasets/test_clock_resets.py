"""Clocks that were set, paused or overflowed while they recorded are detected and split; others are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from sysid.datasets.channel import Channel, in_order
from sysid.datasets.clocks.records import RecordingClocks, align, by_source, machine_times
from sysid.datasets.clocks.set_clocks import continued, with_continued_stamps
from sysid.errors import AlignmentError, InputError
from sysid.logs import Stream
from tests.datasets.test_alignment import EPOCH, motion

Stamps = npt.NDArray[np.int64]
Array = npt.NDArray[np.float64]
EVEN = EPOCH + np.arange(6000, dtype=np.int64) * 10_000_000


def test_stamps_that_are_late_double_or_even_are_left_alone() -> None:
    assert continued(EVEN).stamps is EVEN
    late = EVEN.copy()
    late[[100, 101]] = late[[101, 100]]
    late[3000:3020] = np.roll(late[3000:3020], 7)
    found = continued(late)
    assert found.rows == ()
    np.testing.assert_array_equal(found.stamps, late)
    rows, out_of_order = in_order(late, "here")
    np.testing.assert_array_equal(late[rows], EVEN)
    assert out_of_order == 2
    forward = EVEN + np.where(np.arange(6000) >= 3000, 2_000_000_000, 0)
    assert continued(forward).stamps is forward, "forward may be a pause: only the motion can tell"


@pytest.mark.parametrize("back_s", [0.3, 2.0, 1e9])
def test_a_clock_that_was_set_back_is_carried_on(back_s: float) -> None:
    stamps = EVEN.copy()
    stamps[3000:] -= round(back_s * 1e9)
    found = continued(stamps)
    assert found.rows == (3000,)
    np.testing.assert_allclose(found.stamps, EVEN, atol=1)
    assert f"stamps go back by {back_s - 0.01:.3f} s in row 3001" in found.texts[0]
    assert "the clock was set" in found.texts[0]
    with pytest.raises(InputError, match=r"log: (its clock was set back|stamps go back in time)"):
        in_order(stamps, "log")


def test_a_counter_that_runs_over_is_unwrapped_exactly() -> None:
    true = 4_000_000_000_000 + np.arange(60_000, dtype=np.int64) * 10_000_000  # passes 2³² µs once
    found = continued(true % ((1 << 32) * 1000))
    np.testing.assert_array_equal(np.diff(found.stamps), 10_000_000)
    assert found.periods_ns == ((1 << 32) * 1000,)
    assert "a counter overflowed" in found.texts[0]


def test_a_single_stray_stamp_is_no_clock_that_was_set() -> None:
    stamps = EVEN.copy()
    stamps[50] += 10**12
    stamps[900] = 0
    found = continued(stamps)
    assert (found.rows, found.stray) == ((), 2)
    rows, late = in_order(found.stamps, "here")
    assert (len(rows), late) == (5998, 0)


def test_all_topics_of_a_file_are_carried_on_and_the_machine_is_not() -> None:
    stamps = EVEN.copy()
    stamps[3000:] -= 2_000_000_000
    streams = [Stream("a", "csv", {"time": stamps}, {"x": np.zeros(6000)}), Stream("b", "csv", {"time": EVEN}, {})]
    first, second = with_continued_stamps(streams, None, machine=False)
    np.testing.assert_allclose(first.stamps["time"], EVEN, atol=1)
    assert second is streams[1]
    assert any("the clock was set" in loss for loss in first.losses)
    assert with_continued_stamps(streams, None, machine=True)[0] is streams[0]


def set_clock(
    seconds: float, at: float, jump: float, pause: float = 0.0, bandwidth: float = 1.0, seed: int = 1, skew: float = 40e-6
) -> tuple[RecordingClocks, Array]:
    """slew.joint on both clocks; the other one begins 0.5 s later, at ``at`` stops for ``pause`` and its stamps step by
    ``jump`` beyond the even ones. True machine times beside."""
    rng = np.random.default_rng(seed)
    time, truth = motion(seconds, rng, bandwidth)
    x_times = np.arange(0.0, seconds, 0.01)
    even = np.arange(0.0, seconds - 1.0 - pause, 1.0 / 120.0)
    after = even >= at
    machine = even * (1.0 + skew) + 0.5 + pause * after
    stamps = EPOCH + np.rint((even + jump * after) * 1e9).astype(np.int64)
    x = np.interp(x_times, time, truth) + 0.01 * rng.normal(size=len(x_times))
    y = np.interp(machine, time, truth) + 0.01 * rng.normal(size=len(machine))
    channels = (
        Channel("slew.joint", "log.mcap", "machine", EPOCH + np.rint(x_times * 1e9).astype(np.int64), x, primary=False),
        Channel("slew.joint", "mocap.csv", "mocap", stamps, y),
    )
    return RecordingClocks("take", "motion", channels), machine


@pytest.mark.parametrize(
    ("jump", "pause"), [(1.7, 0.0), (0.0, 2.3), (0.0, 0.05), (0.012, 0.0)], ids=["set", "paused", "lost frames", "12 ms"]
)
def test_a_step_of_the_clock_is_found_on_its_sample(jump: float, pause: float) -> None:
    recording, truth = set_clock(90.0, 40.0, jump, pause)
    records = align([recording])
    assert len(records) == 2
    channel = recording.channels[1]
    assert int(np.searchsorted(channel.stamps, records[1].stream_start_ns)) == int(np.searchsorted(truth, 40.5))
    assert f"its clock was set by {jump - pause:+.3f}" in records[1].reason
    assert records[0].skew_ppm == records[1].skew_ppm != 0.0, "one crystal"
    times = machine_times(channel, recording.start_ns, by_source(records, "take")["mocap.csv"])
    assert np.all(np.diff(times) > 0.0)
    assert np.abs(times - truth).max() < 0.5e-3
    for record, row in zip(records, (0, int(np.searchsorted(truth, 40.5))), strict=True):
        low, high = record.offset_interval95
        assert low < truth[row] < high


def test_two_steps_make_three_pieces() -> None:
    recording, truth = set_clock(200.0, 60.0, 1.0, bandwidth=2.0)
    channel = recording.channels[1]
    stamps = channel.stamps + np.where(truth > 130.0, -400_000_000, 0)
    recording = replace(recording, channels=(recording.channels[0], replace(channel, stamps=continued(stamps).stamps)))
    again, _ = set_clock(200.0, 60.0, 1.0, bandwidth=2.0)
    assert len(align([recording])) == 2, "set back without a pause: continued"
    stamps = channel.stamps + np.where(truth > 130.0, 400_000_000, 0)
    records = align([replace(again, channels=(again.channels[0], replace(channel, stamps=stamps)))])
    assert [record.applied for record in records] == [True, True, True]
    times = machine_times(channel, recording.start_ns, None)
    assert times[-1] != pytest.approx(truth[-1], abs=0.1)
    moved = replace(channel, stamps=stamps)
    assert np.abs(machine_times(moved, recording.start_ns, records) - truth).max() < 0.5e-3


def test_gaps_outliers_and_rest_are_no_steps() -> None:
    recording, truth = set_clock(120.0, 60.0, 0.0)
    machine, channel = recording.channels
    values = channel.values.copy()
    values[4000:4400] = np.nan
    values[::300] += 2.0
    values[9000:9060] += 0.8
    keep = np.ones(len(values), dtype=bool)
    keep[7000:7600] = False  # a pause that the stamps know of
    spoiled = replace(channel, stamps=channel.stamps[keep], values=values[keep])
    (record,) = align([replace(recording, channels=(machine, spoiled))])
    assert record.applied
    assert np.abs(machine_times(spoiled, recording.start_ns, [record]) - truth[keep]).max() < 0.5e-3


def test_a_machine_whose_clock_was_set_is_refused() -> None:
    recording, _ = set_clock(90.0, 40.0, 0.0)
    machine, other = recording.channels
    stepped = machine.stamps + np.where(np.arange(len(machine.stamps)) >= 5000, 1_500_000_000, 0)
    with pytest.raises(AlignmentError, match=r"the machine's clock: it was set by \+1\.500 s at about 5[01]\.") as error:
        align([replace(recording, channels=(replace(machine, stamps=stepped), other))])
    assert "mocap.csv continued evenly" in str(error.value)
    assert "Cut the log there into two recordings" in str(error.value)
