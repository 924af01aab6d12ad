"""The simulated test bench in real time: asynchronous commands, a watchdog, sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.recipe import AXES, WIRED, BenchRecipe
from simulated_bench.sensors import read_machine
from simulated_bench.stepping import BenchState, MachineNumbers, advance_machine, machine_numbers, parked
from simulated_bench.valve import delayed, flow_fluctuation

Array = npt.NDArray[np.float64]

#: Valves go neutral when commands are older than this [ns].
TIME_OUT_NS = 100_000_000
#: A command this much later than the state that it answers is rejected [ns].
LATE_NS = 60_000_000
#: A stamp may be ahead of the machine's clock by this, for rounding [ns].
AHEAD_NS = 5_000_000
#: Noise of the sensors for commissioning: inclinometers [rad], the tracked prism [m].
INCLINOMETER_NOISE, TRACKER_NOISE = 2e-4, 1e-4
#: Period after which the flow fluctuation repeats [s].
_FLUCTUATION_SECONDS = 120.0


@dataclass
class Watchdog:
    """Watchdog of the machine for received commands; times are of the machine's clock [ns].

    Every valve needs a valid command, and the sender a changing alive counter, at least every ``TIME_OUT_NS``. Where commands
    have the stamp of the state that they answer, late ones are rejected, and the others expire ``TIME_OUT_NS`` after that
    stamp. ``fault``: 0 none, 1 commands stopped, 2 the sender reports a failure, 3 commands were late.
    """

    commanded: Array = field(default_factory=lambda: np.zeros(len(AXES)))
    fit: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(len(AXES), dtype=bool))
    received_ns: list[int] = field(default_factory=lambda: [-TIME_OUT_NS] * len(AXES))
    enabled: bool = False
    counter: int = -1
    alive_ns: int = -TIME_OUT_NS
    fault: int = 0
    late_ns: int = -TIME_OUT_NS
    #: Number of late commands.
    refused: int = 0

    def command(self, axis: int, value: float, fit: bool, now_ns: int, age_ns: int = 0) -> None:
        """Take a valve command of ``axis`` that answers the state ``age_ns`` ago; the age of an invalid one is ignored."""
        if fit and not -AHEAD_NS <= age_ns <= LATE_NS:
            self.late_ns, self.refused = now_ns, self.refused + 1
            return
        self.commanded[axis], self.fit[axis], self.received_ns[axis] = value, fit, now_ns - max(0, age_ns)

    def alive(self, counter: int, enabled: bool, now_ns: int) -> None:
        """Take the status of the sender of commands."""
        self.enabled = enabled
        if counter != self.counter:
            self.counter, self.alive_ns = counter, now_ns

    def passed(self, now_ns: int) -> Array:
        """Commands that may reach the valves at ``now_ns``, (4,)."""
        if not (self.enabled and self.fit.all()):
            # A sender that disables itself acts at once and is no fault.
            self.fault = 0 if self.fit.all() or not self.enabled else 2
            return np.zeros(len(AXES))
        if now_ns - min(*self.received_ns, self.alive_ns) > TIME_OUT_NS:
            self.fault = 3 if now_ns - self.late_ns <= TIME_OUT_NS else 1
            return np.zeros(len(AXES))
        self.fault = 0
        return self.commanded.copy()


class LiveMachine:
    """The machine of ``recipe`` at rest, advanced a cycle of its controller at a time."""

    def __init__(self, recipe: BenchRecipe, seed: int = 0) -> None:
        self.recipe = recipe
        self._sensing, moving = (np.random.default_rng([recipe.seed, seed, part]) for part in range(2))
        self.step = recipe.step
        self.steps = round(1.0 / (recipe.step * recipe.controller.rate))
        self._numbers: MachineNumbers = machine_numbers(recipe)
        axes = [recipe.axis(name) for name in AXES]
        backlash_offset = self._numbers.plays * moving.uniform(-0.5, 0.5, len(axes))
        self._motion: BenchState = parked(self._numbers, np.array([axis.park for axis in axes]), backlash_offset)
        length = round(_FLUCTUATION_SECONDS / recipe.step)
        self._fluctuation = np.stack(
            [np.resize(flow_fluctuation(axis.valve, length, recipe.step, moving), length) for axis in axes]
        )
        longest = max(valve.delay for valve in self._numbers.valves)
        #: Past commands that are still delayed, then those of the next cycle, one column for each step.
        self._commands = np.zeros((len(axes), int(np.ceil(longest / recipe.step)) + 2 + self.steps))
        self._done = 0

    def advance(self, commands: Array) -> None:
        """Advance by a cycle under the commands of each of its steps, (steps, 4)."""
        self._commands[:, : -self.steps] = self._commands[:, self.steps :].copy()
        self._commands[:, -self.steps :] = commands.T
        _advance(self._numbers, self._motion, self._commands, self._fluctuation, self._done, self.steps, self.step)
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
        """Readings of all sensors, those for commissioning included, by canonical signal."""
        moving = self._motion
        wires, slew = read_machine(self.recipe, moving.position, moving.joint, self._sensing)
        found = {"slew.joint": float(slew)} | {
            self.recipe.drive_signal(name): float(length) for name, length in zip(WIRED, wires, strict=True)
        }
        for name in ("boom", "stick"):
            noise = INCLINOMETER_NOISE * self._sensing.standard_normal()
            found[f"{name}.joint"] = float(moving.joint[AXES.index(name)] + noise)
        for k, name in enumerate("xyz"):
            found[f"ee.{name}"] = float(moving.pivot[k] + TRACKER_NOISE * self._sensing.standard_normal())
        return found


@compiled
def _advance(
    numbers: MachineNumbers, motion: BenchState, commands: Array, fluctuation: Array, done: int, steps: int, step: float
) -> None:
    """``steps`` steps; the last ``steps`` columns of ``commands`` are those of these steps."""
    n = len(motion.position)
    past = commands.shape[1] - steps
    disturbance = np.zeros(n)
    for k in range(steps):
        for i in range(n):
            motion.received[i] = delayed(commands[i], step, (past + k) * step, step, numbers.valves[i].delay)
            disturbance[i] = fluctuation[i, (done + k) % fluctuation.shape[1]]
        advance_machine(numbers, motion, disturbance, (done + k) * step, step)
