"""Delay of the machine's response: measured motion compared with the plant's response to the commands sent.

For each axis, the measurements of the last :data:`WINDOW_S` are compared with ``y(t) = c + g·x(t − τ)``; x is the travel by the
commands through the plant's valve after its dead time, τ the delay beyond that dead time, of commands and readings together. It
needs no stamp, and may have begun within the window: τ = 0 until :data:`SINCE_S` ago. Free parameters are the position c, the
gain g within :data:`GAINS`, and the difference of the dead-bands from the plant's.

An axis is late if every τ up to half of the accepted delay leaves an error above :data:`LEAST_S` at top speed and half of its
play, and a τ of at least the accepted delay leaves at most :data:`SHARE` of it, :data:`REPEATS` times in a row.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid_rl.run.response_range import Tolerance
from sysid_rl.run.valves import AxisValve, ValveArray

Array = npt.NDArray[np.float64]

#: Window of the comparison, and the longest delay of the search [s]; the check ``motion`` detects longer ones.
WINDOW_S, LONGEST_S = 0.8, 0.4
#: Grid of the delays, interval of the comparisons of an axis, and sampling interval of the readings [s].
STEP_S, EVERY_S, SAMPLE_S = 0.04, 0.05, 0.02
#: Possible beginnings of a delay within the window [s ago].
SINCE_S = (0.15, 0.3, 0.5)
#: Comparisons in a row that must find a delay.
REPEATS = 2
#: Range of the true gain over the plant's.
GAINS = (0.7, 1.4)
#: True dead-band minus the plant's [command], for each direction separately: from the first to the second, wider by the
#: tolerance, in steps of at least the third and at most so many.
BANDS, MOST_BANDS = (-0.08, 0.16, 0.02), 16
#: Late responses use every fourth of them. A slow command crosses a wrong dead-band late, so that a response in time needs the
#: finer grid.
COARSE = 4
#: RMS errors as time at top speed [s]: smallest unexplained error, and residual that noise and model may leave.
LEAST_S, FLOOR_S = 0.006, 0.0015
#: Largest share of the error that remains with the delay.
SHARE = 1.0 / 3.0
#: Share of the window with fresh readings that a comparison needs.
ENOUGH = 0.6
#: Residual of a response that model and noise leave in a comparison of gains, as time at top speed [s].
RESIDUAL_S = 0.0007
#: Gains that count as a wrong scale or another valve: at most, and at least. Logarithm of the likelihood ratio by which gains
#: within :data:`GAINS` or these are excluded, and fewest samples for that, and length of an interval [s].
OTHER_GAINS, ODDS, FEWEST, INTERVAL_S = (0.55, 1.8), 6.0, 25, 0.4


@dataclass(frozen=True)
class LateAxis:
    """A late axis: by ``seconds`` beyond the plant's dead time."""

    axis: int
    seconds: float


