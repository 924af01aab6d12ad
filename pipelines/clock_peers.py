"""The usual methods for the offset between two clocks, compared with `sysid`: 300 s, 1 Hz, 100 and 120 Hz, +40 ppm."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from clock_simulation import OTHER_HZ, motion
from sysid.datasets.clocks.alignment import Pair, estimate

Array = npt.NDArray[np.float64]

SECONDS, HERTZ, SKEW, OFFSET = 300.0, 1.0, 40e-6, 0.4
#: Noise in standard deviations of the motion: that at which plain least squares has the published 0.043 and 0.076 ms.
NOISE = 0.017
#: Stretches without a measurement, which trackers fill by straight lines [s].
GAPS, GAP_S = 12, (0.1, 1.0)
PEERS = {"seconds": SECONDS, "hertz": HERTZ, "skew_ppm": 1e6 * SKEW, "noise": NOISE, "gaps": GAPS, "gap_s": list(GAP_S)}


def recorded(seed: int, gaps: bool) -> tuple[Pair, Pair, float]:
    """A pair as it was measured, the same with its gaps filled by straight lines, and the true offset."""
    rng = np.random.default_rng(seed)
    offset = OFFSET + rng.uniform(0.0, 0.01)
    curve = motion(SECONDS, HERTZ, rng)
    x_times, y_times = np.arange(0.0, SECONDS, 0.01), np.arange(0.0, SECONDS - offset, 1.0 / OTHER_HZ)
    x = curve(x_times) + NOISE * rng.normal(size=len(x_times))
    y = curve(y_times * (1.0 + SKEW) + offset) + NOISE * rng.normal(size=len(y_times))
    missing = np.zeros(len(y), dtype=bool)
    if gaps:
        for start in rng.uniform(0.0, SECONDS, GAPS):
            missing |= (y_times > start) & (y_times < start + rng.uniform(*GAP_S))
    missing[[0, -1]] = False
    pair = Pair("slew.joint~slew.joint", x_times, x, y_times, np.where(missing, np.nan, y), 7, 0.035)
    filled = np.interp(y_times, y_times[~missing], y[~missing])
    return pair, Pair(pair.name, x_times, x, y_times, filled, 7, 0.035), offset


def correlation(pair: Pair, sub_sample: bool) -> tuple[float, float]:
    """Offset and skew (none) from the peak of the cross-correlation at the machine's rate, or of a parabola through it."""
    y = np.interp(pair.x_times, pair.y_times, pair.y)
    size = 2 * len(y)
    cross = np.fft.irfft(np.fft.rfft(pair.x - pair.x.mean(), size) * np.conj(np.fft.rfft(y - y.mean(), size)), size)
    best = int(np.argmax(cross))
    lag = float(best - size if best > size // 2 else best)
    if sub_sample:
        before, at, after = cross[best - 1], cross[best], cross[(best + 1) % size]
        lag += 0.5 * float((before - after) / (before - 2.0 * at + after))
    return 0.01 * lag, 0.0


def fitted(pair: Pair, loss: str = "linear") -> tuple[float, float]:
    """Offset and skew by least squares on x, interpolated linearly, from the sub-sample peak."""
    start, _ = correlation(pair, True)
    mid = SECONDS / 2.0
    weights = np.column_stack([np.ones_like(pair.y), (pair.y_times - mid) / mid])
    rate = np.gradient(pair.x, pair.x_times)

    def at(theta: Array) -> Array:
        return np.asarray(pair.y_times + weights @ theta)

    def residual(theta: Array) -> Array:
        return np.asarray(pair.y - np.interp(at(theta), pair.x_times, pair.x))

    def slopes(theta: Array) -> Array:
        return np.asarray(-np.interp(at(theta), pair.x_times, rate)[:, None] * weights)

    found = least_squares(residual, [start, 0.0], slopes, loss=loss, f_scale=2.0 * NOISE, xtol=1e-10, ftol=1e-12)
    return float(found.x[0] - found.x[1]), float(found.x[1]) / mid


def ours(pair: Pair) -> tuple[float, float]:
    found = estimate([pair])
    return found.at(0.0), found.skew


def peer_rows(seed: int, seeds: int) -> list[dict[str, Any]]:
    """RMS errors of every method; for all but `sysid` gaps are interpolated, as trackers do."""
    errors: dict[str, dict[str, list[float]]] = {}
    for gaps in (False, True):
        for k in range(seeds):
            measured, filled, true = recorded(seed + k, gaps)
            for way, (found, skew) in {
                "integer-lag correlation": correlation(filled, False),
                "sub-sample peak": correlation(filled, True),
                "least squares, offset + skew": fitted(filled),
                "the same with soft-L1 loss": fitted(filled, "soft_l1"),
                "`sysid`": ours(measured),
            }.items():
                for name, at in (("mid", SECONDS / 2.0), ("end", SECONDS)):
                    key = f"{'gaps_' if gaps else ''}{name}_ms"
                    errors.setdefault(way, {}).setdefault(key, []).append(1e3 * (found - true + (skew - SKEW) * at))
    return [
        {"way": way, **{key: float(np.sqrt(np.mean(np.square(values)))) for key, values in of_way.items()}}
        for way, of_way in errors.items()
    ]
