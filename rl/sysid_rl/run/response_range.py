"""Motion that the commands do not explain: measured motion outside the range of responses of machines like the plant.

For the commands sent, a range of speeds follows from the plant's valve with every gain within :data:`GAINS` of the plant's,
every dead-band within :data:`BAND` of it, or wider as the :class:`Tolerance` permits, and every delay from none to the dead
time plus that of the tolerance. Play may absorb motion after each reversal. What the measured motion exceeds the range by is
added up, and what it stays inside by is subtracted, down to zero (Page's CUSUM). An axis leaves the range at its own speed
where it stands, moves by no command, to the wrong side, or by the wrong amount; noise and a wrong dead-band do not leave it.

Source: Page, Biometrika 41 (1954).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.plant import Plant
from sysid_rl.run.checks.settings import BOUNDS, CheckSettings
from sysid_rl.run.valves import AxisValve, ValveArray

Array = npt.NDArray[np.float64]

#: Range of the true gain over the plant's.
GAINS = (0.6, 1.5)
#: Difference of a true dead-band from the plant's that any machine may have [command].
BAND = 0.08
#: Standard deviations of what the plant knows of a dead-band or a delay.
KNOWN = 3.0
#: Play beyond the plant's, as time at top speed [s].
PLAY_S = 0.025
#: Creep of a valve that counts as none, as a share of the top speed.
CREEP = 0.01
#: Time constant of the low-pass filter of the measurements [s].
FILTER_S = 0.04
#: Standard deviations of the filtered measurement that noise may add up to.
SIGMAS = 12.0
#: Coefficient of the low-pass filter of the variance.
NOISE_SHARE = 0.02


@dataclass(frozen=True)
class Tolerance:
    """What a machine may differ by from its plant.

    Args:
        delay_s: of the response, beyond the plant's dead time [s].
        wider: dead-bands beyond the plant's, beside :data:`BAND` [command].
    """

    delay_s: float = 0.08
    wider: float = 0.0

    @classmethod
    def of(cls, plant: Plant, settings: CheckSettings) -> Tolerance:
        """That of a recipe, and of the uncertainty that the plant states of its own values."""

        def known(effect: str) -> float:
            variances = np.diag(plant.uncertainty.covariance)
            own = [float(v) for place, v in zip(plant.uncertainty.places, variances, strict=True) if place.effect == effect]
            return KNOWN * math.sqrt(max(own, default=0.0))

        return cls(
            min(settings.delay.after_s + known("input_delay"), BOUNDS["delay.after_s"].most),
            min(settings.motion.wider + known("valve_deadband"), BOUNDS["motion.wider"].most),
        )


class ResponseRange:
    """The range of all axes of one machine.

    Args:
        valves: of the axes, from the plant.
        dt: of a cycle [s].
        tolerance: of the machine.
    """

    def __init__(self, valves: Sequence[AxisValve], dt: float, tolerance: Tolerance) -> None:
        self.dt, self.wider, axes = dt, tolerance.wider, len(valves)
        self._valves = ValveArray(valves)
        self._fastest = self._valves.fastest
        self._play = np.array([valve.backlash for valve in valves]) + PLAY_S * self._fastest
        late = [valve.dead_steps + round((tolerance.delay_s + FILTER_S) / dt) for valve in valves]
        #: Speeds by the plant, the least and the greatest of the range, and by the plant with the widest dead-bands that the
        #: tolerance permits, (4, A, cycles), the newest first.
        self._speeds = np.zeros((4, axes, max(late) + 1))
        self._within = np.arange(max(late) + 1) <= np.array(late)[:, None]
        self._arrives = np.arange(axes), np.array([valve.dead_steps for valve in valves])
        self._keep = math.exp(-dt / FILTER_S)
        #: Travel by the plant since the beginning, and with the widest dead-bands, (A,).
        self.predicted, self.certain = np.zeros((2, axes))
        self.reset()

    def reset(self) -> None:
        """Forget the measurements."""
        axes = len(self._fastest)
        #: Low-pass filtered measurement (A,), NaN before the first, and its speed.
        self.measured, self.speed = np.full(axes, np.nan), np.zeros(axes)
        #: Excess over the range, forwards and backwards, (2, A).
        self.excess = np.zeros((2, axes))
        #: Variance of a measurement about the filtered one while the axis must stand, and the number of those, (A,).
        self._variance, self._number = np.zeros(axes), np.zeros(axes)
        #: Play that motion forwards, and backwards, has to take up first, (2, A).
        self._gap = np.tile(self._play, (2, 1))
        self._possible = np.zeros((2, axes))

    def begin(self) -> None:
        """The valves are about to be enabled."""
        self.excess[:] = 0.0
        self._gap[:] = self._play

    @property
    def noise(self) -> Array:
        """Standard deviation of :attr:`measured` by the noise of the sensors, (A,)."""
        return np.asarray(np.sqrt(self._variance * (1.0 - self._keep) / (1.0 + self._keep)))

    def allowance(self, seconds: float) -> Array:
        """Excess that passes, (A,): ``seconds`` at top speed, or noise of the sensors beyond that."""
        return np.maximum(seconds * self._fastest, SIGMAS * self.noise)

    @property
    def still(self) -> npt.NDArray[np.bool_]:
        """Whether no command within the range's delays moves the axis, (A,)."""
        return np.asarray(~(self._speeds[1:3] * self._within).any(axis=(0, 2)))

    @property
    def direction(self) -> Array:
        """Sign of the motion by the plant within the delays, (A,); 0 without any."""
        return np.asarray(np.sign((self._speeds[0] * self._within).sum(axis=1)))

    def described(self, i: int, name: str) -> str:
        """What axis ``i`` does outside the range."""
        direction, speed = float(self.direction[i]), float(self.speed[i])
        if self.still[i]:
            return f"{name} moves though no command moves it: valves or sensors are swapped, or it is pushed"
        if speed * direction < -CREEP * self._fastest[i]:
            return f"{name} moves against its command: its valve or its sensor is reversed or not its own, or the line is late"
        onwards = self.excess[0, i] > self.excess[1, i]
        return f"{name} moves {'farther' if onwards == (direction > 0.0) else 'less'} than its commands explain"

    def step(self, commands: Array) -> None:
        """Record a step with ``commands`` (A,), zero if neutral."""
        self._speeds[..., 1:] = self._speeds[..., :-1].copy()
        own = self._speed(commands, 1.0, 0.0)
        ends = np.stack([self._speed(commands, GAINS[0], BAND + self.wider), self._speed(commands, GAINS[1], -BAND)])
        self._speeds[..., 0] = own, ends.min(axis=0), ends.max(axis=0), self._speed(commands, 1.0, self.wider)
        self.predicted += self._speeds[0][self._arrives] * self.dt
        self.certain += self._speeds[3][self._arrives] * self.dt
        least = np.where(self._within, self._speeds[1], np.inf).min(axis=1) * self.dt
        most = np.where(self._within, self._speeds[2], -np.inf).max(axis=1) * self.dt
        ways = np.stack([most, -least])
        must = np.maximum(np.stack([least, -most]), 0.0)
        taken = np.minimum(self._gap, must)
        self._gap = np.minimum(self._gap - taken + np.maximum(ways[::-1], 0.0), self._play)
        # The greatest travel forwards and backwards; below zero: the least one to the other side.
        self._possible += ways + taken[::-1]

    def measure(self, measured: Array) -> None:
        """Record ``measured`` (A,), what the commands drive; NaN without a fresh and valid reading."""
        fresh = np.isfinite(measured)
        before = np.where(np.isnan(self.measured), measured, self.measured)
        after = np.where(fresh, self._keep * before + (1.0 - self._keep) * measured, self.measured)
        moved = np.where(fresh, after - before, 0.0)
        self._number += (stood := fresh & self.still)
        spread = np.where(stood, (measured - after) ** 2, self._variance)
        self._variance += np.maximum(NOISE_SHARE, 1.0 / np.maximum(self._number, 1.0)) * (spread - self._variance)
        self.measured = after
        self.speed = np.where(fresh, self._keep * self.speed + (1.0 - self._keep) * moved / self.dt, self.speed)
        creep = CREEP * self._fastest * self.dt
        excess = np.maximum(self.excess + np.stack([moved, -moved]) - self._possible - creep, 0.0)
        self.excess = np.where(fresh, excess, self.excess)
        self._possible = np.where(fresh, 0.0, self._possible)

    def _speed(self, commands: Array, gain: float, wider: float) -> Array:
        forwards, backwards = self._valves.speeds(commands, wider)
        return np.asarray(gain * (forwards - backwards))