class ResponseMonitor:
    """The comparison for all axes of one machine.

    Args:
        valves: of the axes, from the plant.
        dt: of a cycle [s].
        tolerance: of the machine.
    """

    def __init__(self, valves: Sequence[AxisValve], dt: float, tolerance: Tolerance) -> None:
        self.dt, axes, accepted = dt, len(valves), tolerance.delay_s
        low, high, step = BANDS[0], BANDS[1] + tolerance.wider, BANDS[2]
        #: Differences of the dead-bands that are compared, (bands,).
        self.bands = np.linspace(low, high, 1 + min(round((high - low) / step), MOST_BANDS))
        self._window, longest = round(WINDOW_S / dt), round(LONGEST_S / dt)
        self._every = max(axes, round(EVERY_S / dt))
        lags = np.arange(0, longest + 1, max(1, round(STEP_S / dt)))
        usual, late = lags[lags * dt <= 0.5 * accepted + 1e-9], lags[lags * dt >= accepted - 1e-9]
        samples = np.arange(self._window - 1, -1, -max(1, round(SAMPLE_S / dt)))[::-1]
        # Delay of each sample, one row per hypothesis: delays in time, then late ones that began before or within the window.
        rows = [np.full(len(samples), lag) for lag in (*usual, *late)]
        for since in SINCE_S:
            rows += [np.where(samples < self._window - round(since / dt), 0, lag) for lag in late]
        self._delays, self.usual, self._samples = np.array(rows), len(usual), samples
        self._columns = longest + samples - self._delays
        self._hits = np.zeros(axes, dtype=int)
        self._valves = ValveArray(valves)
        self.fastest = self._valves.fastest
        #: Smallest unexplained error of an axis as time at top speed, (A,) [s]: a reversal of play leaves up to half of it.
        self._least_s = LEAST_S + 0.5 * np.array([valve.backlash for valve in valves]) / self.fastest
        #: Travel forwards and backwards by the commands, (2, bands, A, cycles), the newest last.
        self._travel = np.zeros((2, len(self.bands), axes, self._window + longest))
        #: Speeds within the dead time, (2, bands, A, cycles), the newest first.
        late_by = [valve.dead_steps for valve in valves]
        self._coming = np.zeros((2, len(self.bands), axes, max(late_by)))
        self._arrives = np.arange(axes), np.array(late_by) - 1
        self._measured = np.full((axes, self._window), np.nan)
        self._cycle = 0
        self._late: list[LateAxis | None] = [None] * axes

    @property
    def hypotheses(self) -> int:
        """Pairs of dead-bands and delays in time that :meth:`moments` compares."""
        return len(self.bands) ** 2 * self.usual

    @property
    def late(self) -> tuple[LateAxis, ...]:
        """Late axes by the newest comparison."""
        return tuple(item for item in self._late if item is not None)

    def reset(self) -> None:
        """Discard the measurements."""
        self._measured[:], self._hits[:] = np.nan, 0
        self._late = [None] * len(self._late)

    def step(self, commands: Array) -> None:
        """Record a step with ``commands`` (A,), zero if neutral."""
        self._travel[..., :-1] = self._travel[..., 1:]
        self._travel[..., -1] += self._coming[:, :, *self._arrives] * self.dt
        self._coming[..., 1:] = self._coming[..., :-1].copy()
        forwards, backwards = self._valves.speeds(commands, self.bands[:, None])
        self._coming[0, ..., 0], self._coming[1, ..., 0] = forwards, -backwards

    def measure(self, measured: Array) -> None:
        """Record ``measured`` (A,), what the commands drive; NaN without a fresh and valid reading."""
        self._measured[:, :-1] = self._measured[:, 1:]
        self._measured[:, -1] = measured
        self._cycle += 1
        axis = self._cycle % self._every
        if axis < len(self._late):
            self._late[axis] = self._compare(axis)

    def moments(self, i: int, cycles: int) -> tuple[Array, Array, float, int]:
        """Of the motion of axis ``i`` in the last ``cycles``, about its mean.

        Returns:
            Sums of squares by the commands, for each dead-band and delay in time, and of products with the measured motion,
            (n,) each; of squares of the latter, and their number.
        """
        own = np.flatnonzero(np.isfinite(self._measured[i, -cycles:])) + self._window - cycles
        if len(own) < 2:
            return *np.zeros((2, self.hypotheses)), 0.0, 0
        columns = self._travel.shape[-1] - self._window + own - self._delays[: self.usual, :1]
        x = _sums(self._travel[:, :, i])[:, columns]
        x -= x.mean(axis=2, keepdims=True)
        y = self._measured[i, own] - self._measured[i, own].mean()
        return np.einsum("bln,bln->bl", x, x).ravel(), (x @ y).ravel(), float(y @ y), len(own)

    def _compare(self, i: int) -> LateAxis | None:
        measured, travel = self._measured[i, self._samples], self._travel[:, :, i]
        own = np.isfinite(measured)
        if own.mean() < ENOUGH or np.ptp(travel[:, 0], axis=1).max() < self._least_s[i] * self.fastest[i]:
            self._hits[i] = 0
            return None
        both = _sums(travel)
        turns = self._columns[:, own]
        usual = float(_errors(measured[own], both[:, turns[: self.usual]]).min()) / self.fastest[i]
        if usual <= self._least_s[i]:
            self._hits[i] = 0
            return None
        both = _sums(travel[:, ::COARSE])
        late = _errors(measured[own], both[:, turns[self.usual :]]).min(axis=0) / self.fastest[i]
        self._hits[i] = self._hits[i] + 1 if max(float(late.min()), FLOOR_S) < SHARE * usual else 0
        if self._hits[i] < REPEATS:
            return None
        return LateAxis(i, float(self._delays[self.usual + int(np.argmin(late)), -1]) * self.dt)


