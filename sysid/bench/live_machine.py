"""The simulated test bench while it runs: commands that come when they come, a watchdog of its own, sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.bench.compiled import compiled
from sysid.bench.recipe import AXES, BenchRecipe
from sysid.bench.run import WIRED
from sysid.bench.sensors import read_slew, read_wires, through
from sysid.bench.stepping import BenchState, Built, advance_machine, built_of, parked
from sysid.bench.valve import delayed, flow_fluctuation

Array = npt.NDArray[np.float64]

#: Commands older than this are none [ns]: valves go neutral by themselves.
TIME_OUT_NS = 100_000_000
#: What is to be begun this long after the time of the machine that it answers is not begun at all [ns].
LATE_NS = 60_000_000
#: A stamp may be ahead of the machine by this: rounding [ns].
AHEAD_NS = 5_000_000
#: Noise of what is set up for commissioning alone: inclinometers [rad], the tracked prism [m].
INCLINOMETER_NOISE, TRACKER_NOISE = 2e-4, 1e-4
#: Flow fluctuates over so many seconds before it repeats.
_FLUCTUATION = 120.0


@dataclass
class Watchdog:
    """What the machine's side makes of the commands that reach it; times are of its own clock [ns].

    Every valve needs a command of its own, and somebody who says that he is fit to give them, at least every ``TIME_OUT_NS``.
    A counter that stands still says nothing. Where commands say which time of the machine they answer, one that comes too late
    is none, and the others are forgotten ``TIME_OUT_NS`` after that time. ``fault``: 0 none, 1 commands stopped, 2 the sender
    calls himself unfit, 3 commands came late.
    """

    asked: Array = field(default_factory=lambda: np.zeros(len(AXES)))
    fit: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(len(AXES), dtype=bool))
    came_ns: list[int] = field(default_factory=lambda: [-TIME_OUT_NS] * len(AXES))
    enabled: bool = False
    counter: int = -1
    alive_ns: int = -TIME_OUT_NS
    fault: int = 0
    late_ns: int = -TIME_OUT_NS
    #: Commands that came too late.
    refused: int = 0

    def command(self, axis: int, value: float, fit: bool, now_ns: int, age_ns: int = 0) -> None:
        """A valve command of ``axis`` came that answers what the machine was ``age_ns`` ago; one that is unfit has no age."""
        if fit and not -AHEAD_NS <= age_ns <= LATE_NS:
            self.late_ns, self.refused = now_ns, self.refused + 1
            return
        self.asked[axis], self.fit[axis], self.came_ns[axis] = value, fit, now_ns - max(0, age_ns)

    def alive(self, counter: int, enabled: bool, now_ns: int) -> None:
        """The status of whoever commands came."""
        self.enabled = enabled
        if counter != self.counter:
            self.counter, self.alive_ns = counter, now_ns

    def passed(self, now_ns: int) -> Array:
        """Commands that may reach the valves at ``now_ns``, (4,)."""
        if not (self.enabled and self.fit.all()):
            # Whoever says that he does not command is heard at once, and there is nothing wrong with that.
            self.fault = 0 if self.fit.all() or not self.enabled else 2
            return np.zeros(len(AXES))
        if now_ns - min(*self.came_ns, self.alive_ns) > TIME_OUT_NS:
            self.fault = 3 if now_ns - self.late_ns <= TIME_OUT_NS else 1
            return np.zeros(len(AXES))
        self.fault = 0
        return self.asked.copy()


class LiveMachine:
    """The machine of ``recipe`` at rest, advanced a cycle of its controller at a time."""

    def __init__(self, recipe: BenchRecipe, seed: int = 0) -> None:
        self.recipe = recipe
        self._sensing, moving = (np.random.default_rng([recipe.seed, seed, part]) for part in range(2))
        self.step = recipe.step
        self.steps = round(1.0 / (recipe.step * recipe.controller.rate))
        self._built: Built = built_of(recipe)
        axes = [recipe.axis(name) for name in AXES]
        in_play = self._built.plays * moving.uniform(-0.5, 0.5, len(axes))
        self._motion: BenchState = parked(self._built, np.array([axis.park for axis in axes]), in_play)
        length = round(_FLUCTUATION / recipe.step)
        self._fluctuation = np.stack(
            [np.resize(flow_fluctuation(axis.valve, length, recipe.step, moving), length) for axis in axes]
        )
        longest = max(valve.delay for valve in self._built.valves)
        #: Commands of the past that are still on their way, then those of the cycle to come, one column a step.
        self._commands = np.zeros((len(axes), int(np.ceil(longest / recipe.step)) + 2 + self.steps))
        self._done = 0

    def advance(self, commands: Array) -> None:
        """Advance by a cycle under the commands of each of its steps, (steps, 4)."""
        self._commands[:, : -self.steps] = self._commands[:, self.steps :].copy()
        self._commands[:, -self.steps :] = commands.T
        _advance(self._built, self._motion, self._commands, self._fluctuation, self._done, self.steps, self.step)
        self._done += self.steps

    @property
    def seconds(self) -> float:
        return self._done * self.step

    @property
    def truth(self) -> Array:
        """Drives (4,), joints (4,), boom tip (3,) and tool (3,), free of noise: (14,)."""
        moving = self._motion
        return np.concatenate([moving.position, moving.joint, moving.pivot, moving.tool])

    def readings(self) -> dict[str, float]:
        """What the sensors show, by canonical signal; also those that are there for commissioning alone."""
        recipe, moving = self.recipe, self._motion
        columns = [AXES.index(name) for name in WIRED]
        wires = read_wires(moving.position[columns], recipe.draw_wire, self._sensing)
        turned = moving.position if recipe.slew_sensor.mount == "drive" else moving.joint
        shown = {"slew.joint": read_slew(turned[:1], recipe.slew_sensor, self._sensing)}
        for k, name in enumerate(WIRED):
            shown[f"{name}.{'cylinder' if recipe.axis(name).cylinder is not None else 'joint'}"] = wires[k : k + 1]
        found = {name: float(through(values, recipe.sensor(name))[0]) for name, values in shown.items()}
        for name in ("boom", "stick"):
            noise = INCLINOMETER_NOISE * self._sensing.standard_normal()
            found[f"{name}.joint"] = float(moving.joint[AXES.index(name)] + noise)
        for k, name in enumerate("xyz"):
            found[f"ee.{name}"] = float(moving.pivot[k] + TRACKER_NOISE * self._sensing.standard_normal())
        return found


@compiled
def _advance(built: Built, motion: BenchState, commands: Array, fluctuation: Array, done: int, steps: int, step: float) -> None:
    """``steps`` steps; the last ``steps`` columns of ``commands`` are those of these steps."""
    n = len(motion.position)
    past = commands.shape[1] - steps
    disturbance = np.zeros(n)
    for k in range(steps):
        for i in range(n):
            motion.received[i] = delayed(commands[i], step, (past + k) * step, step, built.valves[i].delay)
            disturbance[i] = fluctuation[i, (done + k) % fluctuation.shape[1]]
        advance_machine(built, motion, disturbance, (done + k) * step, step)
