"""Free run of a force-driven model: MuJoCo integrates the recorded commands, from measured positions and speeds.

A small constant error of a torque is within the noise of the forces and moves the joints all the same, because the run
integrates it. The error of the free run therefore decides about parameters that the forces hardly determine. The measured start
of a run is uncertain, which a run integrates as well: position and speed of every joint at the first row of each stretch are
estimated (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.adapters.adapter import stretches_of
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.adapters.simulator import command_signals, rows_of
from sysid.plant import Plant, compile_plant
from sysid.plant.stretches import held
from sysid.signals import axis_signal, split_signal

Array = npt.NDArray[np.float64]

#: Step of a start for a derivative [standard deviations of the sensor], and the time in which the step of a speed moves a joint
#: by it [s].
START_STEP, SPEED_S = 10.0, 0.1
#: Most iterations of a start, the share of the squared differences by which the last one lowers them, and the least change of
#: the differences by a start as a share of the largest.
ITERATIONS, LAST, NOTHING = 8, 1e-3, 1e-9


@dataclass(frozen=True)
class Stretch:
    """Rows of a recording with commands of all axes.

    Args:
        recording: of these rows alone.
        commands: ``<axis>.command`` → (n,), without NaN, in the units of the recording.
    """

    recording: Recording
    commands: Mapping[str, Array]

    def run(self, simulator: MujocoSimulator, constants: Mapping[str, float], starts: Array) -> Mapping[str, Array]:
        """Joint signal → (lanes, n) of the free run.

        Args:
            constants: axis → force constant of the model relative to the recorded commands; 1 where it is absent.
            starts: as of :meth:`MujocoSimulator.simulate_many`.

        Raises:
            InputError: the run diverges.
        """
        commands = {
            signal: np.tile(values / constants.get(split_signal(signal)[0], 1.0), (len(starts), 1))
            for signal, values in self.commands.items()
        }
        signals = simulator.simulate_many(self.recording, commands, starts)
        return {signal: signals[signal] for signal in (axis_signal(name, "joint") for name in simulator.machine.axis_names)}


def stretches_to_run(plant: Plant, recordings: Sequence[Recording]) -> list[Stretch]:
    """The stretches between gaps in the commands; none of recordings without commands of all axes."""
    machine, model, found = plant.machine, compile_plant(plant), list[Stretch]()
    for recording in recordings:
        names = command_signals(recording, machine)
        if len(names) < len(machine.axes):
            continue
        filled = {name: held(recording.values(name), recording.rate_hz)[0] for name in names}
        for first, last in stretches_of(model, recording):
            part = {name: values[first:last] for name, values in filled.items()}
            found.append(Stretch(rows_of(recording, int(first), int(last)), part))
    return found


@dataclass(frozen=True)
class Differences:
    """Differences between free runs of a model and the measured joints, in standard deviations of their sensors.

    Args:
        constants: axis → force constant of the model relative to the recorded commands; 1 where it is absent.
        noise: joint signal → standard deviation of its sensor.
    """

    simulator: MujocoSimulator
    constants: Mapping[str, float]
    noise: Mapping[str, float]

    def rms(self, stretches: Sequence[Stretch]) -> float:
        """Root mean square over all samples, from the starts that fit best; NaN without stretches.

        Raises:
            InputError: a run diverges.
        """
        left = [self.from_best_start(stretch).left for stretch in stretches]
        return float(np.sqrt(np.mean(np.concatenate(left) ** 2))) if left else np.nan

    def of(self, stretch: Stretch, starts: Array) -> Array:
        """(lanes, m) of the measured samples of all joints, for ``starts`` (lanes, axes, 2)."""
        runs = stretch.run(self.simulator, self.constants, starts)
        parts = []
        for signal, lanes in runs.items():
            measured = stretch.recording.values(signal)
            there = ~np.isnan(measured)
            parts.append((lanes[:, there] - measured[there]) / self.noise[signal])
        return np.concatenate(parts, axis=1)

    def from_best_start(self, stretch: Stretch, starts: Array | None = None) -> StartFit:
        """The differences from the positions and speeds at the first row that fit best, searched from ``starts`` (axes, 2).

        Raises:
            InputError: a run diverges.
        """
        count = len(self.simulator.machine.axes)
        here, sizes = np.zeros((count, 2)) if starts is None else starts, np.empty((count, 2))
        for k, name in enumerate(self.simulator.machine.axis_names):
            sizes[k] = START_STEP * self.noise[axis_signal(name, "joint")] * np.array([1.0, 1.0 / SPEED_S])
        steps = np.concatenate([np.zeros((1, 2 * count)), np.diag(sizes.ravel())]).reshape(-1, count, 2)
        for _ in range(ITERATIONS):
            own, *moved = self.of(stretch, here + steps)
            directions, values, mix = np.linalg.svd(np.column_stack(moved) - own[:, None], full_matrices=False)
            known = values > NOTHING * values[0]
            part = directions[:, known].T @ own
            fit = StartFit(own - directions[:, known] @ part, here, own, directions[:, known])
            if part @ part <= LAST * (own @ own):
                break
            here = here - (mix[known].T @ (part / values[known])).reshape(count, 2) * sizes
        return fit


@dataclass(frozen=True)
class StartFit:
    """Differences of a stretch near the start that fits best.

    Args:
        left: (m,) without what a further change of the start explains; ``own`` (m,) with it.
        starts: (axes, 2) from the measured start.
        directions: (m, k) orthonormal, in which other starts change the differences.
    """

    left: Array
    starts: Array
    own: Array
    directions: Array
