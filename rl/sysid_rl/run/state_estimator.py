"""The state estimator: readings, their age and plausibility, and dead reckoning → one state estimate a cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.plant import Plant
from sysid.signals import axis_signal
from sysid_rl.run.checks.settings import CheckSettings
from sysid_rl.run.clock import SECOND
from sysid_rl.run.response import LateAxis, ResponseMonitor
from sysid_rl.run.response_range import ResponseRange, Tolerance
from sysid_rl.run.transport import RELEASED_INPUTS, MachineInputs, Measurement
from sysid_rl.run.valves import AxisValve, DeadReckoning

Array = npt.NDArray[np.float64]

#: Time constant of the correction of dead reckoning by the sensors [s].
CORRECTION_S = 0.5
#: Permitted ratio of a reading's speed to the top speed of its axis.
FASTER = 1.5
#: Time in which the usual delay of a line is learned [s].
LEARN_S = 0.3


@dataclass(slots=True)
class Sensor:
    """One signal and its history.

    Args:
        signal: its canonical name; ``axis``: its number; ``driven``: it measures what the command drives.
        range: of its values; ``fastest``: top speed, in its unit.
        play: that the drive may take up before it moves, in its unit.
    """

    signal: str
    axis: int
    driven: bool
    range: float
    fastest: float
    play: float = 0.0
    value: float = math.nan
    count: int = -1
    age_s: float = math.inf
    usual_ns: int | None = None
    first_ns: int | None = None
    ahead_s: float = 0.0
    finite: bool = True
    jump: float = 0.0
    good: float = math.nan
    good_ns: int = 0
    still_since: float = 0.0
    repeats: int = 0
    valid: bool = False
    fresh: bool = False


@dataclass(slots=True)
class StateEstimate:
    """The state estimate of one cycle, evaluated by the supervisor.

    Args:
        sensors: driven ones first, in the order of axes; then joint sensors of cylinder axes.
        drive, joints: estimates, (A,); ``measured``: whether a valid sensor confirms them, (A,).
        estimated_position: dead reckoning of what is driven, (A,).
        ee: estimate of the end effector, (3,).
        late: axes that answer commands later than their plant.
    """

    now_ns: int
    lateness_s: float
    missed: int
    inputs: MachineInputs
    sensors: list[Sensor]
    drive: Array
    measured: npt.NDArray[np.bool_]
    estimated_position: Array
    joints: Array
    ee: Array = field(default_factory=lambda: np.full(3, np.nan))
    line: str = ""
    recording: str = ""
    late: tuple[LateAxis, ...] = ()


class StateEstimator:
    """The state estimator of one machine.

    Args:
        plant: with the linkages from cylinders to joints.
        valves: of its axes; ``dt`` of a step [s].
        signals: of the transport.
        settings: thresholds of valid sensors.
    """

    def __init__(
        self, plant: Plant, valves: tuple[AxisValve, ...], dt: float, signals: tuple[str, ...], settings: CheckSettings
    ) -> None:
        self.plant, self.valves, self.dt, self.settings = plant, valves, dt, settings
        axes = plant.machine.axes
        self.linkages = [plant.linkages[axis.name] if axis.drives == "cylinder" else None for axis in axes]
        self.driven = [
            Sensor(axis.driven, i, True, valve.high - valve.low, valve.fastest, valve.backlash)
            for i, (axis, valve) in enumerate(zip(axes, valves, strict=True))
        ]
        self.extra = []
        for i, axis in enumerate(axes):
            linkage, signal = self.linkages[i], axis_signal(axis.name, "joint")
            if linkage is not None and signal in signals:
                ends = np.sort(linkage.joint(np.array([valves[i].low, valves[i].high])))
                reach = float(ends[1] - ends[0])
                steep = float(np.abs(np.gradient(linkage.joints, linkage.displacements)).max())
                self.extra.append(Sensor(signal, i, False, reach, valves[i].fastest * steep))
        self.sensors = [*self.driven, *self.extra]
        self.dead_reckonings = [DeadReckoning(valve, dt, CORRECTION_S) for valve in valves]
        tolerance = Tolerance.of(plant, settings)
        self.response = ResponseMonitor(valves, dt, tolerance)
        self.response_range = ResponseRange(valves, dt, tolerance)

    def reset(self) -> None:
        """Reset the history, after a fault and before the first cycle.

        The usual delay is kept: a delay that has grown would otherwise become the usual one.
        """
        for sensor in self.sensors:
            sensor.good, sensor.count, sensor.first_ns, sensor.still_since = math.nan, -1, None, 0.0
        for dead_reckoning in self.dead_reckonings:
            dead_reckoning.reset(math.nan)
        self.response.reset()
        self.response_range.reset()

    def step(self, commands: Array) -> None:
        """Record a step with ``commands`` (A,), zero if neutral."""
        self.response.step(commands)
        certain = self.response_range.certain.copy()
        self.response_range.step(commands)
        ways = np.abs(self.response_range.certain - certain)
        for sensor, dead_reckoning, command, way in zip(self.driven, self.dead_reckonings, commands, ways, strict=True):
            before = dead_reckoning.position
            dead_reckoning.step(float(command))
            if not math.isnan(before):
                sensor.still_since += min(abs(dead_reckoning.position - before), float(way))

    def update(
        self, readings: Mapping[str, Measurement], inputs: MachineInputs, now_ns: int, lateness_s: float = 0.0, missed: int = 0
    ) -> StateEstimate:
        """The estimate of this cycle from its readings."""
        for sensor in self.sensors:
            self._update_sensor(sensor, readings.get(sensor.signal), now_ns)
        drive, joints = np.empty(len(self.driven)), np.empty(len(self.driven))
        for i, (sensor, dead_reckoning) in enumerate(zip(self.driven, self.dead_reckonings, strict=True)):
            if sensor.valid:
                if math.isnan(dead_reckoning.position):
                    dead_reckoning.position = sensor.value
                dead_reckoning.correct(sensor.value)
                drive[i] = sensor.value
            else:
                drive[i] = dead_reckoning.position
            linkage = self.linkages[i]
            joints[i] = drive[i] if linkage is None else linkage.joint(drive[i : i + 1])[0]
        fresh = np.array([sensor.value if sensor.valid and sensor.fresh else math.nan for sensor in self.driven])
        self.response.measure(fresh)
        self.response_range.measure(fresh)
        return StateEstimate(
            now_ns, lateness_s, missed, inputs, self.sensors, drive, np.array([sensor.valid for sensor in self.driven]),
            np.array([item.position for item in self.dead_reckonings]), joints,
            late=self.response.late,
        )  # fmt: skip

    def without_readings(self, now_ns: int, line: str) -> StateEstimate:
        """The estimate of a cycle without readings, because of the error ``line``."""
        estimate = self.update({}, RELEASED_INPUTS, now_ns)
        estimate.line = line
        return estimate

    def _update_sensor(self, sensor: Sensor, reading: Measurement | None, now_ns: int) -> None:
        if reading is None:
            sensor.age_s, sensor.valid, sensor.finite, sensor.jump, sensor.fresh = math.inf, False, True, 0.0, False
            return
        lag = reading.received_ns - reading.measured_ns
        if sensor.usual_ns is None:
            sensor.usual_ns = lag
        if sensor.first_ns is None:
            sensor.first_ns = now_ns
        sensor.ahead_s = (sensor.usual_ns - lag) / SECOND
        if now_ns - sensor.first_ns < LEARN_S * SECOND:
            sensor.usual_ns = min(sensor.usual_ns, lag)
        sensor.age_s = (now_ns - reading.received_ns + max(0, lag - sensor.usual_ns)) / SECOND
        sensor.fresh = fresh = reading.count != sensor.count
        sensor.count = reading.count
        value = reading.value
        sensor.finite = math.isfinite(value)
        if fresh and value != sensor.value:
            sensor.still_since, sensor.repeats = 0.0, 0
        elif fresh:
            sensor.repeats += 1
        sensor.value = value
        sensor.jump = 0.0
        if sensor.finite and not math.isnan(sensor.good):
            passed = max((now_ns - sensor.good_ns) / SECOND, self.dt)
            sensor.jump = max(0.0, abs(value - sensor.good) - FASTER * sensor.fastest * passed)
        late = sensor.age_s > self.settings.stale.after_s
        sensor.valid = sensor.finite and not late and sensor.jump <= self.settings.jump.share * sensor.range
        if sensor.valid and fresh:
            sensor.good, sensor.good_ns = value, now_ns
