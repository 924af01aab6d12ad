"""The plant fitted to a machine: the baseline, then one effect with all others unchanged."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares, minimize

from agreement.machines import MACHINES, STREAMS, description, recipe_of, record
from sysid.datasets import Recording
from sysid.effects import effect_named, form_for
from sysid.machine import KnownEffect
from sysid.plant import Plant, free_run, nominal_plant

Array = npt.NDArray[np.float64]


def errors(plant: Plant, recordings: Sequence[Recording], signals: Sequence[str]) -> Array:
    """Plant less machine over all samples of ``signals`` that both have."""
    parts = []
    for recording in recordings:
        run = free_run(plant, recording)
        for signal in signals:
            left = run[signal].to_numpy() - recording.values(signal)
            parts.append(left[~np.isnan(left)])
    return np.concatenate(parts)


def rmse(plant: Plant, recordings: Sequence[Recording], signals: Sequence[str]) -> float:
    """Root mean square; of points, over their coordinates together (their distance)."""
    left = errors(plant, recordings, signals)
    per_sample = len(signals) if signals[0].split(".")[0] in ("ee", "tool") else 1
    return float(np.sqrt(per_sample * np.mean(left**2)))


@dataclass(frozen=True)
class Unknown:
    """An effect to be fitted: where the search begins, in the order of its parameters."""

    name: str
    target: str
    guess: Mapping[str, float | tuple[float, ...]]
    side: Any = None

    @property
    def start(self) -> Array:
        return np.concatenate([np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in self.guess.values()])

    @property
    def bounds(self) -> Array:
        """(m, 2), from the catalogue."""
        form = form_for(effect_named(self.name), frozenset(self.guess), "row")
        by_name = {parameter.name: parameter for parameter in form.parameters}
        return np.array([by_name[key].bounds for key, value in self.guess.items() for _ in np.atleast_1d(value)])

    @property
    def stepwise(self) -> bool:
        form = form_for(effect_named(self.name), frozenset(self.guess), "row")
        return any(parameter.stepwise for parameter in form.parameters)

    def at(self, x: Array) -> KnownEffect:
        found: dict[str, float | list[float]] = {}
        place = 0
        for key, value in self.guess.items():
            size = np.size(value)
            found[key] = x[place : place + size].tolist() if isinstance(value, tuple) else float(x[place])
            place += size
        return KnownEffect(self.name, self.target, found, self.side)


#: Numbers to be fitted → points of the grid in each, and how far it reaches [factor].
GRID = {1: (41, 10.0), 2: (15, 5.0), 3: (7, 3.0)}
#: Points for an effect whose parameter must be met closely before it explains anything.
FINE = 601


def fit(plant: Plant, unknowns: Sequence[Unknown], recordings: Sequence[Recording], signals: Sequence[str]) -> Plant:
    """The plant whose ``unknowns`` fit ``recordings`` best, everything else as it is.

    Up to three numbers start from a grid around the guess. Then least squares, then a simplex without derivatives: dead-bands,
    backlash and quantisation have kinks.
    """
    guess = np.concatenate([unknown.start for unknown in unknowns])
    low, high = np.concatenate([unknown.bounds for unknown in unknowns]).T
    sizes = np.where(guess != 0.0, np.abs(guess), 0.01)

    def plant_at(x: Array) -> Plant:
        values, tried, place = np.clip(x * sizes, low, high), plant, 0
        for unknown in unknowns:
            tried = tried.with_effect(unknown.at(values[place : place + len(unknown.start)]))
            place += len(unknown.start)
        return tried

    def residuals(x: Array) -> Array:
        return errors(plant_at(x), recordings, signals)

    def cost(x: Array) -> float:
        return float(np.mean(residuals(x) ** 2))

    points, reach = GRID.get(len(guess), (1, 1.0))
    if any(unknown.stepwise for unknown in unknowns):
        points = points if len(guess) > 1 else FINE
    factors = np.geomspace(1.0 / reach, reach, points)
    repeat = len(guess) if points > 1 else 0
    grid = [np.array(row) * np.sign(guess) for row in itertools.product(factors, repeat=repeat)] if repeat else [guess / sizes]
    best = min(grid, key=cost)
    ends = (low / sizes, high / sizes)

    def settled(x: Array) -> Array:
        inside = np.clip(x, ends[0] + 1e-6, ends[1] - 1e-6)
        rough = least_squares(residuals, inside, bounds=ends, diff_step=1e-3, max_nfev=25)
        return np.asarray(least_squares(residuals, rough.x, bounds=ends, diff_step=1e-5, max_nfev=15).x)

    best = min((best, settled(best)), key=cost)
    names = [unknown.name for unknown in unknowns for _ in unknown.start]
    if {"input_delay", "first_order_lag"} <= set(names):
        # Delay and lag exchange, and every sample of delay has a minimum of its own: their sum is kept, each is tried.
        delay, lag = names.index("input_delay"), names.index("first_order_lag")
        both = best[delay] * sizes[delay] + best[lag] * sizes[lag]
        tries = [best.copy() for _ in np.arange(0.01, both, 0.01)]
        for k, x in enumerate(tries, start=1):
            x[delay], x[lag] = 0.01 * k / sizes[delay], (both - 0.01 * k) / sizes[lag]
        best = min((best, settled(min(tries, key=cost))), key=cost) if tries else best
    if len(guess) <= 3:
        away = 0.03 * np.maximum(np.abs(best), 0.1)
        corners = np.vstack([best, *(best + np.diag(away))])
        options = {"initial_simplex": corners, "maxfev": 50 * len(guess), "xatol": 1e-6, "fatol": 1e-30}
        best = min((best, minimize(cost, best, method="Nelder-Mead", options=options).x), key=cost)
    return plant_at(best)


#: Where the fit of a baseline begins.
FIRST_GUESS: dict[str, Mapping[str, float | tuple[float, ...]]] = {
    "gain_error": {"ratio": 1.0},
    "input_delay": {"delay": 0.03},
    "first_order_lag": {"time_constant": 0.04},
    "valve_deadband": {"positive": 0.12, "negative": 0.12},
    "viscous_friction": {"coefficient": 100.0},
    "asymmetric_gain": {"ratio": 1.0},
    "load_dependent_flow": {"coefficient": 0.003},
}


@cache
def baseline(machine_name: str, base: tuple[tuple[str, Any], ...], axes: tuple[str, ...], also: tuple[str, ...]) -> Plant:
    """The baseline: fit to steps and an operator's work on the machine without the feature."""
    machine = recipe_of(machine_name, dict(base))
    plant = nominal_plant(description(machine), streams=STREAMS)
    recordings = [record(machine, program, 101 + k, 60.0) for k, program in enumerate(("steps", "operator"))]
    for axis in axes:
        names = (*MACHINES[machine_name].baseline, *also)
        unknowns = [Unknown(name, axis, FIRST_GUESS[name]) for name in names]
        plant = fit(plant, unknowns, recordings, (plant.machine.axis(axis).driven,))
    return plant
