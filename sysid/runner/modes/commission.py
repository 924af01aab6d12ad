"""The first motion of a machine: one axis at a time, slowly and a little way to and fro, each stroke compared with the plant.

A stroke is a valve command that rises slowly from zero until the machine has moved by a few millimetres at the boom tip, and
then is zero. It is so slow that whatever the command is wired to keeps ``speed`` of the recipe. What was measured is compared
with the motion that the plant makes of the commands sent: the same axis has to have moved, to the same side, by the same gain
and as soon. The dead-band is left open: it shows, and is reported. The first thing that does not fit ends the run.

The zero of a sensor does not show in motion. It is compared with what else says where the axis stands: the joint's own sensor,
the measured end effector, or a reference pose that somebody has put the machine in. Where nothing does, that is said and has to
be accepted in the recipe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.config import STRICT
from sysid.machine import Machine, TabulatedLinkage
from sysid.runner.cycle import Cycle
from sysid.runner.limits import Limits
from sysid.runner.modes.mode import Goal, done
from sysid.runner.valves import AxisValve
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Directions of the strokes of an axis; it ends where it began. Those to the same side as the one before find play taken up: by
#: them gains are evaluated.
DIRECTIONS = (1, -1, -1, 1, 1, -1)
#: A command that rises takes so long from the beginning of motion to the speed of the recipe, on the fastest axis [s].
RISE_S = 1.0
#: Before each stroke, and after it, the machine rests [s]; readings of the last part of it say where it stands.
REST_S, STAND_S = 0.7, 0.3
#: Nothing moves up to this much beyond the plant's dead-band: the stroke ends [command].
EXTRA_BAND = 0.15
#: Where the plant says that the stroke is over and motion has only begun, it goes on for so long at the most [s].
AFTER_S = 0.15
#: An axis has moved if its reading has by so many standard errors.
SIGMAS = 5.0
#: The noise of a sensor is at least this share of its range: some have steps and stand still between them.
NOISE = 1e-4
#: Readings that are averaged to see motion begin.
BEGINS = 8
#: Of what the right axis moves at the boom tip, another one may seem to.
CROSS_SHARE = 0.3
#: True gain over the plant's that passes, and delay beyond the plant's dead time [s].
GAIN, DELAY_S = (0.6, 1.5), 0.1
#: A reading that went less than this share of a stroke says less of the gain: this passes then.
SHORT, GAIN_SHORT = 0.7, (0.3, 3.0)
#: What is looked for: dead-bands beside the plant's [command], delays [s].
BANDS, DELAYS = np.arange(-0.20, 0.201, 0.01), np.arange(0.0, 0.401, 0.04)


@dataclass(frozen=True)
class CommissionSettings:
    """``[commission]``.

    Args:
        speed: of the boom tip, at the most about that [m/s]; ``travel`` of it in a stroke [m].
        zero: a sensor's zero may move the boom tip by so much [m].
        reference: driven signal → where it stands when the run begins [m or rad], by a mark or an end stop that is looked at.
        unseen: driven signal whose zero nothing else shows → why that is accepted.
        waived: why this machine is run without a record of its commissioning; empty: it is not.
    """

    __pydantic_config__ = STRICT

    speed: float = 0.03
    travel: float = 0.007
    zero: float = 0.015
    reference: dict[str, float] = field(default_factory=dict)
    unseen: dict[str, str] = field(default_factory=dict)
    waived: str = ""


@dataclass(frozen=True)
class StrokeResult:
    """What came of one stroke.

    Args:
        axis: that was commanded; ``direction``: the sign of its command.
        command: the greatest one. moved: axis → how far its reading went [m or rad].
        tip: how far the boom tip went by it [m].
        evaluated: play was taken up before it, so that gain and delay can be told.
        gain: measured over the plant's. dead_band: beyond the plant's [command]. delay: beyond the plant's dead time [s].
        wrong: what does not fit, "" where all does.
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
    """The mode; :meth:`watch` has to be shown every cycle of the loop.

    Args:
        machine, valves, linkages, limits, dt: of the machine; ``tip``: joints (n, A) → end effector (n, 3) [m].
        settings: of the recipe.
    """

    name, moves, writes, computes = "commission", True, True, True

    def __init__(
        self,
        machine: Machine,
        valves: Sequence[AxisValve],
        linkages: Sequence[TabulatedLinkage | None],
        limits: Limits,
        tip: Callable[[Array], Array],
        dt: float,
        settings: CommissionSettings,
    ) -> None:
        self.axes, self.valves, self.linkages = machine.axis_names, tuple(valves), tuple(linkages)
        self.driven = tuple(axis.driven for axis in machine.axes)
        self.limits, self.tip, self.dt, self.settings = limits, tip, dt, settings
        self.strokes: list[StrokeResult] = []
        #: Driven signal → what showed its zero, and by how much it was off at the boom tip [m].
        self.zeros: dict[str, tuple[str, float]] = {}
        self._rows: list[tuple[Array, Array]] = []
        self._last: dict[str, list[float]] = {}
        self._plan: list[tuple[int, int]] = []
        self._failure = ""
        self._tip_ratio = np.zeros(len(self.axes))
        self._stroke_begin = self._off = 0
        self._seen: int | None = None

    @property
    def passed(self) -> bool:
        """All strokes were made and nothing was wrong."""
        return (
            not self._failure
            and len(self.strokes) == len(DIRECTIONS) * len(self.axes)
            and not any(item.wrong for item in self.strokes)
        )

    def watch(self, cycle: Cycle) -> None:
        """A cycle of the loop is over."""
        row = [cycle.readings[signal].value if signal in cycle.readings else math.nan for signal in self.driven]
        self._rows.append((np.array(row), cycle.commands))
        for signal, reading in cycle.readings.items():
            self._last[signal] = [*self._last.get(signal, [])[-round(STAND_S / self.dt) + 1 :], reading.value]

    def begin(self, joints: Array, ee: Array) -> None:
        """The machine stands where ``joints`` (A,) say."""
        self._failure = "" if len(self._rows) >= STAND_S / self.dt else "nothing was shown to it: loop.run(watch=mode.watch)"
        if self._failure:
            return
        stands = np.array([np.mean(self._last[signal]) for signal in self.driven])
        self._tip_ratio = self._tip_ratios(stands)
        self._failure = self._zero(stands)
        self._plan = []
        for i, axis in enumerate(self.axes):
            if min(self._room(i, stands[i])) < 2.5 * self.settings.travel / self._tip_ratio[i] and not self._failure:
                self._failure = f"{axis} has no room for a stroke within its limits: move it away from them by hand"
            self._plan += [(i, sign) for sign in DIRECTIONS]
        gains = [max(valve.up, valve.down) * lever for valve, lever in zip(self.valves, self._tip_ratio, strict=True)]
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
            self._from, self._seen, self._off = len(self._rows), None, 0
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
        """Whether a stroke of axis ``i`` to the side of ``sign`` ends before this ``command`` (magnitude)."""
        valve, travel = self.valves[i], self.settings.travel
        band = max(valve.positive, valve.negative)
        self._predicted.append(self._predicted[-1] + abs(valve.speed(sign * command)) * self.dt)
        predicted = self._predicted[-1 - valve.dead_steps] * self._tip_ratio[i]
        fresh = np.array([row for row, _ in self._rows[-BEGINS:]])
        went = np.abs(fresh.mean(axis=0) - self._at_rest.mean(axis=0))
        moved = went > SIGMAS * self._noise / math.sqrt(BEGINS)
        if self._seen is None and since >= BEGINS and moved.any():
            self._seen = since
        farthest = float(np.nanmax(went * self._tip_ratio))
        if self._seen is None:
            return command > band + EXTRA_BAND
        # Where the plant says that it is over, and little is seen of it: the sensor makes little of it, or play and a wider
        # dead-band came first.
        late = (since - self._seen) * self.dt > AFTER_S
        return farthest > travel or (predicted > travel and (late or farthest > 0.5 * travel))

    def _compare(self, i: int, sign: int) -> StrokeResult:
        """The stroke of axis ``i`` that is over."""
        axis, stood = self.axes[i], self._at_rest.mean(axis=0)
        rows, sent = (np.array(part) for part in zip(*self._rows[self._from :], strict=True))
        went = rows[-round(STAND_S / self.dt) :].mean(axis=0) - stood
        error = SIGMAS * self._noise * math.sqrt(2.0 * self.dt / STAND_S)
        at_tip = np.abs(went) * self._tip_ratio
        gain, band, delay = self._fit(i, sign, rows[:, i] - stood[i], sent[:, i])
        other = int(np.argmax(np.where(np.arange(len(self.axes)) == i, -1.0, at_tip)))
        top = float(np.abs(sent[:, i]).max())
        still = abs(went[i]) <= error[i]
        other_moved = abs(went[other]) > error[other] and at_tip[other] > CROSS_SHARE * at_tip[i]
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
        elif sign * went[i] < 0.0:
            wrong = f"{axis} goes the wrong way at a {'positive' if sign > 0 else 'negative'} command: a sign is turned"
        elif taken_up and not low <= gain <= high:
            wrong = f"{axis} moves {gain:.2f} times as fast as its plant: the scale of its sensor, or another valve"
        elif taken_up and delay > DELAY_S:
            wrong = f"{axis} answers {1e3 * delay:.0f} ms later than its plant: the line is late"
        moved = {name: float(value) for name, value in zip(self.axes, went, strict=True)}
        return StrokeResult(axis, sign, top, moved, float(at_tip[i]), taken_up, gain, band, delay, wrong)

    def _fit(self, i: int, sign: int, went: Array, sent: Array) -> tuple[float, float, float]:
        """Gain over the plant's, dead-band and delay beside the plant's, of what was measured and sent, (n,) each."""
        valve = self.valves[i]
        top, own = (valve.up, valve.positive) if sign > 0 else (valve.down, valve.negative)
        bands = BANDS[own + BANDS >= -1e-9]
        effective = np.maximum(np.abs(sent) - own - bands[:, None], 0.0) ** valve.exponent
        travel = np.cumsum(sign * top * effective * self.dt, axis=1)
        best = (math.inf, 0.0, 0.0, 0.0)
        for delay in DELAYS:
            late = np.zeros((len(bands), valve.dead_steps + 1 + round(delay / self.dt)))
            shifted = np.concatenate([late, travel], axis=1)[:, : len(went)]
            size = (shifted**2).sum(axis=1)
            gains = (shifted @ went) / np.maximum(size, 1e-18)
            errors = np.where(size > 1e-18, went @ went - gains**2 * size, math.inf)
            k = int(np.argmin(errors))
            if errors[k] < best[0]:
                best = float(errors[k]), float(gains[k]), float(bands[k]), float(delay)
        return best[1], best[2], best[3]

    def _zero(self, stands: Array) -> str:
        """What says that a zero is off; keeps what showed each of them."""
        here = self.tip(self._joints(stands)[None])[0]
        self.zeros.clear()
        joints = self._joints(stands)
        for i, (axis, signal, linkage) in enumerate(zip(self.axes, self.driven, self.linkages, strict=True)):
            other = axis_signal(axis, "joint")
            if linkage is not None and other in self._last:
                moved = joints.copy()
                moved[i] = np.mean(self._last[other])
                self.zeros[signal] = other, float(np.linalg.norm(self.tip(moved[None])[0] - here))
            if signal in self.settings.reference:
                moved = stands.copy()
                moved[i] = self.settings.reference[signal]
                self.zeros[signal] = "reference", float(np.linalg.norm(self.tip(self._joints(moved)[None])[0] - here))
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
                    f"nothing shows whether the zero of {signal} is right: put the machine where it is known and say so in "
                    f"[commission.reference], or why not in [commission.unseen]"
                )
        return ""

    def _joints(self, driven: Array) -> Array:
        """Joints (A,) at places (A,) of what is driven."""
        joints = driven.copy()
        for i, linkage in enumerate(self.linkages):
            if linkage is not None:
                joints[i] = linkage.joint(driven[i : i + 1])[0]
        return joints

    def _tip_ratios(self, stands: Array) -> Array:
        """How far the boom tip moves for each unit of what is driven, (A,)."""
        found = np.empty(len(stands))
        for i, valve in enumerate(self.valves):
            step = 0.01 * (valve.high - valve.low) * (-1.0 if stands[i] > 0.5 * (valve.low + valve.high) else 1.0)
            moved = stands.copy()
            moved[i] += step
            ends = self.tip(np.array([self._joints(stands), self._joints(moved)]))
            found[i] = max(float(np.linalg.norm(ends[1] - ends[0])) / abs(step), 1e-6)
        return found

    def _room(self, i: int, stands: float) -> tuple[float, float]:
        """What is driven may go so far down and up within the limits."""
        ends = np.array([self.limits.low[i], self.limits.high[i]])
        linkage = self.linkages[i]
        low, high = ends if linkage is None else np.sort(linkage.displacement(ends))
        return float(stands - low), float(high - stands)

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
