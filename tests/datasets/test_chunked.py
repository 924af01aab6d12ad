"""Statistics computed in chunks are bit-identical to those of the whole signal."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import butter, cheby2, sosfiltfilt

from sysid.datasets import chunked, resample
from sysid.datasets.quality.use import turning_points
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
    assert chunked.median(chunked.copied(signal)) == np.median(signal)
    assert chunked.median_step(signal) == np.median(np.diff(signal))
    assert chunked.deviation(there) == np.std(there)
    assert chunked.mean_square(there) == np.mean(there**2)
    assert chunked.counted(ROWS, lambda a, b: signal[a:b] > 0.5) == np.count_nonzero(signal > 0.5)


@pytest.mark.parametrize("mask", [[], [True], [False], [True, True, False, True], [False, True, True, False], [True] * 4])
def test_stretches(mask: list[bool]) -> None:
    rows = {k for first, last in zip(*chunked.stretches(np.array(mask, bool)), strict=True) for k in range(first, last)}
    assert rows == {k for k, there in enumerate(mask) if there}


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


def test_turning_points(signal: Array) -> None:
    for values in (signal, np.round(signal, 2), np.zeros(ROWS), np.arange(float(ROWS)), signal[:1], signal[:0]):
        changed = values[np.concatenate([[True], np.diff(values) != 0.0])] if len(values) else values
        up = np.diff(changed) > 0.0
        assert turning_points(values, 1e-12) == np.count_nonzero(up[1:] != up[:-1])
