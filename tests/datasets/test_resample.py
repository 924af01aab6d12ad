"""Resampling: commands are held, measured signals interpolated, gaps stay gaps."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sysid.datasets.channel import Channel
from sysid.datasets.resample import grid, hold, interpolate, low_pass, resample


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


def test_filtering_does_not_reach_across_gaps() -> None:
    times = np.concatenate([np.arange(0.0, 1.0, 0.001), np.arange(2.0, 3.0, 0.001)])
    values = np.where(times < 1.5, 0.0, 1.0)
    np.testing.assert_allclose(low_pass(times, values, 20.0, 0.01), values, atol=1e-9)


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
