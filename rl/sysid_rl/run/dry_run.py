"""A dry run: the same recipe on the simulated machine, and its range of motion."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid_rl.run.assemble import Assembly
from sysid_rl.run.clock import SECOND
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.operator import Interruptible, Unattended
from sysid_rl.run.outcome import RunOutcome
from sysid_rl.run.simulated import SimulatedTransport

Array = npt.NDArray[np.float64]


class RangeRecorder:
    """A recorder of the range of motion and of the tracking error.

    The tracking error is the end effector by sensors and forward model, with the errors of both, minus its target at the time
    of the measurement. The true error needs an external measurement.

    Args:
        axes: number of axes.
        period_ns: of a cycle: a target is for its end.
    """

    fault = ""

    def __init__(self, axes: int, period_ns: int) -> None:
        self.joints = np.full((2, axes), [[np.inf], [-np.inf]])
        self.ee = np.full((2, 3), [[np.inf], [-np.inf]])
        self.commands = np.zeros(axes)
        self.moving = 0
        self.phases: dict[str, int] = {}
        self._period_ns = period_ns
        self._targets: deque[tuple[int, Array]] = deque(maxlen=64)
        #: Cycles in which the tracking error is known.
        self.tracked = 0
        #: Second since the first cycle → largest distance from the target in it [m].
        self.by_second: dict[int, float] = {}
        self._begin_ns = 0
        self._squares, self._worst = np.zeros(3), np.zeros(3)
        self._distance_sum, self._distance_max = 0.0, 0.0

    def record(self, cycle: Cycle) -> None:
        self._begin_ns = self._begin_ns or cycle.at_ns
        if not cycle.enabled:
            self._targets.clear()
            return
        self.moving += 1
        for bounds, values in ((self.joints, cycle.joints), (self.ee, cycle.ee)):
            np.fmin(bounds[0], values, out=bounds[0])
            np.fmax(bounds[1], values, out=bounds[1])
        np.fmax(self.commands, np.abs(cycle.commands), out=self.commands)
        phase = cycle.source.split()[0]
        self.phases[phase] = self.phases.get(phase, 0) + 1
        if (target := self._target(cycle)) is not None:
            error = cycle.ee - target
            far = float(np.linalg.norm(error))
            self._squares += error**2
            np.fmax(self._worst, np.abs(error), out=self._worst)
            self._distance_sum, self._distance_max = self._distance_sum + far, max(self._distance_max, far)
            self.tracked += 1
            second = (cycle.at_ns - self._begin_ns) // SECOND
            self.by_second[second] = max(self.by_second.get(second, 0.0), far)
        if np.isfinite(cycle.target).all():
            self._targets.append((cycle.at_ns + self._period_ns, cycle.target))
        else:
            self._targets.clear()

    def _target(self, cycle: Cycle) -> Array | None:
        """The target (3,) at the time of the measurement; None if unknown."""
        if not cycle.readings or not np.isfinite(cycle.ee).all():
            return None
        measured = float(np.median([reading.measured_ns for reading in cycle.readings.values()]))
        times = [at for at, _ in self._targets]
        if not times or not times[0] <= measured <= times[-1]:
            return None
        return np.array([np.interp(measured, times, column) for column in np.array([at for _, at in self._targets]).T])

    @property
    def rmse(self) -> Array | None:
        """RMSE of the tracking error per coordinate, (3,) [m]; None without tracking."""
        return np.sqrt(self._squares / self.tracked) if self.tracked else None

    @property
    def worst(self) -> Array:
        """Greatest tracking error per coordinate, (3,) [m]."""
        return self._worst.copy()

    @property
    def distance(self) -> dict[str, float]:
        """Mean, RMSE and maximum of the Euclidean norm of the tracking error [m]; empty without tracking."""
        if not self.tracked:
            return {}
        rmse = float(np.sqrt(self._squares.sum() / self.tracked))
        return {"mean": self._distance_sum / self.tracked, "rmse": rmse, "max": self._distance_max}


@dataclass(frozen=True)
class DryRun:
    """The result of a dry run."""

    outcome: RunOutcome
    ranges: RangeRecorder
    seconds: float


def run_dry(assembly: Assembly, seconds: float = 60.0) -> DryRun:
    """Run a recipe on its plant for at most ``seconds`` of simulated time; nothing is opened."""
    recipe = assembly.recipe
    loop_settings = replace(recipe.loop, seconds=min(seconds, recipe.loop.seconds or seconds), priority=0, lock_memory=False)
    machine = SimulatedTransport(assembly.loaded.plant, assembly.middle)
    ranges = RangeRecorder(len(assembly.machine.axes), round(SECOND * assembly.dt))
    plain = replace(assembly, recipe=replace(recipe, loop=loop_settings))
    with Interruptible(Unattended(machine)) as operator:
        loop = plain.loop(machine, ranges, operator)
        outcome = loop.run(getattr(loop.mode, "watch", None))
    return DryRun(outcome, ranges, machine.now_ns() / 1e9)
