"""Resampling: commands are held, measured signals interpolated, gaps stay gaps."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sysid.datasets.channel import Channel
from sysid.datasets.resample import LATE_SHARE, anti_aliased, grid, hold, interpolate, resample


def channel(
    signal: str,
    times: np.ndarray,
    values: np.ndarray,
    interpolation: Literal["linear", "cubic"] = "linear",
    gap: float | None = None,
) -> Channel:
    stamps = np.rint(times * 1e9).astype(np.int64)
    return Channel(signal, "a", "machine", stamps, values, interpolation=interpolation, max_gap_s=gap)


def test_the_grid_ends_where_the_log_ends() -> None:
    np.testing.assert_allclose(grid(0, 1_000_000_000, 10.0), np.arange(11) / 10)
    assert len(grid(0, 999_999_000, 1000.0)) == 1001  # rounded stamps do not cost a sample
    assert len(grid(0, 0, 10.0)) == 1


def test_commands_are_held_and_expire() -> None:
    at = np.arange(0.0, 1.0, 0.1)
    held = hold(np.array([0.15, 0.35]), np.array([1.0, 2.0]), at, 0.1, 0.3)
    np.testing.assert_array_equal(held, [np.nan, np.nan, 1.0, 1.0, 2.0, 2.0, 2.0, np.nan, np.nan, np.nan])


def test_a_command_that_is_late_by_rounding_counts_on_its_own_instant() -> None:
    at = np.arange(5) / 1000.0
    late = at + 2e-8
    np.testing.assert_array_equal(hold(late, np.arange(5.0), at, 1e-3, 0.1), np.arange(5.0))


def test_gaps_longer_than_the_limit_are_not_bridged() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.8, 0.9])
    at = np.arange(10) / 10.0
    values = interpolate(times, np.ones(5), at, 0.3)
    np.testing.assert_array_equal(np.isnan(values), [False, False, False, True, True, True, True, True, False, False])


def test_cubic_interpolation_is_exact_for_parabolas() -> None:
    rng = np.random.default_rng(1)
    times = np.sort(rng.uniform(0, 10, 200))
    at = np.linspace(times[1], times[-2], 500)
    parabola = np.polynomial.Polynomial([1.0, -2.0, 0.5])
    np.testing.assert_allclose(interpolate(times, parabola(times), at, 5.0, cubic=True), parabola(at), atol=1e-9)
    linear = interpolate(times, parabola(times), at, 5.0)
    assert np.abs(linear - parabola(at)).max() > 1e-4


@given(
    st.lists(st.floats(0.001, 0.5), min_size=3, max_size=40),
    st.booleans(),
    st.integers(0, 10_000),
)
@example([0.5, 0.25, 0.19442138246371943, 0.25], False, 0)  # a step of the longest gap, but for rounding
def test_interpolation_stays_between_neighbours_and_never_bridges(steps: list[float], cubic: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(steps)
    values = rng.uniform(-1, 1, len(times))
    values[rng.uniform(size=len(times)) < 0.2] = np.nan
    at = np.linspace(times[0] - 0.5, times[-1] + 0.5, 300)
    result = interpolate(times, values, at, 0.25, cubic=cubic)
    known = times[~np.isnan(values)]
    for instant, value in zip(at, result, strict=True):
        before, after = known[known <= instant], known[known >= instant]
        if len(before) == 0 or len(after) == 0 or after[0] - before[-1] > 0.25 + 1e-9:
            assert np.isnan(value)
        elif not cubic and len(known) >= 2:
            ends = values[np.isin(times, [before[-1], after[0]])]
            assert ends.min() - 1e-9 <= value <= ends.max() + 1e-9
    on_samples = interpolate(times, values, known, 0.25, cubic=cubic)
    if len(known) >= 2:
        np.testing.assert_allclose(on_samples, values[~np.isnan(values)], atol=1e-6)


def test_a_fast_source_is_low_passed_before_it_is_sampled() -> None:
    times = np.arange(0.0, 4.0, 0.001)
    slow, fast = np.sin(2 * np.pi * times), 0.5 * np.sin(2 * np.pi * 95.0 * times)
    at = np.arange(0.5, 3.5, 0.01)
    aliased = interpolate(times, slow + fast, at, 0.003)
    filtered = resample(channel("boom.joint", times, slow + fast), times, at, 100.0, 0.5)
    assert np.abs(aliased - np.sin(2 * np.pi * at)).max() > 0.3
    assert np.abs(filtered - np.sin(2 * np.pi * at)).max() < 0.02


def at_frequency(rate: float, hz: float, uneven: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """What is left on a grid of 100 Hz of a wave sampled at ``rate``, and the wave itself there (complex, ends cut)."""
    rng = np.random.default_rng(3)
    times = np.sort(np.arange(0.0, 4.0, 1.0 / rate) + 3e-4 + rng.uniform(-uneven, uneven, round(4.0 * rate)) / rate)
    times = np.rint(times * 1e9) * 1e-9
    wave, at = np.exp(2j * np.pi * hz * times), np.arange(0.0, 3.9, 0.01)
    made = [resample(channel("boom.joint", times, part), times, at, 100.0, 0.5) for part in (wave.real, wave.imag)]
    inside = slice(50, -50)
    return (made[0] + 1j * made[1])[inside], np.exp(2j * np.pi * hz * at)[inside]


@pytest.mark.parametrize("rate", [190.0, 240.0, 1000.0])
@pytest.mark.parametrize("hz", [50.0, 52.0, 60.0, 75.0, 90.0])
def test_the_stop_band_begins_at_the_nyquist_frequency_of_the_grid(rate: float, hz: float) -> None:
    left, _ = at_frequency(rate, hz)
    assert 20 * np.log10(np.abs(left).max()) < -53.0


@pytest.mark.parametrize(("rate", "uneven"), [(190.0, 0.0), (240.0, 0.0), (1000.0, 0.0), (1000.0, 0.4)])
@pytest.mark.parametrize(("hz", "loss"), [(1.0, 1e-6), (5.0, 1e-4), (20.0, 3e-3), (30.0, 2e-2)])
def test_the_pass_band_is_flat_and_nothing_is_delayed(rate: float, uneven: float, hz: float, loss: float) -> None:
    left, wave = at_frequency(rate, hz, uneven)
    gain = np.vdot(wave, left) / len(wave)
    assert abs(abs(gain) - 1.0) < loss
    assert abs(np.angle(gain)) / (2 * np.pi * hz) < 1e-6  # seconds


def test_a_steady_motion_on_uneven_stamps_stays_one() -> None:
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(1e-3, 9e-3, 800))
    at = np.arange(0.0, 3.5, 0.01)
    made = resample(channel("boom.joint", times, 0.5 * times), times, at, 100.0, 0.5)
    np.testing.assert_allclose(made[20:-20], 0.5 * at[20:-20], atol=1e-9)


def test_filtering_does_not_reach_across_gaps() -> None:
    times = np.concatenate([np.arange(0.0, 1.0, 0.001), np.arange(2.0, 3.0, 0.001)])
    values = np.where(times < 1.5, 0.0, 1.0)
    at = np.arange(0.0, 3.0, 0.01)
    made = anti_aliased(times, values, at, 100.0, 20, 0.01)
    gap = (at > 0.9995) & (at < 1.9995)
    np.testing.assert_array_equal(np.isnan(made), gap)
    np.testing.assert_allclose(made[~gap], np.where(at < 1.5, 0.0, 1.0)[~gap], atol=1e-12)


@given(st.integers(1, 60), st.integers(0, 1000))
def test_a_short_stretch_of_a_fast_source_stays_within_what_it_was(length: int, seed: int) -> None:
    values = np.random.default_rng(seed).uniform(-1, 1, length)
    times = np.arange(length) / 1000.0
    made = anti_aliased(times, values, np.arange(10) / 100.0, 100.0, 20, 0.003)
    assert np.isnan(made[at_or_after(length)]).all()
    assert np.nanmax(np.abs(made), initial=0.0) < 3.0


def at_or_after(length: int) -> slice:
    """Grid instants after the last of ``length`` samples at 1 kHz."""
    return slice((length - 1) // 10 + 1, None)


values_strategy = st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=60)


@given(values_strategy, st.sampled_from(["linear", "cubic"]), st.sampled_from(["boom.joint", "boom.command"]))
def test_resampling_twice_is_resampling_once(values: list[float], interpolation: Literal["linear", "cubic"], name: str) -> None:
    rng = np.random.default_rng(len(values))
    times = np.cumsum(rng.uniform(0.004, 0.03, len(values)))
    at = np.arange(np.ceil(times[-1] * 100) + 1) / 100.0
    once = resample(channel(name, times, np.array(values), interpolation), times, at, 100.0, 0.1)
    twice = resample(channel(name, at, once, interpolation, gap=0.03), at, at, 100.0, 0.0)
    np.testing.assert_allclose(twice, once, atol=1e-9)


@given(values_strategy, st.integers(-(10**6), 10**6), st.sampled_from([25.0, 100.0, 430.0]), st.booleans())
def test_a_shift_in_time_shifts_nothing_else(values: list[float], shift: int, rate: float, command: bool) -> None:
    """Both the stamps and the grid later by whole nanoseconds: the same table."""
    name = "boom.command" if command else "boom.joint"
    times = np.arange(len(values)) / rate + 1.3e-3
    at = np.arange(np.ceil(times[-1] * 100) + 1) / 100.0
    made = [resample(channel(name, times + s, np.array(values)), times + s, at + s, 100.0, 0.1) for s in (0.0, shift * 1e-3)]
    np.testing.assert_allclose(made[1], made[0], atol=1e-5)


@given(st.lists(st.floats(1e-4, 0.4), min_size=1, max_size=40), st.floats(0.0, 0.3))
def test_a_command_is_never_known_before_it_was_sent(steps: list[float], hold_s: float) -> None:
    times = np.cumsum(steps)
    at = np.arange(0.0, times[-1] + 1.0, 0.01)
    held = hold(times, np.arange(len(times), dtype=np.float64), at, 0.01, hold_s)
    known = ~np.isnan(held)
    sent = times[held[known].astype(int)]
    assert np.all(sent <= at[known] + LATE_SHARE * 0.01 + 1e-12)
    assert np.all(at[known] - sent <= hold_s)
    following = np.append(times, np.inf)[held[known].astype(int) + 1]
    assert np.all(following > at[known])  # and it is the last one


def test_commands_are_never_interpolated() -> None:
    times = np.array([0.0, 0.5])
    at = np.arange(6) / 10
    for name, expected in (("boom.command", [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), ("boom.joint", at * 2)):
        made = resample(channel(name, times, np.array([0.0, 1.0]), gap=1.0), times, at, 10.0, 1.0)
        np.testing.assert_allclose(made, expected)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_samples_on_the_grid_are_taken_as_they_are(interpolation: Literal["linear", "cubic"]) -> None:
    times = np.arange(50) / 100.0
    values = np.random.default_rng(0).normal(size=50)
    made = resample(channel("boom.joint", times, values, interpolation), times, times, 100.0, 0.5)
    np.testing.assert_allclose(made, values, atol=1e-12)
