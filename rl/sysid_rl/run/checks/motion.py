"""Consistency checks: between sensors, motion and commands, joints and setpoints, network inputs and training data."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.machine import TabulatedLinkage
from sysid_rl.run.checks.settings import CheckSettings
from sysid_rl.run.cycle import Violation
from sysid_rl.run.response_range import ResponseRange
from sysid_rl.run.state_estimator import StateEstimate
from sysid_rl.run.valves import AxisValve

Array = npt.NDArray[np.float64]


class MotionChecks:
    """Checks with memory, most of which report only a condition that persists.

    Args:
        axes, valves, linkages, dt: of the machine.
        response_range: of the state estimator.
        settings: of the recipe.
        inside: a text about the network that extrapolates; "" if none does.
    """

    def __init__(
        self,
        axes: Sequence[str],
        valves: Sequence[AxisValve],
        linkages: Sequence[TabulatedLinkage | None],
        dt: float,
        response_range: ResponseRange,
        settings: CheckSettings,
        inside: Callable[[StateEstimate], str],
    ) -> None:
        self.axes, self.valves, self.linkages, self.dt = tuple(axes), tuple(valves), tuple(linkages), dt
        self.range, self.settings, self._inside = response_range, settings, inside
        self._durations: dict[tuple[str, str], float] = {}
        self._drive = np.full(len(self.axes), np.nan)
        self._moved = np.zeros(len(self.axes))
        self._neutral_s = 0.0

    def reset(self) -> None:
        """Reset the persistence of all conditions; the valves are about to be enabled."""
        self._durations.clear()

    def check(self, estimate: StateEstimate, moving: bool, drive_setpoints: Array | None) -> list[Violation]:
        """Violations of this cycle; ``drive_setpoints`` (A,) are those of the cycle before, None without any."""
        found = []
        settings = self.settings
        if settings.on("contradiction"):
            found += self._contradictions(estimate)
        if settings.on("motion") and moving:
            found += self._motion()
        if settings.on("following") and moving and drive_setpoints is not None:
            found += self._following(estimate, drive_setpoints)
        if settings.on("domain") and moving:
            text = self._inside(estimate)
            if self._persists("domain", "networks", bool(text), settings.domain.for_s):
                found.append(Violation("domain", "networks", settings.domain.reaction, math.nan, math.nan, text))
        found += self._restless(estimate, moving)
        if settings.on("delay") and moving:
            found += self._late(estimate)
        return found

    def _contradictions(self, estimate: StateEstimate) -> list[Violation]:
        found, rule = [], self.settings.contradiction
        for sensor in estimate.sensors:
            if sensor.driven:
                continue
            through = float(estimate.joints[sensor.axis])
            deviation, limit = abs(sensor.value - through), rule.share * sensor.range
            both = sensor.valid and bool(estimate.measured[sensor.axis])
            if self._persists("contradiction", sensor.signal, both and deviation > limit, rule.for_s):
                text = f"{sensor.signal} reads {sensor.value:.4g}, its cylinder gives {through:.4g}"
                found.append(Violation("contradiction", sensor.signal, rule.reaction, deviation, limit, text))
        return found

    def _motion(self) -> list[Violation]:
        found, rule = [], self.settings.motion
        excess, limits = self.range.excess.max(axis=0), self.range.allowance(rule.seconds)
        for i in np.flatnonzero(excess > limits):
            name, text = self.axes[i], self.range.described(int(i), self.axes[i])
            found.append(Violation("motion", name, rule.reaction, float(excess[i]), float(limits[i]), text))
        return found

    def _following(self, estimate: StateEstimate, drive_setpoints: Array) -> list[Violation]:
        found, rule = [], self.settings.following
        for i, (name, valve) in enumerate(zip(self.axes, self.valves, strict=True)):
            deviation, limit = abs(float(drive_setpoints[i] - estimate.drive[i])), rule.seconds * valve.fastest
            if self._persists("following", name, deviation > limit, rule.for_s):
                text = f"{name} is {deviation:.4g} behind its setpoint"
                found.append(Violation("following", name, rule.reaction, deviation, limit, text))
        return found

    def _late(self, estimate: StateEstimate) -> list[Violation]:
        """Axes that answer commands later than the plant, whatever the stamps say."""
        found, rule = [], self.settings.delay
        for late in estimate.late:
            name = self.axes[late.axis]
            text = f"{name} answers commands {1e3 * late.seconds:.0f} ms later than its plant: the line is late"
            found.append(Violation("delay", name, rule.reaction, late.seconds, rule.after_s, text))
        return found

    def _restless(self, estimate: StateEstimate, moving: bool) -> list[Violation]:
        """Motion with neutral valves; speeds are low-pass filtered over 0.1 s against noise."""
        rule = self.settings.restless
        self._neutral_s = 0.0 if moving else self._neutral_s + self.dt
        fresh = np.where(np.isnan(self._drive), 0.0, estimate.drive - self._drive)
        keep = math.exp(-self.dt / 0.1)
        self._moved = keep * self._moved + (1.0 - keep) * np.nan_to_num(fresh) / self.dt
        self._drive = np.where(estimate.measured, estimate.drive, np.nan)
        found = []
        if self._neutral_s > rule.after_s:
            for name, valve, speed in zip(self.axes, self.valves, self._moved, strict=True):
                if abs(speed) > rule.share * valve.fastest:
                    text = f"{name} moves at {speed:.4g} though its valve is neutral"
                    found.append(
                        Violation("restless", name, rule.reaction, abs(float(speed)), rule.share * valve.fastest, text)
                    )
        return found

    def _persists(self, check: str, target: str, wrong: bool, seconds: float) -> bool:
        lasted = self._durations.get((check, target), 0.0) + self.dt if wrong else 0.0
        self._durations[check, target] = lasted
        return lasted > seconds + 1e-9
