"""The first motion of a machine: short, slow strokes of one axis at a time, each compared with the plant.

In a stroke the valve command rises slowly from zero until the boom tip has moved by a few millimetres, then is zero again. The
rate keeps ``speed`` of the recipe on any axis, also one that is wired to the command by mistake. The measured motion is
compared with the plant's response to the same commands: axis, direction, gain and delay must agree; the dead-band is estimated
and reported. The first violation ends the run.

A zero error of a sensor does not show in motion. The position is compared with the joint's own sensor, the measured end
effector, or a reference pose. Without any of them, the recipe must accept the unchecked zero.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid.machine import Machine
from sysid.signals import axis_signal
from sysid_rl.run.command_filter import CommandFilter
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.modes.mode import Goal, done

Array = npt.NDArray[np.float64]

#: Directions of the strokes of an axis, which returns to its start. A stroke in the direction of the one before has its
#: backlash taken up: it is used for gains.
DIRECTIONS = (1, -1, -1, 1, 1, -1)
#: Time from the beginning of motion to the speed of the recipe, on the fastest axis [s].
RISE_S = 1.0
#: Rest before and after each stroke, and its last part that is averaged for the position [s].
REST_S, STAND_S = 0.7, 0.3
#: A stroke without motion ends this far beyond the plant's dead-band [command].
EXTRA_BAND = 0.15
#: Longest continuation of a stroke that is over by the plant while the measured motion has only begun [s].
AFTER_S = 0.15
#: Standard errors by which a reading must change to count as motion.
SIGMAS = 5.0
#: Least noise of a sensor as a share of its range, for sensors with a coarse resolution.
NOISE = 1e-4
#: Readings averaged to detect the beginning of motion.
BEGINS = 8
#: Permitted motion of another axis at the boom tip, as a share of the own axis.
CROSS_SHARE = 0.3
#: Permitted ratio of the gain to the plant's, and delay beyond the plant's dead time [s].
GAIN, DELAY_S = (0.6, 1.5), 0.1
#: Below this share of a stroke the gain is uncertain, and this range is permitted.
SHORT, GAIN_SHORT = 0.7, (0.3, 3.0)
#: Search grid: dead-bands minus the plant's [command], delays [s].
BANDS, DELAYS = np.arange(-0.20, 0.201, 0.01), np.arange(0.0, 0.401, 0.04)


@dataclass(frozen=True)
class CommissionSettings(Strict):
    """``[commission]``.

    Args:
        speed: approximate upper limit for the boom tip [m/s]; ``travel``: of the tip in a stroke [m].
        zero: permitted zero error of a sensor, as motion of the boom tip [m].
        reference: driven signal → its value at the beginning of the run [m or rad], by a mark or an end stop.
        unseen: driven signal whose zero cannot be checked → why that is accepted.
        waived: why the machine runs without a record of its commissioning; empty: it does not.
    """

    speed: float = 0.03
    travel: float = 0.007
    zero: float = 0.015
    reference: dict[str, float] = field(default_factory=dict)
    unseen: dict[str, str] = field(default_factory=dict)
    waived: str = ""


@dataclass(frozen=True)
class StrokeResult:
    """The result of one stroke.

    Args:
        axis: commanded; ``direction``: sign of its command.
        command: the greatest one.
        moved: axis → change of its reading [m or rad].
        tip: motion of the boom tip by it [m].
        judged: the backlash was taken up before, so that gain and delay are valid.
        gain: measured over the plant's.
        dead_band, delay: beyond the plant's dead-band [command] and dead time [s].
        wrong: the violation, "" if there is none.
    """

    axis: str
    direction: int
    command: float
    moved: dict[str, float]
    tip: float
    judged: bool
    gain: float
    dead_band: float
    delay: float
    wrong: str


class Commission:
    """The mode; :meth:`watch` must be called with every cycle of the loop.

    Args:
        machine, command_filter: of the run.
        settings: of the recipe.
    """

    name, moves, writes, computes = "commission", True, True, True

    def __init__(self, machine: Machine, command_filter: CommandFilter, settings: CommissionSettings) -> None:
        self.axes, self.driven = machine.axis_names, tuple(axis.driven for axis in machine.axes)
        self.command_filter, self.valves, self.settings = command_filter, command_filter.valves, settings
        self.tip, self.dt = command_filter.tip, command_filter.dt
        self.strokes: list[StrokeResult] = []
        #: Driven signal → reference of its zero, and the error at the boom tip [m].
        self.zeros: dict[str, tuple[str, float]] = {}
        self._rows: list[tuple[Array, Array]] = []
        self._last: dict[str, list[float]] = {}
        self._plan: list[tuple[int, int]] = []
        self._failure = ""
        self._tip_ratio = np.zeros(len(self.axes))
        self._stroke_begin = self._off = 0
        self._motion_begin: int | None = None

    @property
    def passed(self) -> bool:
        """All strokes were made without a violation."""
        return (
            not self._failure
            and len(self.strokes) == len(DIRECTIONS) * len(self.axes)
            and not any(item.wrong for item in self.strokes)
        )

    def watch(self, cycle: Cycle) -> None:
        """Record a cycle of the loop."""
        row = [cycle.readings[signal].value if signal in cycle.readings else math.nan for signal in self.driven]
        self._rows.append((np.array(row), cycle.commands))
        for signal, reading in cycle.readings.items():
            self._last[signal] = [*self._last.get(signal, [])[-round(STAND_S / self.dt) + 1 :], reading.value]

    def begin(self, joints: Array, ee: Array) -> None:
        """Begin at ``joints`` (A,)."""
        self._failure = ""
        if len(self._rows) < STAND_S / self.dt:
            self._failure = "it did not receive the cycles: loop.run(watch=mode.watch)"
            return
        positions = np.array([np.mean(self._last[signal]) for signal in self.driven])
        self._tip_ratio = self.command_filter.tip_ratios(positions)
        self._failure = self._zero(positions)
        self._plan = []
        for i, axis in enumerate(self.axes):
            room = min(positions[i] - self.command_filter.low[i], self.command_filter.high[i] - positions[i])
            if room < 2.5 * self.settings.travel / self._tip_ratio[i] and not self._failure:
                self._failure = f"{axis} has no space for a stroke within its limits: move it away from them by hand"
            self._plan += [(i, sign) for sign in DIRECTIONS]
        gains = [max(valve.up, valve.down) * ratio for valve, ratio in zip(self.valves, self._tip_ratio, strict=True)]
        self._rate = self.settings.speed / (RISE_S * max(gains))
        self.strokes.clear()
        self._rest(0)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        if self._failure:
            return Goal("commission", stop=self._failure)
        if len(self.strokes) == len(self._plan):
            return done("commission")
        i, sign = self._plan[len(self.strokes)]
        phase, commands = f"{self.axes[i]} {'+' if sign > 0 else '−'}", np.zeros(len(self.axes))
        since = k - self._stroke_begin - round(REST_S / self.dt)
        if since == 0:
            self._from, self._motion_begin, self._off = len(self._rows), None, 0
            self._at_rest = np.array([row for row, _ in self._rows[-round(STAND_S / self.dt) :]])
            self._noise = np.maximum(
                self._at_rest.std(axis=0), NOISE * np.array([item.high - item.low for item in self.valves])
            )
            self._predicted = [0.0] * (self.valves[i].dead_steps + 1)
        if since >= 0 and not self._off:
            command = self._rate * since * self.dt
            if self._stroke_is_over(i, sign, command, since):
                self._off = since
            else:
                commands[i] = sign * command
        if self._off and since >= self._off + round(REST_S / self.dt):
            self.strokes.append(self._compare(i, sign))
            if self.strokes[-1].wrong:
                self._failure = self.strokes[-1].wrong
                return Goal(phase, stop=self._failure)
            self._rest(k)
        return Goal(phase, commands=commands)

    def _rest(self, k: int) -> None:
        self._stroke_begin, self._off = k, 0

    def _stroke_is_over(self, i: int, sign: int, command: float, since: int) -> bool:
        """Whether a stroke of axis ``i`` in the direction ``sign`` ends before this ``command`` (magnitude)."""
        valve, travel = self.valves[i], self.settings.travel
        band = max(valve.positive, valve.negative)
        self._predicted.append(self._predicted[-1] + abs(valve.speed(sign * command)) * self.dt)
        predicted = self._predicted[-1 - valve.dead_steps] * self._tip_ratio[i]
        fresh = np.array([row for row, _ in self._rows[-BEGINS:]])
        travelled = np.abs(fresh.mean(axis=0) - self._at_rest.mean(axis=0))
        moved = travelled > SIGMAS * self._noise / math.sqrt(BEGINS)
        if self._motion_begin is None and since >= BEGINS and moved.any():
            self._motion_begin = since
        farthest = float(np.nanmax(travelled * self._tip_ratio))
        if self._motion_begin is None:
            return command > band + EXTRA_BAND
        # Over by the plant with little measured motion: a small scale of the sensor, or backlash or a wider dead-band.
        late = (since - self._motion_begin) * self.dt > AFTER_S
        return farthest > travel or (predicted > travel and (late or farthest > 0.5 * travel))

    def _compare(self, i: int, sign: int) -> StrokeResult:
        """Compare the finished stroke of axis ``i`` with the plant."""
        axis, rest_position = self.axes[i], self._at_rest.mean(axis=0)
        rows, sent = (np.array(part) for part in zip(*self._rows[self._from :], strict=True))
        travelled = rows[-round(STAND_S / self.dt) :].mean(axis=0) - rest_position
        error = SIGMAS * self._noise * math.sqrt(2.0 * self.dt / STAND_S)
        at_tip = np.abs(travelled) * self._tip_ratio
        gain, band, delay = self._fit(i, sign, rows[:, i] - rest_position[i], sent[:, i])
        other = int(np.argmax(np.where(np.arange(len(self.axes)) == i, -1.0, at_tip)))
        top = float(np.abs(sent[:, i]).max())
        still = abs(travelled[i]) <= error[i]
        other_moved = abs(travelled[other]) > error[other] and at_tip[other] > CROSS_SHARE * at_tip[i]
        taken_up = bool(self.strokes) and (self.strokes[-1].axis, self.strokes[-1].direction) == (axis, sign)
        low, high = GAIN if at_tip[i] >= SHORT * self.settings.travel else GAIN_SHORT
        wrong = ""
        if other_moved:
            wrong = f"the command of {axis} moves the reading of {self.axes[other]}: valves or sensors are swapped"
            if not still:
                wrong = f"the command of {axis} moves the reading of {self.axes[other]} as well"
        elif still:
            wrong = (
                f"the command of {axis} moves nothing up to {top:.2f}: its valve, its sensor or a dead-band beyond the plant's"
            )
        elif sign * travelled[i] < 0.0:
            wrong = f"{axis} moves in the wrong direction at a {'positive' if sign > 0 else 'negative'} command: reversed sign"
        elif taken_up and not low <= gain <= high:
            wrong = f"{axis} moves {gain:.2f} times as fast as its plant: the scale of its sensor, or another valve"
        elif taken_up and delay > DELAY_S:
            wrong = f"{axis} answers {1e3 * delay:.0f} ms later than its plant: the line is late"
        moved = {name: float(value) for name, value in zip(self.axes, travelled, strict=True)}
        return StrokeResult(axis, sign, top, moved, float(at_tip[i]), taken_up, gain, band, delay, wrong)

    def _fit(self, i: int, sign: int, travelled: Array, sent: Array) -> tuple[float, float, float]:
        """Gain over the plant's, dead-band and delay minus the plant's, of measured motion and sent commands, (n,) each."""
        valve = self.valves[i]
        top, own = (valve.up, valve.positive) if sign > 0 else (valve.down, valve.negative)
        bands = BANDS[own + BANDS >= -1e-9]
        effective = np.maximum(np.abs(sent) - own - bands[:, None], 0.0) ** valve.exponent
        travel = np.cumsum(sign * top * effective * self.dt, axis=1)
        best = (math.inf, 0.0, 0.0, 0.0)
        for delay in DELAYS:
            late = np.zeros((len(bands), valve.dead_steps + 1 + round(delay / self.dt)))
            shifted = np.concatenate([late, travel], axis=1)[:, : len(travelled)]
            size = (shifted**2).sum(axis=1)
            gains = (shifted @ travelled) / np.maximum(size, 1e-18)
            errors = np.where(size > 1e-18, travelled @ travelled - gains**2 * size, math.inf)
            k = int(np.argmin(errors))
            if errors[k] < best[0]:
                best = float(errors[k]), float(gains[k]), float(bands[k]), float(delay)
        return best[1], best[2], best[3]

    def _zero(self, positions: Array) -> str:
        """Compare all zeros with their references; the first violation, or ""."""
        joints = self.command_filter.joints(positions[None])[0]
        here = self.tip(joints[None])[0]
        self.zeros.clear()
        for i, (axis, signal, linkage) in enumerate(zip(self.axes, self.driven, self.command_filter.linkages, strict=True)):
            other = axis_signal(axis, "joint")
            if linkage is not None and other in self._last:
                moved = joints.copy()
                moved[i] = np.mean(self._last[other])
                self.zeros[signal] = other, float(np.linalg.norm(self.tip(moved[None])[0] - here))
            if signal in self.settings.reference:
                moved = positions.copy()
                moved[i] = self.settings.reference[signal]
                self.zeros[signal] = (
                    "reference",
                    float(np.linalg.norm(self.tip(self.command_filter.joints(moved[None]))[0] - here)),
                )
        measured = [f"ee.{letter}" for letter in "xyz"]
        if all(signal in self._last for signal in measured):
            there = np.array([np.mean(self._last[signal]) for signal in measured])
            for signal in self.driven:
                self.zeros.setdefault(signal, ("ee", float(np.linalg.norm(there - here))))
        for signal, (what, off) in self.zeros.items():
            if off > self.settings.zero:
                if what == "ee":
                    return f"the measured end effector is {1e3 * off:.0f} mm from where the joints put it: a zero is off"
                return f"the zero of {signal} is off: by {what} the boom tip is {1e3 * off:.0f} mm elsewhere"
        for signal in self.driven:
            if signal not in self.zeros and not self.settings.unseen.get(signal, "").strip():
                return (
                    f"no reference for the zero of {signal}: move the machine to a known pose and state it in "
                    f"[commission.reference], or the reason without one in [commission.unseen]"
                )
        return ""

    def figures(self) -> dict[str, object]:
        """Strokes and zeros, for the record."""
        zeros = {signal: {"shown_by": what, "off_at_tip_m": off} for signal, (what, off) in self.zeros.items()}
        unseen = {signal: self.settings.unseen.get(signal, "") for signal in self.driven if signal not in zeros}
        return {
            "strokes": [asdict(item) for item in self.strokes],
            "zeros": zeros,
            "zeros_not_seen": unseen,
            "wrong": self._failure,
        }
