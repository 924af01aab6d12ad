"""Maps of the error of a stage over command, speed, position, load, time and other motion; no effect is needed for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.map_variables import MapVariable, Units, joined, variables_of
from sysid.gap.problem import Problem
from sysid.gap.result import Map
from sysid.machine import Machine
from sysid.signals import split_signal
from sysid.validate.binning import SPEED_WINDOW, edges_of, explained, per_second, places_in, speed_of

Array = npt.NDArray[np.float64]

#: Least number of rows of a bin.
MIN_ROWS = 10
#: Median absolute deviation of a normal distribution → its standard deviation.
ROBUST = 1.4826


def maps_of(
    problem: Problem,
    theta: Array,
    recordings: Sequence[Recording],
    sigma: Array,
    machine: Machine,
    units: Mapping[str, str],
    repaired: Array | None = None,
) -> tuple[Map, ...]:
    """Every map of every output of a stage, for each output in descending order of explained variance.

    The error is measured − simulated. A stage that integrates keeps an error of speed in its position; there speeds are
    compared (differences over :data:`SPEED_WINDOW`), and positions over variables of the same axis only.

    Args:
        theta: (N,) parameters of the simulation under test; ``repaired``: of the repaired one.
        recordings: at least one; static poses have no speed, command or time.
        sigma: noise floor of each output (d,).
        units: SI units of signals, where the description of the machine leaves them open.
    """
    known = Units(machine, units)
    parts = [_errors(problem, theta, repaired, r) for r in recordings]
    variables = joined([variables_of(problem, r, known) for r in recordings], [len(part.error) for part in parts])
    found: list[Map] = []
    for k, signal in enumerate(problem.signals):
        unit = known.of(signal)
        views = [_View("error", unit, float(sigma[k]), *_stacked(parts, k, _PLAIN))]
        if problem.integrates:
            floor = float(sigma[k]) * float(np.sqrt(2.0)) / SPEED_WINDOW
            views.append(_View("speed error", per_second(unit), floor, *_stacked(parts, k, _SPEED)))
        of_signal = [
            item
            for view in views
            for over, variable in variables.items()
            if not (problem.integrates and view.quantity == "error" and not _own(over, problem.target))
            if (item := _map(problem, signal, over, variable, view)) is not None
        ]
        found += sorted(of_signal, key=lambda item: -item.explains)
    return tuple(found)


def _own(over: str, target: str) -> bool:
    """Whether a variable belongs to the axis itself."""
    return over == "time" or split_signal(over)[0] == target or over.endswith(f" of {target}")


def _map(problem: Problem, signal: str, over: str, variable: MapVariable, view: _View) -> Map | None:
    """One map; None where the variable does not vary."""
    there = np.isfinite(view.error) & np.isfinite(variable.values)
    if there.sum() < 2 * MIN_ROWS:
        return None
    x, e = variable.values[there], view.error[there]
    edges = edges_of(x, variable.kind)
    if edges is None:
        return None
    place = places_in(edges, x)
    count = np.bincount(place, minlength=len(edges) - 1)
    kept = np.flatnonzero(count >= MIN_ROWS)
    if len(kept) < 2:
        return None
    order = np.argsort(place, kind="stable")
    rows = np.split(order, np.cumsum(count)[:-1])

    def means(values: Array) -> tuple[float, ...]:
        here = values[there]
        return _rounded(np.array([np.mean(here[rows[b]]) for b in kept])) if np.isfinite(here).any() else ()

    return Map(
        problem.stage, problem.target, signal, over, variable.unit, view.quantity, view.unit, view.noise_floor,
        explained(e, place, count),
        _rounded(np.array([np.median(x[rows[b]]) for b in kept])),
        tuple(map(int, count[kept])),
        means(view.error),
        _rounded(np.array([ROBUST * np.median(np.abs(e[rows[b]] - np.median(e[rows[b]]))) for b in kept])),
        means(view.after),
        means(view.measured),
        means(view.simulated),
    )  # fmt: skip


def _rounded(values: Array) -> tuple[float, ...]:
    """Rounded to six digits, which keeps a result with a hundred maps small."""
    return tuple(float(f"{value:.6g}") for value in values)


# -- errors --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """Errors of one recording, (n, d) each, before and after the repair; speeds where the stage integrates, else NaN."""

    error: Array
    after: Array
    speed_error: Array
    speed_after: Array
    measured_speed: Array
    simulated_speed: Array
    nothing: Array


@dataclass(frozen=True)
class _View:
    """Error of a signal, or of its speed, (n,) over all recordings."""

    quantity: str
    unit: str
    noise_floor: float
    error: Array
    after: Array
    measured: Array
    simulated: Array


_PLAIN = ("error", "after", "nothing", "nothing")
_SPEED = ("speed_error", "speed_after", "measured_speed", "simulated_speed")


def _stacked(parts: Sequence[_Part], k: int, names: Sequence[str]) -> list[Array]:
    return [np.concatenate([getattr(part, name)[:, k] for part in parts]) for name in names]


def _errors(problem: Problem, theta: Array, repaired: Array | None, recording: Recording) -> _Part:
    lanes = theta[None] if repaired is None else np.vstack([theta, repaired])
    measured, predicted = problem.measured(recording), problem.predict(lanes, recording)
    nothing = np.full(measured.shape, np.nan)
    error, after = measured - predicted[0], measured - predicted[1] if repaired is not None else nothing
    if not problem.integrates:
        return _Part(error, after, *[nothing] * 5)
    rate_hz = problem.rate(recording)
    faster = [speed_of(values, rate_hz) for values in (error, after, measured, predicted[0])]
    return _Part(error, after, faster[0], faster[1], faster[2], faster[3], nothing)
