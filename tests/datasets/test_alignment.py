"""Clock offset and skew from motion: known truth, honest intervals, refusals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import butter, sosfiltfilt

from sysid.datasets.channel import Channel
from sysid.datasets.clocks.alignment import MAX_SKEW, Estimate, Pair, conditional, estimate
from sysid.datasets.clocks.coarse import coarse_lag
from sysid.datasets.clocks.records import RecordingClocks, align, machine_times
from sysid.errors import AlignmentError

Array = npt.NDArray[np.float64]


def motion(seconds: float, rng: np.random.Generator, bandwidth: float = 1.0) -> tuple[Array, Array]:
    """Smooth random motion of about unit size on a fine grid from −5 s to ``seconds`` + 5 s."""
    time = np.arange(-5.0, seconds + 5.0, 0.001)
    noise = sosfiltfilt(butter(2, bandwidth, fs=1000.0, output="sos"), rng.normal(size=len(time)))
    return time, noise / noise.std()


def pair(
    seconds: float,
    offset: float,
    skew: float,
    seed: int,
    noise: float = 0.01,
    linkage: bool = False,
    gaps: bool = False,
    bandwidth: float = 1.0,
) -> Pair:
    """x at 100 Hz on the machine's clock, y at 120 Hz on a clock with t_machine = t·(1 + skew) + offset."""
    rng = np.random.default_rng(seed)
    time, truth = motion(seconds, rng, bandwidth)
    x_times = np.arange(0.0, seconds, 0.01)
    y_times = np.arange(0.0, seconds - offset, 1.0 / 120.0)
    x = np.interp(x_times, time, truth)
    y = np.interp(y_times * (1.0 + skew) + offset, time, truth)
    if linkage:
        y = -np.arctan(0.4 * y) * 1.7 + 0.3
    x, y = x + noise * rng.normal(size=len(x)), y + noise * rng.normal(size=len(y))
    if gaps:
        for start in rng.uniform(0.0, seconds, 12):
            y[(y_times > start) & (y_times < start + rng.uniform(0.1, 1.0))] = np.nan
    return Pair(
        "boom.cylinder~boom.joint" if linkage else "slew.joint~slew.joint", x_times, x, y_times, y, 9 if linkage else 7, 0.035
    )


def error_at(result: Estimate, time: float, offset: float, skew: float) -> float:
    """Error of the estimated machine time at stream time ``time`` [s]."""
    return result.mid_offset + result.skew * (time - result.mid_time) - (offset + skew * time)


@pytest.mark.parametrize("linkage", [False, True])
@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize(("offset", "skew"), [(0.0123, 40e-6), (-3.7311, -180e-6), (2.5, 0.0)])
def test_offset_and_skew_are_found_far_below_a_sample(offset: float, skew: float, gaps: bool, linkage: bool) -> None:
    result = estimate([pair(120.0, offset, skew, seed=3, gaps=gaps, linkage=linkage)])
    assert result.refused == ""
    assert abs(error_at(result, result.mid_time, offset, skew)) < 0.2e-3
    assert abs(error_at(result, 120.0, offset, skew)) < 0.5e-3
    assert abs(result.skew - skew) < 6e-6


@pytest.mark.slow
def test_the_figures_published_by_simulation_are_reached() -> None:
    """300 s of 1 Hz motion, 100 against 120 Hz, +40 ppm, with and without gaps: 0.04-0.08 ms RMS are the figures to reach."""
    for gaps in (False, True):
        middle, end = [], []
        for seed in range(6):
            result = estimate([pair(300.0, 0.4, 40e-6, seed=seed, gaps=gaps)])
            middle.append(error_at(result, 150.0, 0.4, 40e-6))
            end.append(error_at(result, 300.0, 0.4, 40e-6))
        assert np.sqrt(np.mean(np.square(middle))) < 0.08e-3
        assert np.sqrt(np.mean(np.square(end))) < 0.16e-3


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    from scipy.stats import t

    inside_offset, inside_skew, runs = 0, 0, 30
    for seed in range(runs):
        result = estimate([pair(60.0, 0.3, 60e-6, seed=100 + seed, noise=0.02, linkage=seed % 2 == 0)])
        quantile = t.ppf(0.975, result.degrees_of_freedom)
        error = error_at(result, result.mid_time, 0.3, 60e-6)
        inside_offset += abs(error) < quantile * np.sqrt(result.covariance[0, 0])
        inside_skew += abs(result.skew - 60e-6) < quantile * np.sqrt(result.covariance[1, 1])
    assert inside_offset >= 0.85 * runs
    assert inside_skew >= 0.85 * runs