class GainComparison:
    """Whether the motion of axes is that of their plant: gains within :data:`GAINS` or beyond :data:`OTHER_GAINS`, whatever the
    dead-band. Motion is compared in intervals, each about its mean, so that play that was taken up before does not matter.

    Args:
        response: measurements and commands.
    """

    def __init__(self, response: ResponseMonitor) -> None:
        self.response, self.cycles = response, round(INTERVAL_S / response.dt)
        self._axes, self._hypotheses = len(response.fastest), response.hypotheses
        self.begin()

    def begin(self) -> None:
        """Discard all intervals."""
        self._xx, self._xy = np.zeros((2, self._axes, self._hypotheses))
        self._yy, self._number = np.zeros((2, self._axes))

    def odds(self, i: int, cycles: int) -> tuple[float, float]:
        """Logarithm of the likelihood ratio for the plant of axis ``i``, and the more likely gain over the plant's.

        Args:
            cycles: of the present stroke so far; every :attr:`cycles` an interval ends.
        """
        part = 1 + (cycles - 1) % self.cycles
        xx, xy, yy, number = self.response.moments(i, part)
        xx, xy, yy, number = self._xx[i] + xx, self._xy[i] + xy, float(self._yy[i]) + yy, int(self._number[i]) + number
        if part == self.cycles:
            self._xx[i], self._xy[i], self._yy[i], self._number[i] = xx, xy, yy, number
        if number < FEWEST:
            return 0.0, math.nan
        free = xy / np.maximum(xx, 1e-18)
        gains = np.stack([np.clip(free, *GAINS), np.minimum(free, OTHER_GAINS[0]), np.maximum(free, OTHER_GAINS[1])])
        errors = np.maximum(yy - 2.0 * gains * xy + gains**2 * xx, 0.0) / number
        best = errors.argmin(axis=1)
        least = errors[np.arange(3), best] + (RESIDUAL_S * self.response.fastest[i]) ** 2
        other = 1 + int(np.argmin(least[1:]))
        odds = 0.5 * number * math.log(float(least[other] / least[0]))
        likely = 0 if odds >= 0.0 else other
        return odds, float(gains[likely, best[likely]])


def _sums(travel: Array) -> Array:
    """Travel (bands², cycles) for each pair of dead-bands, from that forwards and backwards (2, bands, cycles)."""
    return np.asarray(travel[0][:, None] + travel[1][None]).reshape(travel.shape[1] ** 2, -1)


def _errors(measured: Array, travel: Array) -> Array:
    """RMS residual of each hypothesis ``travel`` (bands, delays, n) for ``measured`` (n,), in its unit."""
    y = measured - measured.mean()
    x = travel - travel.mean(axis=2, keepdims=True)
    xx, xy = np.einsum("bln,bln->bl", x, x), x @ y
    gain = np.clip(xy / np.maximum(xx, 1e-18), *GAINS)
    return np.asarray(np.sqrt(np.maximum((y @ y - 2.0 * gain * xy + gain**2 * xx) / len(y), 0.0)))
