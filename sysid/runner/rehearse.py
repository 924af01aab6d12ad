"""A dry run: the same recipe on the simulated machine, and where it would go."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.runner.assemble import Assembly
from sysid.runner.cycle import Cycle
from sysid.runner.operator import Unattended
from sysid.runner.outcome import Outcome
from sysid.runner.simulated import SimulatedTransport

Array = npt.NDArray[np.float64]


class Ranges:
    """A recorder that keeps nothing but how far everything went while the machine moved, and how well it followed."""

    fault = ""

    def __init__(self, axes: int) -> None:
        self.joints = np.full((2, axes), [[np.inf], [-np.inf]])
        self.ee = np.full((2, 3), [[np.inf], [-np.inf]])
        self.commands = np.zeros(axes)
        self.moving = 0
        self.phases: dict[str, int] = {}
        self._target = np.full(3, np.nan)
        self._squares, self._worst, self._count = np.zeros(3), np.zeros(3), 0

    def record(self, cycle: Cycle) -> None:
        if not cycle.enabled:
            self._target = np.full(3, np.nan)
            return
        self.moving += 1
        for bounds, values in ((self.joints, cycle.joints), (self.ee, cycle.ee)):
            np.fmin(bounds[0], values, out=bounds[0])
            np.fmax(bounds[1], values, out=bounds[1])
        np.fmax(self.commands, np.abs(cycle.commands), out=self.commands)
        phase = cycle.source.split()[0]
        self.phases[phase] = self.phases.get(phase, 0) + 1
        if np.isfinite(self._target).all():  # the target of a turn is for the next one
            error = cycle.ee - self._target
            self._squares += error**2
            np.fmax(self._worst, np.abs(error), out=self._worst)
            self._count += 1
        self._target = cycle.target

    @property
    def rmse(self) -> Array | None:
        """End effector against target per coordinate, (3,) [m]; None where nothing was tracked."""
        return np.sqrt(self._squares / self._count) if self._count else None

    @property
    def worst(self) -> Array:
        """(3,) [m]."""
        return self._worst.copy()


@dataclass(frozen=True)
class Rehearsal:
    """What a dry run found."""

    outcome: Outcome
    ranges: Ranges
    seconds: float


def rehearse(assembly: Assembly, seconds: float = 60.0) -> Rehearsal:
    """Run a recipe on the plant that its controller knows, for at most ``seconds`` of simulated time; nothing is opened."""
    recipe = assembly.recipe
    loop_settings = replace(recipe.loop, seconds=min(seconds, recipe.loop.seconds or seconds), priority=0, lock_memory=False)
    machine = SimulatedTransport(assembly.loaded.plant, assembly.middle)
    ranges = Ranges(len(assembly.machine.axes))
    plain = replace(assembly, recipe=replace(recipe, loop=loop_settings))
    loop = plain.loop(machine, ranges, Unattended(machine))
    outcome = loop.run(getattr(loop.mode, "watch", None))
    return Rehearsal(outcome, ranges, machine.now_ns() / 1e9)