def test_mistaken_frames_hardly_move_the_estimate() -> None:
    clean = pair(60.0, 0.5, 50e-6, seed=5)
    spoiled = clean.y.copy()
    spoiled[2000:2050] += 1.5
    spoiled[::400] -= 3.0
    result = estimate([Pair(clean.name, clean.x_times, clean.x, clean.y_times, spoiled, clean.degree, clean.x_gap_s)])
    assert abs(error_at(result, result.mid_time, 0.5, 50e-6)) < 0.4e-3


def test_several_pairs_together_are_better_than_each() -> None:
    pairs = [pair(60.0, 1.0, 30e-6, seed=seed, noise=0.05) for seed in (1, 2, 3, 4)]
    together = estimate(pairs)
    alone = [estimate([each]) for each in pairs]
    assert together.covariance[0, 0] < min(each.covariance[0, 0] for each in alone)
    assert abs(error_at(together, together.mid_time, 1.0, 30e-6)) < 0.3e-3


def test_nothing_shared_nothing_moving_and_motion_that_repeats_are_refused() -> None:
    assert "no joint or cylinder is measured on both clocks" in estimate([]).refused
    moving = pair(60.0, 0.0, 0.0, seed=1)
    rng = np.random.default_rng(0)
    still = Pair("a~a", moving.x_times, 0.001 * rng.normal(size=len(moving.x)), moving.y_times, moving.y, 7, 0.035)
    assert "nothing moves that both clocks have seen (a~a)" in estimate([still]).refused
    x_times, y_times = np.arange(0.0, 60.0, 0.01), np.arange(0.0, 60.0, 1 / 120)
    periodic = Pair("a~a", x_times, np.sin(2.0 * x_times), y_times, np.sin(2.0 * y_times + 0.3), 7, 0.035)
    assert "the motion repeats itself" in estimate([periodic]).refused
    other = pair(60.0, 0.0, 0.0, seed=2)
    unrelated = Pair("a~a", moving.x_times, moving.x, other.y_times, other.y, 7, 0.035)
    assert "do not agree at the best lag" in estimate([unrelated]).refused


def test_a_broken_sensor_does_not_spoil_what_the_others_know() -> None:
    good, broken = pair(60.0, 0.7, 20e-6, seed=1), pair(60.0, 0.7, 20e-6, seed=2)
    wrong = broken.y.copy()
    wrong[3000:] = motion(60.0, np.random.default_rng(9))[1][: len(wrong) - 3000]
    result = estimate([good, Pair("broken~broken", broken.x_times, broken.x, broken.y_times, wrong, 7, 0.035)])
    assert result.used == ("slew.joint",)
    assert abs(error_at(result, result.mid_time, 0.7, 20e-6)) < 0.3e-3


EPOCH = 1_700_000_000_000_000_000


def clocked(
    name: str, seconds: float, offset: float, skew: float, seed: int, other_epoch: int = 0, still: bool = False
) -> RecordingClocks:
    source = pair(seconds, offset, skew, seed)
    x = np.zeros(len(source.x)) if still else source.x
    machine = Channel(
        "slew.joint", "log.mcap", "machine", EPOCH + np.rint(source.x_times * 1e9).astype(np.int64), x, primary=False
    )
    stamps = other_epoch + np.rint(source.y_times * 1e9).astype(np.int64)
    return RecordingClocks(name, "motion", (machine, Channel("slew.joint", "mocap.csv", "mocap", stamps, source.y)))


def test_the_skew_of_a_device_is_shared_by_its_recordings() -> None:
    recordings = [clocked(f"r{k}", 60.0, 0.2 * k, 45e-6, seed=k) for k in range(4)]
    records = align(recordings)
    assert len({record.skew_ppm for record in records}) == 1
    for k, (record, recording) in enumerate(zip(records, recordings, strict=True)):
        assert record.applied
        assert "common to 4 recordings" in record.reason
        assert "latency" in record.reason
        low, high = record.offset_interval95
        assert low < record.offset_s < high
        assert abs(record.offset_s - 0.2 * k) < 1e-3
        assert abs(record.skew_ppm - 45.0) < 5.0
        # The record can be applied to any channel of that clock, and undone.
        channel = recording.channels[1]
        times = machine_times(channel, recording.start_ns, [record])
        back = (times - record.offset_s) / (1.0 + 1e-6 * record.skew_ppm)
        np.testing.assert_allclose(back * 1e9 + record.stream_start_ns, channel.stamps, atol=2.0)


