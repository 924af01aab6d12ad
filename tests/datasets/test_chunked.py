"""Statistics computed in chunks are bit-identical to those of the whole signal."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, cheby2, sosfiltfilt

from sysid.datasets import chunked, resample
from sysid.datasets.quality.responses import speed
from sysid.datasets.quality.use import speed_of, turning_points, turning_rows
from sysid.scratch import PIECE

Array = npt.NDArray[np.float64]
ROWS = 2 * PIECE + 1234


@pytest.fixture(scope="module")
def signal() -> Array:
    """A motion with noise that spans several pieces."""
    rng = np.random.default_rng(7)
    return np.sin(np.arange(ROWS) / 400.0) + 0.01 * rng.standard_normal(ROWS)


def with_holes(values: Array) -> Array:
    holes = values.copy()
    for at in (0, 100, PIECE - 3, PIECE + 2, ROWS - 50):
        holes[at : at + 50] = np.nan
    return holes


def test_figures(signal: Array) -> None:
    holes = with_holes(signal)
    there = holes[~np.isnan(holes)]
    np.testing.assert_array_equal(chunked.known(holes), there)
    assert chunked.known(signal) is signal
    for order in (1, 4, 8):
        np.testing.assert_array_equal(chunked.differences(signal, order), np.diff(signal, order))
    for values in (signal, signal[1:], holes, np.array([-0.0, 0.0]), np.array([3, 4, 9, 9])):
        np.testing.assert_array_equal(chunked.median(chunked.copied(values)), np.median(values))
    assert chunked.ends(holes) == (np.nanmin(holes), np.nanmax(holes))
    assert np.isnan(chunked.ends(np.full(9, np.nan))).all()
    for stride in (1, 3, 1000, PIECE + 1):
        np.testing.assert_array_equal(chunked.strided(signal, stride), signal[::stride])
    assert chunked.measured(holes)
    assert not chunked.measured(np.full(9, np.nan))
    assert chunked.median_step(signal) == np.median(np.diff(signal))
    assert chunked.deviation(there) == np.std(there)
    assert chunked.mean_square(there) == np.mean(there**2)
    assert chunked.counted(ROWS, lambda a, b: signal[a:b] > 0.5) == np.count_nonzero(signal > 0.5)


CASES = {
    "smooth": lambda rng, n: rng.standard_normal(n),
    "with ties": lambda rng, n: np.round(rng.standard_normal(n), 1),
    "mostly zero": lambda rng, n: np.where(rng.random(n) < 0.97, 0.0, rng.standard_normal(n)),
    "one value": lambda rng, n: np.zeros(n),
    "in order": lambda rng, n: np.arange(n, dtype=np.float64),
    "with outliers": lambda rng, n: np.where(rng.random(n) < 0.001, -9999.0, 1.0 + 1e-9 * rng.standard_normal(n)),
    "periodic as the sample": lambda rng, n: np.where(np.arange(n) % (n // chunked._SAMPLE) == 0, 1.0, rng.standard_normal(n)),
    "few": lambda rng, n: rng.standard_normal(7),
    "one": lambda rng, n: rng.standard_normal(1),
}


@pytest.mark.parametrize("case", CASES)
def test_quantiles(case: str) -> None:
    values = CASES[case](np.random.default_rng(3), 400_000)
    cut = len(values) // 3
    parts = [(len(own), lambda a, b, own=own: own[a:b]) for own in (values[:cut], values[cut:])]
    for shares in ((0.95,), (0.025, 0.975), (0.0, 1.0), (0.1, 0.5, 0.5001)):
        np.testing.assert_array_equal(chunked.quantiles(parts, shares), np.quantile(values, shares))
    assert chunked.median_of(parts) == np.median(values)
    assert np.isnan(chunked.median_of(parts, least=len(values) + 1))
    assert np.isnan(chunked.quantiles([(100, lambda a, b: np.empty(0))], (0.5,))).all()


def test_a_figure_is_kept_as_long_as_its_read_only_signal() -> None:
    calls: list[int] = []

    @chunked.remembered
    def total(values: Array, times: float) -> float:
        calls.append(len(values))
        return float(values.sum()) * times

    own = np.ones(3)
    assert (total(own, 2.0), total(own, 2.0), len(calls)) == (6.0, 6.0, 2)
    fixed = own.view()
    fixed.setflags(write=False)
    assert (total(fixed, 2.0), total(fixed, 2.0), total(fixed, 3.0), len(calls)) == (6.0, 6.0, 9.0, 4)
    known = len(chunked._results)
    del fixed
    assert len(chunked._results) == known - 1


@pytest.mark.parametrize("mask", [[], [True], [False], [True, True, False, True], [False, True, True, False], [True] * 4])
def test_stretches(mask: list[bool]) -> None:
    rows = {k for first, last in zip(*chunked.stretches(np.array(mask, bool)), strict=True) for k in range(first, last)}
    assert rows == {k for k, there in enumerate(mask) if there}


def test_responses_by_pieces(signal: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    holes = with_holes(signal)[:9000]
    whole, found = (holes, signal[:9000]), []
    for piece in (9000, 1000, 37):
        monkeypatch.setattr("sysid.scratch.PIECE", piece)
        found.append([(speed(values, 100.0), speed_of(values, 100.0)) for values in whole])
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


def test_filters_run_both_ways(signal: Array) -> None:
    for sections, padding in ((cheby2(6, 30.0, 0.25, output="sos"), 64), (butter(4, 0.1, output="sos"), 0)):
        own = signal.copy()
        chunked.sosfiltfilt_in_place(sections, own, padding)
        np.testing.assert_array_equal(own, sosfiltfilt(sections, signal, padlen=padding))
    short = signal[:40].copy()
    chunked.sosfiltfilt_in_place(sections, short, 39)
    np.testing.assert_array_equal(short, sosfiltfilt(sections, signal[:40], padlen=39))


def test_slopes(signal: Array) -> None:
    times = np.arange(ROWS) * 0.01
    times[PIECE - 1 :] += 5.0
    near = slice(PIECE - 50, PIECE + 50)
    expected = resample.slopes(times[near], signal[near], 0.03)[1:-1]
    np.testing.assert_array_equal(resample.slopes(times, signal, 0.03)[PIECE - 49 : PIECE + 49], expected)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 4.0))
def test_as_many_turning_points_as_rows(seed: int, least: float) -> None:
    rng = np.random.default_rng(seed)
    steps = rng.standard_normal(rng.integers(0, 700))
    for values in (steps, np.cumsum(steps), np.round(np.cumsum(steps)), np.cumsum(0.1 * steps)):
        assert turning_points(values, least) == len(turning_rows(values, least))


def test_turning_points(signal: Array) -> None:
    for values in (signal, np.round(signal, 2), np.zeros(ROWS), np.arange(float(ROWS)), signal[:1], signal[:0]):
        changed = values[np.concatenate([[True], np.diff(values) != 0.0])] if len(values) else values
        up = np.diff(changed) > 0.0
        assert turning_points(values, 1e-12) == np.count_nonzero(up[1:] != up[:-1])
