"""Free run of a force-driven model: MuJoCo integrates the recorded commands, from measured positions and speeds.

A small constant error of a torque is within the noise of the forces and moves the joints all the same, because the run
integrates it. The error of the free run therefore decides about parameters that the forces hardly determine. The measured start
of a run is uncertain, which a run integrates as well: position and speed of every joint at the first row of each stretch are
estimated (variable projection, Golub and Pereyra 1973).

Values of named effects are fitted once more to it. The search compares forces at measured motion, where the acceleration is a
second derivative of a noisy position; a free run needs no derivative. Values are refined by least squares between the ends of
their 95 % intervals, so that the model and the result say the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.datasets.recording import Recording
from sysid.errors import InputError
from sysid.gap.adapters.adapter import stretches_of
from sysid.gap.adapters.mujoco.repair import with_values
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.adapters.simulator import command_signals, rows_of
from sysid.gap.result import WrittenEffect
from sysid.plant import Plant, compile_plant
from sysid.plant.stretches import held
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Step of a start for a derivative [standard deviations of the sensor], and the time in which the step of a speed moves a joint
#: by it [s].
START_STEP, SPEED_S = 10.0, 0.1
#: Most iterations of a start, the share of the squared differences by which the last one lowers them, and the least change of
#: the differences by a start as a share of the largest.
START_ITERATIONS, START_LAST, NOTHING = 8, 1e-3, 1e-9
#: Longest part of a stretch to which values are fitted, and of all stretches [s]: a run integrates noise of its commands, and
#: takes time.
STRETCH_S, TOTAL_S = 10.0, 60.0
#: Step of a derivative by a value, as a share of its interval.
VALUE_STEP = 1e-3
#: Most iterations of the values, and the share of the squared error by which the last one lowers it.
ITERATIONS, LAST = 20, 1e-4


def stretches_to_run(plant: Plant, recordings: Sequence[Recording]) -> list[Recording]:
    """The stretches between gaps in the commands, held where they are missing; none without commands of all axes."""
    machine, model, found = plant.machine, compile_plant(plant), list[Recording]()
    for recording in recordings:
        names = command_signals(recording, machine)
        if len(names) < len(machine.axes):
            continue
        commands = {name: held(recording.values(name), recording.rate_hz)[0] for name in names}
        whole = replace(recording, table=recording.table.assign(**commands))
        found += [rows_of(whole, int(first), int(last)) for first, last in stretches_of(model, recording)]
    return found


@dataclass(frozen=True)
class Differences:
    """Differences between free runs of a model and the measured joints, in standard deviations of their sensors.

    Args:
        constants: axis → force constant of the model relative to the recorded commands; 1 where it is absent.
        noise: joint signal → standard deviation of its sensor.

    Raises:
        InputError: a run diverges.
    """

    simulator: MujocoSimulator
    constants: Mapping[str, float]
    noise: Mapping[str, float]

    def rms(self, stretches: Sequence[Recording]) -> float:
        """Root mean square over all samples, from the starts that fit best; NaN without stretches."""
        left = [self.from_best_start(stretch).left for stretch in stretches]
        return float(np.sqrt(np.mean(np.concatenate(left) ** 2))) if left else np.nan

    def of(self, stretch: Recording, starts: Array) -> Array:
        """(lanes, m) of the measured samples of all joints, for ``starts`` as of :meth:`MujocoSimulator.simulate_many`."""
        axes, commands, parts = self.simulator.machine.axis_names, dict[str, Array](), list[Array]()
        for name in axes:
            values = stretch.values(axis_signal(name, "command")) / self.constants.get(name, 1.0)
            commands[axis_signal(name, "command")] = np.tile(values, (len(starts), 1))
        runs = self.simulator.simulate_many(stretch, commands, starts)
        for signal in (axis_signal(name, "joint") for name in axes):
            measured = stretch.values(signal)
            there = ~np.isnan(measured)
            parts.append((runs[signal][:, there] - measured[there]) / self.noise[signal])
        return np.concatenate(parts, axis=1)

    def from_best_start(self, stretch: Recording, starts: Array | None = None) -> StartFit:
        """The differences from the positions and speeds at the first row that fit best, searched from ``starts`` (axes, 2)."""
        count = len(self.simulator.machine.axes)
        here, sizes = np.zeros((count, 2)) if starts is None else starts, np.empty((count, 2))
        for k, name in enumerate(self.simulator.machine.axis_names):
            sizes[k] = START_STEP * self.noise[axis_signal(name, "joint")] * np.array([1.0, 1.0 / SPEED_S])
        steps = np.concatenate([np.zeros((1, 2 * count)), np.diag(sizes.ravel())]).reshape(-1, count, 2)
        for _ in range(START_ITERATIONS):
            own, *moved = self.of(stretch, here + steps)
            directions, values, mix = np.linalg.svd(np.column_stack(moved) - own[:, None], full_matrices=False)
            known = values > NOTHING * values[0]
            part = directions[:, known].T @ own
            fit = StartFit(own - directions[:, known] @ part, here, own, directions[:, known])
            if part @ part <= START_LAST * (own @ own):
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


def fitted_to_run(
    rows: Sequence[WrittenEffect],
    stretches: Sequence[Recording],
    opened: Callable[[Sequence[WrittenEffect]], Differences],
) -> Sequence[WrittenEffect]:
    """The effects with the values that fit the free run best; as they are where it diverges, or nothing can be fitted.

    Values of adjusted effects, which hold together only, and values without an interval stay.

    Args:
        stretches: of the fit recordings.
        opened: free runs of the model with some effects.
    """
    fit = _ValueFit(rows, _first_parts(stretches), opened)
    if not fit.places or not fit.parts or not np.all(fit.high > fit.low):
        return rows
    start = np.clip([float(np.asarray(rows[k].parameters[name])) for k, name in fit.places], fit.low, fit.high)
    try:
        found = least_squares(
            fit.residuals, start, fit.jacobian, (fit.low, fit.high), x_scale=fit.high - fit.low, ftol=LAST, max_nfev=ITERATIONS
        )
    except InputError:
        return rows
    return with_values(rows, fit.places, found.x)


def _first_parts(stretches: Sequence[Recording]) -> list[Recording]:
    """The beginning of each stretch, of as many as :data:`TOTAL_S` allows."""
    found, left = list[Recording](), TOTAL_S
    for stretch in stretches:
        count = min(len(stretch), round(min(STRETCH_S, left) * stretch.rate_hz))
        if count < 2:
            break
        left -= count / stretch.rate_hz
        found.append(rows_of(stretch, 0, count))
    return found


class _ValueFit:
    """Residuals of the free run over the values that are fitted, without what other starts explain."""

    def __init__(
        self,
        rows: Sequence[WrittenEffect],
        parts: Sequence[Recording],
        opened: Callable[[Sequence[WrittenEffect]], Differences],
    ) -> None:
        self.rows, self.parts, self.opened = rows, parts, opened
        self.places = [
            (k, name)
            for k, row in enumerate(rows)
            if row.kind != "adjusted"
            for name in row.interval95
            if np.ndim(row.parameters[name]) == 0
        ]
        self.low, self.high = (np.array([rows[k].interval95[name][end] for k, name in self.places]) for end in (0, 1))
        self._at, self._fits = np.empty(0), list[StartFit]()

    def residuals(self, values: Array) -> Array:
        """(m,); infinite where the run diverges; an error where it does so at the first values."""
        starts = [fit.starts for fit in self._fits] if self._fits else [None] * len(self.parts)
        try:
            runs = self.opened(with_values(self.rows, self.places, values))
            found = [runs.from_best_start(part, start) for part, start in zip(self.parts, starts, strict=True)]
        except InputError:
            if not self._fits:
                raise
            return np.full(sum(len(fit.own) for fit in self._fits), np.inf)
        self._at, self._fits = values.copy(), found
        return np.concatenate([fit.left for fit in found])

    def jacobian(self, values: Array) -> Array:
        """(m, values), with the directions of other starts held."""
        if not np.array_equal(self._at, values):
            self.residuals(values)
        columns = []
        for k, step in enumerate(VALUE_STEP * (self.high - self.low)):
            moved = values.copy()
            moved[k] += step if values[k] + step < self.high[k] else -step
            runs, parts = self.opened(with_values(self.rows, self.places, moved)), list[Array]()
            for part, fit in zip(self.parts, self._fits, strict=True):
                change = (runs.of(part, fit.starts[None])[0] - fit.own) / (moved[k] - values[k])
                parts.append(change - fit.directions @ (fit.directions.T @ change))
            columns.append(np.concatenate(parts))
        return np.column_stack(columns)