def test_skews_that_contradict_each_other_are_kept_apart() -> None:
    records = align([clocked("a", 120.0, 0.1, 150e-6, seed=1), clocked("b", 120.0, 0.1, -150e-6, seed=2)])
    assert [round(record.skew_ppm / 10) for record in records] == [15, -15]
    assert "differs between recordings" in records[0].reason


def test_a_skew_that_cannot_be_known_is_not_applied() -> None:
    (record,) = align([clocked("short", 14.0, 0.3, 100e-6, seed=3)])
    assert record.applied
    assert record.skew_ppm == 0.0
    assert "skew not applied: known to ±" in record.reason
    assert record.skew_interval95[0] < 100.0 < record.skew_interval95[1]


def test_a_log_of_half_a_minute_is_too_short_for_a_skew_however_sure_it_looks() -> None:
    source = clocked("short", 30.0, 0.3, 100e-6, seed=3)
    rng = np.random.default_rng(0)
    clean = [replace(c, values=np.asarray(c.values) - 0.0) for c in source.channels]
    time, truth = motion(30.0, rng, 3.0)
    for k, channel in enumerate(clean):
        at = (channel.stamps - channel.stamps[0]) * 1e-9
        at = at if k == 0 else at * (1.0 + 100e-6) + 0.3
        clean[k] = replace(channel, values=np.interp(at, time, truth) + 1e-4 * rng.normal(size=len(at)))
    (record,) = align([replace(source, channels=tuple(clean))])
    assert record.skew_ppm == 0.0
    assert record.skew_interval95[1] - record.skew_interval95[0] < 60.0
    assert "30 s are too short for one (at least 45 s)" in record.reason
    assert record.offset_interval95[0] < 0.3 < record.offset_interval95[1], "what the skew may be widens the offset"


def test_a_log_that_is_too_short_is_refused_with_the_reason() -> None:
    source = pair(60.0, 0.3, 0.0, seed=3)
    part = Pair(source.name, source.x_times, source.x, source.y_times[:600], source.y[:600], 7, 0.035)
    assert "only 3 blocks of 2 s overlap: too short for an interval" in estimate([part]).refused


def test_an_hour_with_a_large_skew_is_followed_to_its_ends() -> None:
    """At 2 Hz a skew of 180 ppm moves the ends of an hour by more than half a period."""
    result = estimate([pair(3600.0, 0.7, 180e-6, seed=4, bandwidth=2.0)])
    assert abs(error_at(result, 0.0, 0.7, 180e-6)) < 0.1e-3
    assert abs(error_at(result, 3600.0, 0.7, 180e-6)) < 0.1e-3


def test_slow_motion_with_noise_has_honest_errors() -> None:
    """Noise in the rate of slow motion is larger than the rate: it must not count as knowledge."""
    errors = []
    for seed in range(12):
        result = estimate([pair(60.0, 0.3, 0.0, seed=300 + seed, noise=0.03, bandwidth=0.2)])
        if not result.refused:
            errors.append(error_at(result, result.mid_time, 0.3, 0.0) / np.sqrt(result.covariance[0, 0]))
    assert len(errors) >= 10
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


def test_stamps_without_shared_motion_are_refused_or_taken_as_they_are() -> None:
    with pytest.raises(AlignmentError, match=r"recording r: mocap\.csv: its clock cannot be aligned .*nothing moves"):
        align([clocked("r", 60.0, 0.0, 0.0, seed=1, still=True)])
    (record,) = align([clocked("r", 60.0, 0.0, 0.0, seed=1, still=True, other_epoch=EPOCH + 2_000_000_000)])
    assert not record.applied
    assert record.offset_s == pytest.approx(2.0)
    assert "taken as they are" in record.reason


def test_of_two_lags_that_look_alike_the_one_whose_positions_agree_is_taken() -> None:
    """Strokes of one second that differ in length alone: their rates repeat themselves, where they end does not."""
    rng = np.random.default_rng(11)
    times = np.arange(0.0, 60.0, 0.01)
    strokes = 1.0 + 0.15 * rng.standard_normal(60)
    x = np.cumsum(np.sin(2 * np.pi * times) * strokes[times.astype(int)]) * 0.01
    y_times = np.arange(0.0, 55.0, 1.0 / 60.0)
    y = np.interp(y_times + 2.4, times, x) + 1e-4 * rng.standard_normal(len(y_times))
    pair = Pair("boom.joint~boom.joint", times, x + 1e-4 * rng.standard_normal(len(x)), y_times, y, 7, 0.035)
    assert "the motion repeats itself" in coarse_lag([pair]).refused
    found = estimate([pair])
    assert not found.refused
    assert found.at(30.0) == pytest.approx(2.4, abs=2e-3)


