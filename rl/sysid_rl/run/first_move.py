"""The first move after a start: each axis is slow until its measured response has agreed with the plant's.

A commissioning proves the wiring of its day, not of today. Whenever valves are enabled, each axis has to answer again, in two
steps:

1. its reading alone moves, to the side of its command. The axes take turns; valves of axes that have not answered are neutral.
2. its response excludes a gain beyond :data:`sysid_rl.run.response.OTHER_GAINS`, whatever its dead-band. Then it is released.
   Where dead-bands may be wider by more than :data:`BAND`, it is released after :data:`SEEN`: slow commands, which exceed a
   dead-band by less than is known of it, show no gain.

Until then an axis moves the end effector at about ``checks.first_move.speed``, by commands that rise slowly. Where dead-bands
may be wider than the plant's (``checks.motion.wider``), the command of an axis that stands rises by that too. The task waits:
its clock slows down where setpoints are behind by more than :data:`LAG`. It is a fault when

- an axis leaves the range of responses (:mod:`sysid_rl.run.response_range`): it moves to the wrong side, or without a command;
- the command of an axis moves another reading;
- nothing moves on :data:`SILENT` by the plant with the widest dead-bands of the tolerance;
- the response excludes the plant's gain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid_rl.run.checks.settings import FirstMoveCheck
from sysid_rl.run.command_filter import CommandFilter
from sysid_rl.run.cycle import Violation
from sysid_rl.run.response import ODDS, GainComparison, ResponseMonitor
from sysid_rl.run.response_range import BAND, ResponseRange

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Lag of the setpoints of slow axes at the end effector: from here on the task slows down, and here it stands [m].
LAG = (0.002, 0.01)
#: Lag of an axis that has not answered for which the others wait [m].
WAITS = 0.002
#: A setpoint waits at this distance from an axis that has not answered, or is not released, at the end effector [m].
AHEAD = (0.006, 0.015)
#: Acceleration of a slow axis at the end effector, also of one that is wired to the command by mistake [m/s²].
ACCELERATION = 0.1
#: Speed at the end effector by the first command of an axis [m/s].
START = 0.008
#: Least demand for which an axis gets its turn, as speed at the end effector [m/s], and time for a lag as a demand [s].
DEMAND, LAG_S = 0.001, 0.1
#: Largest command beyond the plant's dead-band, and the wider one of the tolerance.
EXTRA_BAND = 0.15
#: Motion at the end effector by the plant: for an answer; after which a reading that stands is compared with the others; after
#: which none may stand; and after which the speed of an axis whose gain is not certain is twice that of its beginning [m].
ANSWER, COMPARED, SILENT, ENOUGH = 0.002, 0.005, 0.018, 0.05
#: A reading stands below this share of the motion by the plant; another one moves above this share of the own one.
STILL, CROSS = 0.15, 0.3
#: Motion of a stroke at the end effector after which an axis is released whose gain cannot be compared [m].
SEEN = 0.02
#: Standard errors by which a reading must change to count as motion, and the least change as time at top speed [s].
SIGMAS, LEAST_S = 5.0, 0.003
#: Time from the speed of the first move to the full one, and from there to rest [s].
RELEASE_S, REST_S = 0.7, 0.25
#: Rate at which the clock of the task approaches its speed [1/s], and change of that rate [1/s²].
PACE_GAIN, PACE_JERK = 8.0, 20.0
#: Above this speed of the clock it is 1.
FULL_PACE = 0.998
#: Cycles between two comparisons of a gain, a part of :attr:`GainComparison.cycles`, and comparisons in a row that must exclude
#: that of the plant.
EVERY, REPEATS = 5, 2


class FirstMove:
    """The first move of one run.

    Args:
        axes, command_filter: of the machine.
        rule: of the recipe.
        response, response_range: of the state estimator.
    """

    def __init__(
        self,
        axes: Sequence[str],
        command_filter: CommandFilter,
        rule: FirstMoveCheck,
        response: ResponseMonitor,
        response_range: ResponseRange,
    ) -> None:
        self.axes, self.command_filter, self.rule = tuple(axes), command_filter, rule
        self.gains, self.range = GainComparison(response), response_range
        self.valves, self.dt = command_filter.valves, command_filter.dt
        self._fastest = np.array([valve.fastest for valve in self.valves])
        count = len(self.axes)
        #: Axes that have answered, are released, and whose setpoints are behind because of the first move, (A,).
        self.answered, self.released, self.slowed = (
            np.ones(count, np.bool_),
            np.ones(count, np.bool_),
            np.zeros(count, np.bool_),
        )
        #: Axes whose setpoints the first move limits, or that have to catch up after it, (A,).
        self.exempt: Mask = np.zeros(count, np.bool_)
        #: Share of the speed limits of the setpoints, (A,); speed of the task's clock.
        self.shares, self.pace = np.ones(count), 1.0
        #: Time since the beginning [s], and that of the release of each axis, (A,); NaN before.
        self.elapsed_s, self.released_s = 0.0, np.full(count, np.nan)
        #: Cycles in which the commands of an axis were reduced, (A,).
        self.reduced = np.zeros(count, dtype=np.int64)
        #: What the newest commands contain beyond the requested ones, (A,): the controller did not request it.
        self.raised = np.zeros(count)

    @property
    def done(self) -> bool:
        """All axes are released."""
        return bool(self.released.all())

    def begin(self, joints: Array, drive: Array) -> None:
        """Begin with the machine at rest at ``joints`` and ``drive`` (A,)."""
        axes = len(self.axes)
        self.answered, self.released, self.slowed = np.zeros(axes, np.bool_), np.zeros(axes, np.bool_), np.ones(axes, np.bool_)
        self.shares, self.pace, self.elapsed_s, self.released_s = np.zeros(axes), 1.0, 0.0, np.full(axes, np.nan)
        self.reduced = np.zeros(axes, dtype=np.int64)
        self._turn, self._lag, self._cycle, self._pace_rate = -1, np.zeros(axes), 0, 0.0
        #: By what commands forwards, and backwards, of axes that stood are raised, (2, A).
        self._raised = np.zeros((2, axes))
        #: Motion by the plant so far, (A,) [m]; gains that were not the plant's, in a row, (A,).
        self._travel, self._other_gain = np.zeros(axes), np.zeros(axes, dtype=int)
        #: Where the present stroke of each axis began: measured, and by the plant; its direction; cycles since its onset, (A,).
        self._rest, self._from, self._before = self.range.measured.copy(), self._by_plant, self.range.predicted.copy()
        self._direction, self._onset = np.zeros(axes), np.full(axes, -1)
        self._at(joints, drive)
        own = np.array([max(valve.up, valve.down) for valve in self.valves]) * self._at_tip
        bands = np.array([min(valve.positive, valve.negative) for valve in self.valves])
        #: Largest commands, (A,), and their rate [1/s].
        self._most, self._rate = np.full(axes, float((bands + START / own).min())), ACCELERATION / float(own.max())
        self.range.begin()
        self.gains.begin()

    def skip(self) -> None:
        """The task itself compares each axis with the plant."""
        self.answered[:], self.released[:], self.slowed[:], self.exempt[:], self.shares[:] = True, True, False, False, 1.0
        self.pace = 1.0

    def summary(self) -> str:
        """When the axes were released, and which were not; "" if no axis was to answer."""
        if not self.elapsed_s:
            return ""
        released = [f"{name} after {at:.1f} s" for name, at in zip(self.axes, self.released_s, strict=True) if at == at]
        left = [
            f"{name} (its commands were reduced in {count} cycles)"
            for name, done, count in zip(self.axes, self.released, self.reduced, strict=True)
            if not done
        ]
        parts = [f"released {', '.join(released)}"] if released else []
        return "first move: " + "; ".join([*parts, *([f"not released {', '.join(left)}"] if left else [])])

    def commands(self, requested: Array, joints: Array, drive: Array) -> Array:
        """Permitted commands (A,) for requested ones (A,)."""
        self.raised = np.zeros(len(self.axes))
        if self.done:
            return requested
        self.elapsed_s += self.dt
        wanted = np.nan_to_num(requested)
        speeds = self._by_valves(wanted)
        self._take_turns(np.abs(speeds) * self._at_tip, joints, drive)
        axes = np.arange(len(self.axes))
        turn, speed = axes == self._turn, np.abs(self.range.speed) * self._at_tip
        side = (wanted < 0.0).astype(int)
        at_rest = ~self.released & (self.answered | turn) & (speeds != 0.0) & (speed < START)
        self._raised[side, axes] = np.minimum(self._raised[side, axes] + at_rest * self._rate * self.dt, self.range.wider)
        more = wanted + np.where(self.released, 0.0, np.sign(wanted) * self._raised[side, axes])
        rises = (np.abs(more) > self._most) & (speed < self._speeds)
        self._most = np.where(
            rises, np.maximum(self._most, np.minimum(self._most + self._rate * self.dt, self._top)), self._most
        )
        slow = np.where(self.answered | turn, np.clip([wanted, more], -self._most, self._most), 0.0)
        usual, passed = np.where(self.released, wanted, slow)
        self.raised = passed - usual
        self.reduced += np.abs(wanted - usual) > 1e-9
        return np.asarray(passed)

    def follow(self, wanted: Array, setpoints: Array, joints: Array, limited: Mask) -> None:
        """Record the lag of ``setpoints`` (A,) behind the ``wanted`` ones, and that of ``joints`` (A,) behind them.

        Args:
            limited: whether a setpoint was limited, (A,).
        """
        self.exempt = limited & self.exempt | self.slowed | (self.pace < 1.0)
        if not self.slowed.any() and self.pace >= 1.0:
            return
        self._lag = np.abs(wanted - setpoints) * self._per_joint
        self.slowed = (self.slowed & limited) | ~self.released | (self.shares < 1.0)
        late = self._lag > LAG[0]
        worst: float = self._lag[self.slowed].max(initial=0.0)
        pace = min(max((LAG[1] - worst) / (LAG[1] - LAG[0]), 0.0), 1.0)
        if (self.slowed & self.released).any() and not (late & ~self.released).any():
            pace = 0.0  # until the setpoints of released axes have caught up
        # Its jerk is that of the setpoints.
        rate = min(max(PACE_GAIN * (pace - self.pace), -1.0 / REST_S), 1.0 / RELEASE_S)
        self._pace_rate += min(max(rate - self._pace_rate, -self.dt * PACE_JERK), self.dt * PACE_JERK)
        self.pace = min(max(self.pace + self._pace_rate * self.dt, 0.0), 1.0)
        if pace >= 1.0 and self.pace > FULL_PACE:
            self.pace = 1.0
        slow = np.minimum(self._speeds / (self._per_joint * self.command_filter.limits.speed), 1.0)
        turn = np.arange(len(self.axes)) == self._turn
        # What has answered stands while another axis has to, and is slow while another axis is.
        free = np.where(self.released & ~(late & ~self.released).any(), 1.0, slow)
        waits = bool((self._lag[~self.answered] > WAITS).any())
        target = np.where(self.answered, 0.0 if waits else free, np.where(turn, slow, 0.0))
        ahead = np.abs(setpoints - joints) * self._per_joint
        target[~self.released & (ahead > np.where(self.answered, AHEAD[1], AHEAD[0]))] = 0.0
        rise = np.where(self.released, 1.0 / RELEASE_S, slow * ACCELERATION / self.rule.speed) * self.dt
        self.shares = np.clip(target, self.shares - self.dt / REST_S, self.shares + rise)

    def without_setpoints(self) -> None:
        """The task states commands, no setpoints."""
        self._lag[:], self.pace = 0.0, 1.0

    def check(self) -> list[Violation]:
        """Violations of this cycle while the valves may move."""
        if self.done:
            return []
        self._cycle += 1
        wrong = self._outside()
        self._follow_strokes()
        for i in np.flatnonzero(~self.released & (self.answered | (np.arange(len(self.axes)) == self._turn))):
            wrong = wrong or (self._gain(int(i)) if self.answered[i] else self._answer(int(i)))
        return [] if wrong is None else [wrong]

    def _take_turns(self, speeds: Array, joints: Array, drive: Array) -> None:
        """Give the next axis its turn, for requested speeds at the end effector (A,)."""
        demand = np.where(self.answered, -1.0, np.maximum(speeds, self._lag / LAG_S))
        turn = self._turn
        if turn >= 0 and (self.answered[turn] or (demand[turn] < DEMAND and demand.max() > 2.0 * DEMAND)):
            self._turn = turn = -1
        # The next axis waits until the answers to the one before are over.
        if turn < 0 and demand.max() > DEMAND and self.range.still[~self.answered].all():
            self._turn = turn = int(np.argmax(demand))
            self._at(joints, drive)
            waiting = ~self.answered
            self._rest[waiting], self._from[:, waiting] = self.range.measured[waiting], self._by_plant[:, waiting]
            self._onset[turn] = -1

    def _follow_strokes(self) -> None:
        """Motion since the axes began to move to their present side."""
        predicted, direction = self.range.predicted, self.range.direction
        self._travel += np.abs(predicted - self._before) * self._at_tip
        self._before = predicted.copy()
        turned = self.answered & (direction * self._direction < 0.0)
        self._rest[turned], self._from[:, turned] = self.range.measured[turned], self._by_plant[:, turned]
        self._onset[turned] = -1
        self._direction = np.where(direction != 0.0, direction, self._direction)
        moved = np.abs(self.range.measured - self._rest) > self._least
        self._onset = np.where(self._onset >= 0, self._onset + 1, np.where(moved, 0, -1))

    @property
    def _speeds(self) -> Array:
        """Speeds of axes that are not released, at the end effector, (A,) [m/s]: higher ones tell more of the gain."""
        return self.rule.speed * (1.0 + np.where(self.answered, self._travel / ENOUGH, 0.0))

    @property
    def _top(self) -> Array:
        """The largest commands of axes that are not released, (A,)."""
        own = np.array([max(valve.up, valve.down) for valve in self.valves]) * self._at_tip
        bands = np.array([max(valve.positive, valve.negative) for valve in self.valves])
        beyond = 1.5 * self._speeds / own
        return np.asarray(bands + self.range.wider + np.where(self.answered, BAND + beyond, np.minimum(EXTRA_BAND, beyond)))

    def _by_valves(self, commands: Array) -> Array:
        """Speeds (A,) by the plant's valves at commands (A,)."""
        return np.array([valve.speed(float(u)) for valve, u in zip(self.valves, commands, strict=True)])

    @property
    def _by_plant(self) -> Array:
        """Travel by the plant, and with the widest dead-bands of the tolerance, (2, A)."""
        return np.stack([self.range.predicted, self.range.certain])

    @property
    def _least(self) -> Array:
        """Least change of a measurement that counts as motion, (A,)."""
        return SIGMAS * self.range.noise + LEAST_S * self._fastest

    def _outside(self) -> Violation | None:
        excess, limit = self.range.excess.max(axis=0), self.range.allowance(self.rule.seconds)
        for i in np.flatnonzero((excess > limit) & (~self.released | self.range.still)):
            alone = "" if self._turn in (-1, i) else f"while {self.axes[self._turn]} is commanded, "
            return self._violation(
                int(i), float(excess[i]), float(limit[i]), alone + self.range.described(int(i), self.axes[i])
            )
        return None

    def _answer(self, i: int) -> Violation | None:
        """The violation of the axis whose turn it is, if any; it has answered if its reading alone moves, to the right side."""
        name, measured, least = self.axes[i], self.range.measured - self._rest, self._least
        predicted, certain = (self._by_plant - self._from)[:, i]
        travel, sure, own = np.abs([predicted, certain, measured[i]]) * self._at_tip[i]
        others = ~self.answered & self.range.still & (np.abs(measured) > np.maximum(least, CROSS * own / self._at_tip))
        others[i] = False
        still = own < STILL * sure
        if travel > COMPARED and others.any():
            other = self.axes[int(np.flatnonzero(others)[0])]
            text = f"the command of {name} moves the reading of {other}{'' if still else ' as well'}: "
            text += "valves or sensors are swapped" if still else "two axes share a valve or a sensor"
            return self._violation(i, float(own), float(travel), text)
        if sure > SILENT and still:
            text = f"the command of {name} moves nothing: its valve, its sensor, or a dead-band or play beyond the plant's"
            return self._violation(i, float(own), float(travel), text)
        onwards = measured[i] * predicted > 0.0 and abs(float(measured[i])) > 2.0 * least[i]
        self.answered[i] = min(travel, own) > ANSWER and onwards and not still and not others.any()
        return None

    def _gain(self, i: int) -> Violation | None:
        """The violation of an axis that has answered, if its gain is not that of its plant; released if it is."""
        if self.range.wider > BAND:
            if abs(float(self.range.measured[i] - self._rest[i])) * self._at_tip[i] > SEEN:
                self.released[i], self.released_s[i] = True, self.elapsed_s
        elif self._onset[i] > 0 and self._onset[i] % EVERY == 0:
            odds, gain = self.gains.odds(i, int(self._onset[i]))
            self._other_gain[i] = self._other_gain[i] + 1 if odds < -ODDS else 0
            if self._other_gain[i] >= REPEATS:
                text = f"{self.axes[i]} moves {gain:.2f} times as fast as its plant: the scale of its sensor, or another valve"
                return self._violation(i, gain, 1.0, text)
            if odds > ODDS:
                self.released[i], self.released_s[i] = True, self.elapsed_s
        return None

    def _violation(self, i: int, found: float, limit: float, text: str) -> Violation:
        return Violation("first_move", self.axes[i], self.rule.reaction, found, limit, f"first move: {text}")

    def _at(self, joints: Array, drive: Array) -> None:
        """Motion of the end effector per unit of what is driven, and of the joint, (A,) [m], at joints and drive (A,)."""
        self._at_tip = self.command_filter.tip_ratios(drive)
        slopes = [
            1.0 if linkage is None else abs(float(np.diff(linkage.displacement(np.array([q - 1e-3, q + 1e-3])))[0])) / 2e-3
            for linkage, q in zip(self.command_filter.linkages, joints, strict=True)
        ]
        self._per_joint = self._at_tip * np.array(slopes)
