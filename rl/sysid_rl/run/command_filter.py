"""The command filter, last before the valves: range, rate, and a discrete-time control barrier.

A command passes only if the axis can still stop inside its limits, from the measured position *and* from dead reckoning, and
the end effector inside its fence. Commands that lead back inside always pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.machine import TabulatedLinkage
from sysid_rl.run.limits import Limits
from sysid_rl.run.valves import AxisValve, DeadReckoning, braking_speed, stopping_distance

Array = npt.NDArray[np.float64]
ExceededLimit = tuple[str, int, float, float]

#: Undetected motion of this duration can still be braked in time [s].
REACTION_S = 0.08
#: A valve may be faster than that of the plant by this factor.
SPEED_MARGIN = 1.25
#: Shares of the requested commands that are tried for the fence.
SHARES = (1.0, 0.7, 0.4, 0.2, 0.0)


class CommandFilter:
    """The filter of one machine.

    Args:
        limits: of the joints; converted to what the commands drive.
        valves, linkages: of each axis; None if the command drives the joint.
        tip: joints (n, A) → end effector (n, 3) [m].
        dt: of a step [s].
    """

    def __init__(
        self,
        limits: Limits,
        valves: Sequence[AxisValve],
        linkages: Sequence[TabulatedLinkage | None],
        tip: Callable[[Array], Array],
        dt: float,
    ) -> None:
        self.limits, self.valves, self.linkages, self.tip, self.dt = limits, tuple(valves), tuple(linkages), tip, dt
        self.low, self.high = np.empty(len(self.valves)), np.empty(len(self.valves))
        for i, linkage in enumerate(self.linkages):
            ends = np.array([limits.low[i], limits.high[i]])
            self.low[i], self.high[i] = ends if linkage is None else np.sort(linkage.displacement(ends))
        self.sent = np.zeros(len(self.valves))

    def reset(self) -> None:
        """Start with neutral valves."""
        self.sent = np.zeros(len(self.valves))

    def filter(
        self, requested: Array, drive: Array, dead_reckonings: Sequence[DeadReckoning]
    ) -> tuple[Array, list[ExceededLimit]]:
        """Permitted commands (A,) for requested ones (A,), and exceeded limits: (check, axis or −1, found, limit).

        Args:
            drive: measured position of what the commands drive, (A,).
        """
        exceeded: list[ExceededLimit] = []
        commands = np.array(
            [
                self._limit_axis(i, float(requested[i]), float(drive[i]), dead_reckonings[i], exceeded)
                for i in range(len(requested))
            ]
        )
        if self.limits.fenced:
            commands = self._limit_by_fence(commands, drive, dead_reckonings, exceeded)
        self.sent = commands
        return commands.copy(), exceeded

    def ramp(self, drive: Array, dead_reckonings: Sequence[DeadReckoning]) -> Array:
        """The commands (A,) of a stop: from the last ones towards neutral within the braking limit of each axis."""
        commands = np.zeros(len(self.valves))
        for i, valve in enumerate(self.valves):
            speed = valve.speed(float(self.sent[i]))
            left = max(0.0, abs(speed) - float(self.limits.braking[i]) * self.dt)
            commands[i] = valve.command(math.copysign(left, speed))
        passed, _ = self.filter(commands, drive, dead_reckonings)
        return passed

    def stop_ends(self, joints: Array, speeds: Array) -> Array:
        """End positions of stops that begin at ``joints`` (n, A) and ``speeds`` (n, A), with the margins of commands.

        Returns:
            Joints (n, A).
        """
        driven = np.empty_like(joints)
        for i, (valve, linkage) in enumerate(zip(self.valves, self.linkages, strict=True)):
            q, v = joints[:, i], speeds[:, i]
            if linkage is not None:
                q, v = linkage.displacement(q), (linkage.displacement(q + v * self.dt) - linkage.displacement(q)) / self.dt
            after = valve.dead_steps * self.dt + self.dt + REACTION_S
            driven[:, i] = np.clip(
                q + stopping_distance(SPEED_MARGIN * v, after, float(self.limits.braking[i])), valve.low, valve.high
            )
        return self.joints(driven)

    def tip_ratios(self, drive: Array) -> Array:
        """Motion of the end effector per unit of what is driven at ``drive`` (A,), (A,) [m per m or rad]."""
        low, high = np.array([valve.low for valve in self.valves]), np.array([valve.high for valve in self.valves])
        return motion_ratios(lambda driven: self.tip(self.joints(driven)), drive, low, high)

    def joints(self, driven: Array) -> Array:
        """Joints (n, A) at positions (n, A) of what the commands drive."""
        joints = driven.copy()
        for i, linkage in enumerate(self.linkages):
            if linkage is not None:
                joints[:, i] = linkage.joint(joints[:, i])
        return joints

    def _limit_axis(
        self, i: int, requested: float, drive: float, dead_reckoning: DeadReckoning, exceeded: list[ExceededLimit]
    ) -> float:
        valve, most = self.valves[i], float(self.limits.command[i])
        if not math.isfinite(requested):
            exceeded.append(("command", i, requested, most))
            requested = 0.0
        command = min(max(requested, -most), most)
        step = float(self.limits.command_rate[i]) * self.dt
        last = float(self.sent[i])
        command = min(max(command, last - step), last + step)
        if abs(command - requested) > 1e-9:
            exceeded.append(("command", i, requested, command))
        speed = SPEED_MARGIN * valve.speed(command)
        if speed == 0.0:
            return command
        sign = math.copysign(1.0, speed)
        positions = [position for position in (drive, dead_reckoning.position) if math.isfinite(position)]
        if not positions:
            return 0.0
        end = float(self.high[i] if sign > 0.0 else self.low[i])
        room = min(sign * (end - position) for position in positions) - SPEED_MARGIN * dead_reckoning.pending_travel(sign)
        allowed = braking_speed(room, self.dt + REACTION_S, float(self.limits.braking[i]))
        if abs(speed) > allowed:
            exceeded.append(("position", i, positions[0], end))
            return valve.command(sign * allowed / SPEED_MARGIN)
        return command

    def _limit_by_fence(
        self, commands: Array, drive: Array, dead_reckonings: Sequence[DeadReckoning], exceeded: list[ExceededLimit]
    ) -> Array:
        """The greatest share of ``commands`` with which a stop ends within the fence, or farther inside than with none."""
        speeds = np.array([valve.speed(float(command)) for valve, command in zip(self.valves, commands, strict=True)])
        if not speeds.any():
            return commands
        ends = np.empty((len(SHARES), 2, len(speeds)))
        for i, (valve, dead_reckoning) in enumerate(zip(self.valves, dead_reckonings, strict=True)):
            pending = dead_reckoning.pending_travel(1.0) - dead_reckoning.pending_travel(-1.0)
            for k, share in enumerate(SHARES):
                travel = stopping_distance(
                    SPEED_MARGIN * share * speeds[i], self.dt + REACTION_S, float(self.limits.braking[i])
                )
                for n, position in enumerate((drive[i], dead_reckoning.position)):
                    ends[k, n, i] = min(max(position + SPEED_MARGIN * pending + travel, valve.low), valve.high)
        joints = self.joints(ends.reshape(-1, len(speeds)))
        left = outside(self.tip(joints), self.limits.fence_low, self.limits.fence_high).reshape(len(SHARES), 2).max(axis=1)
        fits = left <= max(0.0, float(left[-1]) - 1e-9)
        if fits[0]:
            return commands
        share = SHARES[int(np.argmax(fits))] if fits.any() else 0.0
        exceeded.append(("fence", -1, float(left[0]), 0.0))
        kept = [valve.command(share * float(speed)) for valve, speed in zip(self.valves, speeds, strict=True)]
        return np.array(kept)


def inwards(values: Array, low: Array, high: Array) -> Array:
    """Signs (A,) of the ways from values (A,) to the middle of their range."""
    return np.where(values > 0.5 * (low + high), -1.0, 1.0)


def motion_ratios(tip: Callable[[Array], Array], values: Array, low: Array, high: Array) -> Array:
    """Motion of ``tip`` (n, 3) of (n, A) per unit of each of the values (A,) within their range, (A,), above zero."""
    steps = 0.01 * (high - low) * inwards(values, low, high)
    ends = tip(np.concatenate([values[None], values + np.diag(steps)]))
    return np.asarray(np.maximum(np.linalg.norm(ends[1:] - ends[0], axis=1) / np.abs(steps), 1e-6))


def outside(points: Array, low: Array, high: Array) -> Array:
    """Distance of points (n, 3) from a box per coordinate, the largest, (n,) [m]; zero inside."""
    return np.asarray(np.maximum(np.maximum(low - points, points - high), 0.0).max(axis=1))
