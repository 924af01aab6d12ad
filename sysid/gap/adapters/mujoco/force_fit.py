"""Values of effects of force axes, fitted once more to MuJoCo's free run.

The search compares forces at measured motion, where the acceleration is a second derivative of a noisy position; a free run
needs no derivative. Values are refined by least squares between the ends of their 95 % intervals, so that the model and the
result say the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.errors import InputError
from sysid.gap.adapters.mujoco.free_run import Differences, StartFit, Stretch
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.adapters.simulator import rows_of
from sysid.gap.result import WrittenEffect

Array = npt.NDArray[np.float64]

#: Longest part of a stretch that is fitted, and of all stretches [s]: a run integrates noise of its commands, and takes time.
STRETCH_S, TOTAL_S = 10.0, 60.0
#: Step of a derivative by a value, as a share of its interval.
VALUE_STEP = 1e-3
#: Most iterations, and the share of the squared error by which the last one lowers it.
ITERATIONS, LAST = 20, 1e-4


def fitted_to_run(
    rows: Sequence[WrittenEffect],
    stretches: Sequence[Stretch],
    noise: Mapping[str, float],
    opened: Callable[[Sequence[WrittenEffect]], tuple[MujocoSimulator, Mapping[str, float]]],
) -> Sequence[WrittenEffect]:
    """The effects with the values that fit the free run best; as they are where it diverges, or nothing can be fitted.

    Values of adjusted effects, which hold together only, and values without an interval stay.

    Args:
        stretches: of the fit recordings.
        noise: joint signal → standard deviation of its sensor.
        opened: the model with some effects, and its force constants relative to the recorded commands, by axis.
    """
    fit = ValueFit(rows, _first_parts(stretches), noise, opened)
    if not fit.places or not fit.parts or not np.all(fit.high > fit.low):
        return rows
    start = np.clip([float(np.asarray(rows[k].parameters[name])) for k, name in fit.places], fit.low, fit.high)
    try:
        found = least_squares(
            fit.residuals, start, fit.jacobian, (fit.low, fit.high), x_scale=fit.high - fit.low, ftol=LAST, max_nfev=ITERATIONS
        )
    except InputError:
        return rows
    return fit.with_values(found.x)


def _first_parts(stretches: Sequence[Stretch]) -> list[Stretch]:
    """The beginning of each stretch, of as many as :data:`TOTAL_S` allows."""
    found, left = list[Stretch](), TOTAL_S
    for stretch in stretches:
        rate = stretch.recording.rate_hz
        count = min(len(stretch.recording), round(min(STRETCH_S, left) * rate))
        if count < 2:
            break
        left -= count / rate
        commands = {signal: values[:count] for signal, values in stretch.commands.items()}
        found.append(Stretch(rows_of(stretch.recording, 0, count), commands))
    return found


class ValueFit:
    """Residuals of the free run over the values that are fitted, without what other starts explain."""

    def __init__(
        self,
        rows: Sequence[WrittenEffect],
        parts: Sequence[Stretch],
        noise: Mapping[str, float],
        opened: Callable[[Sequence[WrittenEffect]], tuple[MujocoSimulator, Mapping[str, float]]],
    ) -> None:
        self.rows, self.parts, self.noise, self.opened = rows, parts, noise, opened
        self.places = [
            (k, name)
            for k, row in enumerate(rows)
            if row.kind != "adjusted"
            for name in row.interval95
            if np.ndim(row.parameters[name]) == 0
        ]
        self.low, self.high = (np.array([rows[k].interval95[name][end] for k, name in self.places]) for end in (0, 1))
        self._at, self._fits = np.empty(0), list[StartFit]()

    def with_values(self, values: Array) -> Sequence[WrittenEffect]:
        found = list(self.rows)
        for (k, name), value in zip(self.places, values, strict=True):
            found[k] = replace(found[k], parameters={**found[k].parameters, name: float(value)})
        return found

    def residuals(self, values: Array) -> Array:
        """(m,); infinite where the run diverges.

        Raises:
            InputError: it diverges at the first values.
        """
        starts = [fit.starts for fit in self._fits] if self._fits else [None] * len(self.parts)
        try:
            runs = self._runs(values)
            found = [runs.from_best_start(part, start) for part, start in zip(self.parts, starts, strict=True)]
        except InputError:
            if not self._fits:
                raise
            return np.full(sum(len(fit.own) for fit in self._fits), np.inf)
        self._at, self._fits = values.copy(), found
        return np.concatenate([fit.left for fit in found])

    def jacobian(self, values: Array) -> Array:
        """(m, values), with the directions of other starts held.

        Raises:
            InputError: a run diverges.
        """
        if not np.array_equal(self._at, values):
            self.residuals(values)
        columns = []
        for k, step in enumerate(VALUE_STEP * (self.high - self.low)):
            moved = values.copy()
            moved[k] += step if values[k] + step < self.high[k] else -step
            runs, parts = self._runs(moved), list[Array]()
            for part, fit in zip(self.parts, self._fits, strict=True):
                change = (runs.of(part, fit.starts[None])[0] - fit.own) / (moved[k] - values[k])
                parts.append(change - fit.directions @ (fit.directions.T @ change))
            columns.append(np.concatenate(parts))
        return np.column_stack(columns)

    def _runs(self, values: Array) -> Differences:
        return Differences(*self.opened(self.with_values(values)), self.noise)