def test_strokes_that_go_the_other_way_or_less_far_are_others() -> None:
    """Three strokes between long rests, out, back and out: a polynomial maps any of them on any other, one to one does not."""
    rng = np.random.default_rng(5)
    times = np.arange(0.0, 46.0, 0.01)
    x = np.zeros(len(times))
    for begin, size in ((1.0, 0.92), (16.0, -0.81), (31.0, 0.97)):
        x += 0.1 * size * np.clip((times - begin) / 2.0, 0.0, 1.0)
    y_times = np.arange(0.0, 46.0, 1.0 / 60.0)
    pairs = []
    for name, map_ in (
        ("telescope.joint~telescope.joint", lambda v: v),
        ("boom.cylinder~boom.joint", lambda v: np.sin(9.0 * v)),
    ):
        y = map_(np.interp(y_times + 0.9, times, x)) + 1e-4 * rng.standard_normal(len(y_times))
        degree = 7 if name.startswith("telescope") else 9
        pairs.append(Pair(name, times, x + 2e-5 * rng.standard_normal(len(x)), y_times, y, degree, 0.035))
    lag = coarse_lag(pairs)
    assert "the motion repeats itself" in lag.refused
    assert len(lag.alternatives) >= 3
    found = estimate(pairs)
    assert not found.refused
    assert found.at(20.0) == pytest.approx(0.9, abs=2e-3)
    # The cylinder and its joint alone say it as well: two strokes on are as like, and leave two in three without a counterpart.
    assert estimate(pairs[1:]).at(20.0) == pytest.approx(0.9, abs=2e-3)


def test_a_lag_at_which_most_of_the_motion_meets_nothing_is_no_rival() -> None:
    """The last stroke passes for the first one, two for what nobody saw; one stroke less in common may be true."""
    rng = np.random.default_rng(6)
    times, y_times = np.arange(0.0, 46.0, 0.01), np.arange(0.0, 46.0, 1.0 / 60.0)

    def pair(strokes: Sequence[tuple[float, float]]) -> Pair:
        x = np.sum([0.1 * size * np.clip((times - begin) / 2.0, 0.0, 1.0) for begin, size in strokes], axis=0)
        y = np.interp(y_times + 0.9, times, x) + 1e-4 * rng.standard_normal(len(y_times))
        return Pair("boom.joint~boom.joint", times, x + 2e-5 * rng.standard_normal(len(x)), y_times, y, 7, 0.035)

    between_rests = pair([(2.0, 0.92), (17.0, -0.81), (32.0, 0.92)])
    assert "the motion repeats itself" in coarse_lag([between_rests]).refused
    found = estimate([between_rests])
    assert not found.refused
    assert found.at(20.0) == pytest.approx(0.9, abs=2e-3)
    assert "the motion repeats itself" in estimate([pair([(2.0, 0.92), (17.0, 0.92), (32.0, 0.92)])]).refused


def test_a_skew_that_little_motion_tells_badly_refuses_nothing() -> None:
    """One joint makes four small strokes: its skew comes out as any, within its interval; the other recordings know better."""
    times, y_times = np.arange(0.0, 46.0, 0.01), np.arange(0.0, 46.0, 1.0 / 60.0)
    beyond = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        x = np.sum(
            [0.05 * size * np.clip(times - at, 0.0, 1.0) for at, size in ((9, 1), (18, 0.7), (25, -1.2), (33, 0.4))], axis=0
        )
        y = np.interp(y_times + 0.9, times, x) + 4e-3 * rng.standard_normal(len(y_times))
        found = estimate([Pair("slew.joint~slew.joint", times, x + 1e-4 * rng.standard_normal(len(x)), y_times, y, 7, 0.035)])
        assert not found.refused
        beyond += abs(found.skew) > MAX_SKEW
        known = conditional(found, 0.0)
        assert abs(known.at(22.0) - 0.9) < 4.0 * known.variance_at(22.0) ** 0.5
    assert beyond > 0, "none of them is what this is about"
