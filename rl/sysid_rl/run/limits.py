"""``[limits]`` of a recipe, and the limiter of position, speed, acceleration and jerk of joint setpoints.

Each step is limited relative to the *previous setpoint*: a limit relative to the measured position slows down an actuator that
lags (ros2_control issue 2183). Motion back inside a limit is always permitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid.errors import SettingsError, nearest
from sysid.plant import Plant
from sysid_rl.run.valves import AxisValve
from sysid_rl.train.reach import joint_limits

Array = npt.NDArray[np.float64]

#: Defaults: times to reach full speed, and full acceleration [s].
SPEED_UP_S, JERK_S = 0.2, 0.05
#: Share of the acceleration for planned braking before a target; the rest is for the jerk limit.
BRAKING = 0.5
#: Rate at which a limited setpoint approaches its target [1/s]: slow enough for the jerk limit to avoid oscillation.
CATCH_UP = 8.0
#: Coefficient of the low-pass filter of the target's speed.
SMOOTH = 0.1


@dataclass(frozen=True)
class AxisLimits(Strict):
    """Limits of one joint [rad or m, s]; None: those of the machine's description and the plant.

    Args:
        low, high: of its position.
        speed, acceleration, jerk: greatest magnitudes.
        command: greatest magnitude of the valve command.
        command_rate: greatest change of it [1/s].
    """

    low: float | None = None
    high: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    command: float = 1.0
    command_rate: float | None = None


@dataclass(frozen=True)
class LimitSettings(Strict):
    """``[limits]``.

    Args:
        margin: distance from the ends of a joint, as a share of its range.
        fence: of the end effector, ``{x = [low, high], …}`` [m]; missing coordinates are not bounded.
        fence_margin: distance from the fence [m].
        axes: per axis.
    """

    margin: float = 0.03
    fence: dict[str, tuple[float, float]] = field(default_factory=dict)
    fence_margin: float = 0.03
    axes: dict[str, AxisLimits] = field(default_factory=dict)


@dataclass(frozen=True)
class Limits:
    """Limits of all joints, arrays (A,) in SI; ``hard_low``/``hard_high`` without the margin.

    Args:
        braking: planned deceleration of stops, of what the command drives, (A,).
        fence_low, fence_high: within the margin, (3,) [m], infinite without a fence; ``hard_fence``: without the margin.
    """

    low: Array
    high: Array
    hard_low: Array
    hard_high: Array
    speed: Array
    acceleration: Array
    jerk: Array
    command: Array
    command_rate: Array
    braking: Array
    fence_low: Array
    fence_high: Array
    hard_fence: tuple[Array, Array]

    @property
    def fenced(self) -> bool:
        return bool(np.isfinite(self.fence_low).any() or np.isfinite(self.fence_high).any())


def limits_of(plant: Plant, valves: tuple[AxisValve, ...], settings: LimitSettings, where: object) -> Limits:
    """The limits of a machine, narrowed by a recipe.

    Raises:
        SettingsError: an unknown axis or coordinate, limits beyond the machine's own, or an empty range.
    """
    names = plant.machine.axis_names
    for axis in settings.axes:
        if axis not in names:
            raise SettingsError(f"{where}: limits.axes", f"unknown axis {axis!r}", nearest(axis, names))
    for letter, ends in settings.fence.items():
        if letter not in ("x", "y", "z"):
            raise SettingsError(f"{where}: limits.fence", f"unknown coordinate {letter!r}", "x, y or z")
        if not ends[1] - ends[0] > 2.0 * settings.fence_margin:
            raise SettingsError(f"{where}: limits.fence.{letter}", f"{list(ends)}", "a range above two margins")
    if not (0.0 <= settings.margin < 0.5 and settings.fence_margin >= 0.0):
        raise SettingsError(f"{where}: limits", "a margin that leaves no range", "margin in 0 … 0.5, fence_margin ≥ 0")
    own_low, own_high = joint_limits(plant)
    low, high = own_low.copy(), own_high.copy()
    rows = []
    for i, (name, valve) in enumerate(zip(names, valves, strict=True)):
        item, place = settings.axes.get(name, AxisLimits()), f"{where}: limits.axes.{name}"
        low[i], high[i] = own_low[i] if item.low is None else item.low, own_high[i] if item.high is None else item.high
        if low[i] < own_low[i] - 1e-9 or high[i] > own_high[i] + 1e-9 or not low[i] < high[i]:
            own = f"within {own_low[i]:.4g} … {own_high[i]:.4g}, the machine's own"
            raise SettingsError(place, f"low = {low[i]:.4g}, high = {high[i]:.4g}", own)
        fastest = valve.fastest * _least_slope(plant, i, own_low[i], own_high[i])
        speed = fastest if item.speed is None else item.speed
        acceleration = speed / SPEED_UP_S if item.acceleration is None else item.acceleration
        jerk = acceleration / JERK_S if item.jerk is None else item.jerk
        rate = valve.rate if item.command_rate is None else item.command_rate
        rows.append((speed, acceleration, jerk, item.command, rate))
        for key, value in zip(("speed", "acceleration", "jerk", "command", "command_rate"), rows[-1], strict=True):
            if not 0.0 < value < math.inf:
                raise SettingsError(f"{place}.{key}", f"{value}", "a positive number")
        if item.command > 1.0:
            raise SettingsError(f"{place}.command", f"{item.command}", "at most 1")
    margin = settings.margin * (high - low)
    bounds = np.array([settings.fence.get(letter, (-math.inf, math.inf)) for letter in "xyz"])
    columns = np.array(rows).T
    return Limits(
        low + margin, high - margin, low, high, columns[0], columns[1], columns[2], columns[3], columns[4],
        np.array([valve.fastest / SPEED_UP_S for valve in valves]),
        bounds[:, 0] + settings.fence_margin, bounds[:, 1] - settings.fence_margin, (bounds[:, 0], bounds[:, 1]),
    )  # fmt: skip


def _least_slope(plant: Plant, i: int, low: float, high: float) -> float:
    """Least ratio of joint speed to the speed of what is driven, over the middle 80 % of the range."""
    axis = plant.machine.axes[i]
    if axis.drives != "cylinder":
        return 1.0
    room = 0.1 * (high - low)
    q = np.linspace(low + room, high - room, 64)
    return float(np.abs(np.diff(q) / np.diff(plant.linkages[axis.name].displacement(q))).min())


class SetpointLimiter:
    """Limits joint setpoints step by step.

    A setpoint within all limits passes unchanged. Otherwise the joint moves towards it as fast as the limits allow, brakes
    before it, and catches up with a moving target.
    """

    def __init__(self, limits: Limits, dt: float) -> None:
        self.limits, self.dt = limits, dt
        self.position = np.full(len(limits.low), np.nan)
        self.speed = np.zeros(len(limits.low))
        self._acceleration = np.zeros(len(limits.low))
        #: Requested setpoints within the limits of position, (A,).
        self.wanted = np.full(len(limits.low), np.nan)
        #: The target's speed: low-pass filtered where it is not smooth, and as it is.
        self._own, self._moved = np.zeros(len(limits.low)), np.zeros(len(limits.low))

    def reset(self, joints: Array) -> None:
        """Reset to rest at ``joints`` (A,)."""
        self.position, self.wanted = np.array(joints, dtype=np.float64), np.array(joints, dtype=np.float64)
        self.speed, self._acceleration = np.zeros(len(joints)), np.zeros(len(joints))
        self._own, self._moved = np.zeros(len(joints)), np.zeros(len(joints))

    def step(self, wanted: Array, shares: Array | None = None) -> tuple[Array, list[tuple[str, int, float, float]]]:
        """Limited setpoints (A,) for requested ones (A,), and exceeded limits: (check, axis, found, limit).

        Args:
            shares: of the speed limits, (A,); None: all of them.
        """
        exceeded: list[tuple[str, int, float, float]] = []
        for i in range(len(wanted)):
            self._step(i, float(wanted[i]), 1.0 if shares is None else float(shares[i]), exceeded)
        return self.position.copy(), exceeded

    def _step(self, i: int, requested: float, share: float, exceeded: list[tuple[str, int, float, float]]) -> None:
        dt, at, speed, acceleration = self.dt, float(self.position[i]), float(self.speed[i]), float(self._acceleration[i])
        of = self.limits
        top, most, jerk = share * float(of.speed[i]), float(of.acceleration[i]), float(of.jerk[i])
        low, high = min(float(of.low[i]), at), max(float(of.high[i]), at)  # motion back inside is permitted
        wanted = min(max(requested, low), high) if math.isfinite(requested) else at  # not finite: no motion
        moved = (wanted - float(self.wanted[i])) / dt  # the target's speed; zero for a jump
        self.wanted[i] = wanted
        moved = moved if abs(moved) <= float(of.speed[i]) else 0.0
        # Noise of a target must not reach the setpoint; a smooth one is followed without lag.
        smooth = abs(moved - float(self._moved[i])) <= most * dt
        turning = (moved - float(self._moved[i])) / dt if smooth else 0.0
        self._own[i] = moved if smooth else self._own[i] + SMOOTH * (moved - float(self._own[i]))
        self._moved[i] = moved
        if wanted != requested:
            exceeded.append(("position", i, requested, low if requested < low else high))
        v = (wanted - at) / dt
        a = (v - speed) / dt
        j = (a - acceleration) / dt
        over = (("speed", abs(v), top), ("acceleration", abs(a), most), ("jerk", abs(j), jerk))
        found = [(name, i, value, limit) for name, value, limit in over if value > limit * (1.0 + 1e-9) + 1e-9]
        if found:
            exceeded += found
            error = wanted - at - float(self._own[i]) * dt
            toward = math.copysign(min(math.sqrt(2.0 * BRAKING * most * abs(error)), CATCH_UP * abs(error)), error)
            v = min(max(float(self._own[i]) + toward, -top), top)
            left = v - speed - turning * dt
            ease = math.sqrt(2.0 * jerk * abs(left))  # at the target's speed, the acceleration must be that of the target
            a = min(max(turning + min(max(left / dt, -ease), ease), -most), most)
            a = min(max(a, acceleration - jerk * dt), acceleration + jerk * dt)
            v = min(max(speed + a * dt, -top), top)
        after = at + v * dt
        if not low <= after <= high:
            after = min(max(after, low), high)
            v, a = (after - at) / dt, 0.0
        self.position[i], self.speed[i], self._acceleration[i] = after, v, a
