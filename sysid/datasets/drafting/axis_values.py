"""Values of an axis from its motion: the steady speed of a valve axis over its raw command, and the moving mass or inertia of a
force axis. Neither needs a derivative of the measured place.

The speed is ``lag(f(u(t − delay)))`` with ``f`` piecewise linear, and the way over :data:`WINDOW_S` is its integral. ``f``
follows by least squares for every delay and lag; those of the least residual are taken.

The mass follows from ``force = mass · a + viscous · v + Coulomb · sign(v) + load`` times a bump ``p`` that is zero with its
derivatives at both ends of a window, integrated by parts:
``∫ p·force = mass · ∫ p̈·place − viscous · ∫ ṗ·place + Coulomb · ∫ p·sign(v) + load · ∫ p``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from sysid.datasets.chunked import Array, Rows

#: Window of the way, and step from one to the next [s].
WINDOW_S, STEP_S = 0.4, 0.1
#: Knots of the characteristic; weight of its second differences beside the mean square of the regressors.
KNOTS, SMOOTH = 21, 1e-3
#: Lags that are tried first [s], and how often those halfway to the neighbours of the best one are tried then.
LAGS, HALVED = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0), 2
#: Longest delay, and steps in which delays are searched [s].
LONGEST, COARSE, FINE, REACH = 1.5, 0.05, 0.02, 0.16
#: A window counts away from the ends of the range, as a share of it; residuals beyond this multiple of their median do not.
ENDS, FAR = 0.01, 8.0
#: Least number of windows.
FEWEST = 40
#: A motion at rest, as a share of the 95th percentile of its speed; the command then, if it is this share of the rest at least.
RESTS, USUAL = 0.05, 0.25


@dataclass(frozen=True)
class Characteristic:
    """Steady speed [unit of the place / s] at raw commands, both (k,), increasing commands.

    Args:
        delay, lag: of the answer [s].
        rest: raw command while the axis rests, and its share of the rest; NaN where no value is usual then.
        windows: number of windows that were fitted.
    """

    commands: Array
    speeds: Array
    delay: float
    lag: float
    rest: tuple[float, float]
    windows: int

    def at(self, raw: float, zero: float) -> float:
        """Speed at a raw command; beyond the commands of the logs along their outer half, seen from the neutral ``zero``."""
        low, high = float(self.commands[0]), float(self.commands[-1])
        if low <= raw <= high:
            return float(np.interp(raw, self.commands, self.speeds))
        end = low if raw < low else high
        outer = (self.commands - zero) * np.sign(end - zero) >= 0.5 * abs(end - zero)
        if np.count_nonzero(outer) < 2:
            return float(self.speeds[0] if raw < low else self.speeds[-1])
        slope, level = np.polyfit(self.commands[outer], self.speeds[outer], 1)
        return float(level + slope * raw)

    @property
    def crossing(self) -> float:
        """Raw command in the middle of those that do not move the axis; NaN where the speed has one sign."""
        raw = np.linspace(self.commands[0], self.commands[-1], 2001)
        speeds = np.interp(raw, self.commands, self.speeds)
        speeds = speeds * np.sign(speeds[-1] - speeds[0])
        small = RESTS * min(-speeds.min(), speeds.max())
        if not small > 0.0:
            return math.nan
        return 0.5 * float(raw[speeds < -small].max() + raw[speeds > small].min())


def characteristic(parts: Sequence[tuple[Array, Array]], rate_hz: float) -> Characteristic | None:
    """The characteristic from recordings of the raw command and the place on even grids of ``rate_hz``, (n,) each.

    None without enough motion.
    """
    parts = [(u, x) for u, x in parts if len(u) > round((LONGEST + 2.0 * WINDOW_S) * rate_hz)]
    if not parts:
        return None
    low, high = (float(end([end(u) for u, _ in parts])) for end in (np.min, np.max))
    places = np.concatenate([x for _, x in parts])
    ends = float(places.min()), float(places.max())
    if not (high > low and ends[1] > ends[0]):
        return None
    margin = ENDS * (ends[1] - ends[0])
    windows = [_Windows.of(u, x, rate_hz, (low, high), (ends[0] + margin, ends[1] - margin)) for u, x in parts]
    if sum(len(each.way) for each in windows) < FEWEST:
        return None
    coarse = [each.lagged(0.1) for each in windows]
    first = min(np.arange(0.0, LONGEST, COARSE), key=lambda delay: _fitted(windows, coarse, delay)[1])
    tried = {lag: _best_delay(windows, lag, first + 0.1 - lag) for lag in LAGS}
    for _ in range(HALVED):
        lags = sorted(tried)
        at = lags.index(min(tried, key=lambda lag: tried[lag]))
        for lag in (0.5 * (a + b) for a, b in itertools.pairwise(lags[max(at - 1, 0) : at + 2])):
            tried[lag] = _best_delay(windows, lag, first + 0.1 - lag)
    lag = min(tried, key=lambda each: tried[each])
    _, delay = tried[lag]
    speeds, _ = _fitted(windows, [each.lagged(lag) for each in windows], delay, robust=True)
    rest = _rest(parts, windows, delay + lag)
    count = sum(len(each.way) for each in windows)
    return Characteristic(np.linspace(low, high, KNOTS), speeds, delay, lag, rest, count)


def _best_delay(windows: Sequence[_Windows], lag: float, near: float) -> tuple[float, float]:
    """Least mean square of the residual with a lag, and the delay ``near`` which it has [s]."""
    areas = [each.lagged(lag) for each in windows]
    delays = np.arange(max(near - REACH, 0.0), max(near + REACH, 0.0) + 1e-9, FINE)
    return min((_fitted(windows, areas, float(delay))[1], float(delay)) for delay in delays)


@dataclass(frozen=True)
class _Windows:
    """Windows of one recording: first rows (m,), the way in each (m,), and the hats of the knots at each row (n, k)."""

    first: Rows
    way: Array
    hats: Array
    rows: int
    rate_hz: float

    @classmethod
    def of(cls, u: Array, x: Array, rate_hz: float, commands: tuple[float, float], inside: tuple[float, float]) -> _Windows:
        rows, step = round(WINDOW_S * rate_hz), max(round(STEP_S * rate_hz), 1)
        first = np.arange(round(LONGEST * rate_hz) + 1, len(u) - rows, step)
        both = np.stack([x[first], x[first + rows]])
        first = first[((both > inside[0]) & (both < inside[1])).all(axis=0)]
        place = (u - commands[0]) / (commands[1] - commands[0]) * (KNOTS - 1)
        below = np.clip(np.floor(place).astype(np.intp), 0, KNOTS - 2)
        hats = np.zeros((len(u), KNOTS))
        hats[np.arange(len(u)), below] = 1.0 - (place - below)
        hats[np.arange(len(u)), below + 1] = place - below
        return cls(first, x[first + rows] - x[first], hats, rows, rate_hz)

    def lagged(self, lag: float) -> Array:
        """Integrals (n + 1, k) of the hats after a lag."""
        keep = math.exp(-1.0 / (lag * self.rate_hz)) if lag > 0.0 else 0.0
        late = lfilter([1.0 - keep], [1.0, -keep], self.hats, axis=0, zi=keep * self.hats[:1])[0]
        return np.concatenate([np.zeros((1, KNOTS)), np.cumsum(late, axis=0)]) / self.rate_hz

    def regressors(self, areas: Array, delay: float) -> Array:
        """The integrals over each window, (m, k)."""
        begin = self.first - round(delay * self.rate_hz)
        return np.asarray(areas[begin + self.rows] - areas[begin])


def _fitted(windows: Sequence[_Windows], areas: Sequence[Array], delay: float, robust: bool = False) -> tuple[Array, float]:
    """Speeds at the knots (k,) and the mean square of the residual."""
    design = np.concatenate([each.regressors(area, delay) for each, area in zip(windows, areas, strict=True)])
    way = np.concatenate([each.way for each in windows])
    for _ in range(3 if robust else 1):
        square = design.T @ design
        bend = np.diff(np.eye(KNOTS), 2, axis=0)
        weight = SMOOTH * max(float(np.trace(square)), 1e-300)
        speeds = np.linalg.lstsq(square + weight * bend.T @ bend, design.T @ way, rcond=None)[0]
        residual = way - design @ speeds
        if robust:
            usual = float(np.median(np.abs(residual)))
            near = np.abs(residual) <= FAR * usual if usual > 0.0 else np.ones(len(way), dtype=bool)
            design, way = design[near], way[near]
    return speeds, float(np.mean(residual**2))


def _rest(parts: Sequence[tuple[Array, Array]], windows: Sequence[_Windows], late: float) -> tuple[float, float]:
    """The command that is held most ``late`` [s] before the axis rests, and its share of that time; NaN where none is usual."""
    most = float(np.quantile(np.abs(np.concatenate([each.way for each in windows])), 0.95))
    held = [np.empty(0)]
    for u, x in parts:
        rows, before = round(WINDOW_S * windows[0].rate_hz), round(late * windows[0].rate_hz)
        still = np.flatnonzero(np.abs(x[rows:] - x[:-rows]) <= RESTS * most) + rows - before
        held.append(u[still[still >= 0]])
    values, counts = np.unique(np.round(np.concatenate(held), 9), return_counts=True)
    if not len(values) or counts.max() < USUAL * counts.sum():
        return math.nan, 0.0
    return float(values[np.argmax(counts)]), float(counts.max() / counts.sum())


#: Half a window, and step from one to the next [s]; half the width of the difference that gives the direction of motion [s].
HALF_S, MASS_STEP_S, BESIDE_S = 0.3, 0.1, 0.05
#: Speed below which the friction has no sure direction, as a share of the 95th percentile.
SLOW = 0.05
#: Least number of windows, and least share of the force beside friction and load that the acceleration explains.
FEWEST_WINDOWS, SHOWN = 40, 0.5


def moved_mass(parts: Sequence[tuple[Array, Array]], rate_hz: float) -> float:
    """Mass or inertia [SI] from force and place [SI] on even grids of ``rate_hz``, (n,) each; NaN where they do not show it."""
    half, step, beside = (max(round(each * rate_hz), 1) for each in (HALF_S, MASS_STEP_S, BESIDE_S))
    time = np.arange(-half, half + 1) / rate_hz
    share = (time / HALF_S) ** 2
    bump = np.clip(1.0 - share, 0.0, None) ** 4
    first = np.clip(1.0 - share, 0.0, None) ** 3 * (-8.0 * time / HALF_S**2)
    second = np.gradient(first, time)
    moved = [_speed(x, beside, rate_hz) for _, x in parts]
    usual = float(np.quantile(np.abs(np.concatenate([np.empty(0), *moved])), 0.95)) if any(map(len, moved)) else 0.0
    rows = [np.empty((0, 6))]
    for (force, place), rate in zip(parts, moved, strict=True):
        if len(force) < 2 * half + 1:
            continue
        weights = ((force, bump), (place - place.mean(), second), (place - place.mean(), -first),
                   (np.tanh(rate / max(SLOW * usual, 1e-300)), bump), (np.sin(place), bump), (np.cos(place), bump))  # fmt: skip
        rows.append(np.column_stack([np.correlate(values, weight, "valid")[::step] for values, weight in weights]) / rate_hz)
    table = np.concatenate(rows)
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < FEWEST_WINDOWS:
        return math.nan
    others = np.column_stack([np.ones(len(table)), table[:, 2:]])
    basis = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))[0]
    force, acceleration = (column - basis @ (basis.T @ column) for column in table[:, :2].T)
    aa, ff, af = float(acceleration @ acceleration), float(force @ force), float(acceleration @ force)
    if not (aa > 0.0 and ff > 0.0 and af > 0.0) or af / math.sqrt(aa * ff) < SHOWN:
        return math.nan
    return af / aa


def _speed(place: Array, beside: int, rate_hz: float) -> Array:
    """Differences over ``2·beside`` rows [SI/s], (n,)."""
    found = np.zeros(len(place))
    if len(place) > 2 * beside:
        found[beside:-beside] = (place[2 * beside :] - place[: -2 * beside]) * rate_hz / (2.0 * beside)
    return found
