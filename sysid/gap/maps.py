"""Maps of the error of a stage over command, speed, position, load, time and other motion; no effect is needed for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.gap.result import Map
from sysid.machine import Machine
from sysid.plant import gravity_load
from sysid.signals import axis_signal, point_signals, split_signal
from sysid.validate.binning import SPEED_WINDOW, Cut, direction_of, edges_of, explained, per_second, places_in, speed_of

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
    variables = joined([variables_of(problem, r, known) for r in recordings], [len(part[0][0]) for part in parts])
    found: list[Map] = []
    for k, signal in enumerate(problem.signals):
        unit = known.of(signal)
        floor = float(sigma[k]) * float(np.sqrt(2.0)) / SPEED_WINDOW
        kinds = (("error", unit, float(sigma[k])), ("speed error", per_second(unit), floor))
        views = []
        for kind, of_kind in zip(kinds, zip(*parts, strict=True), strict=False):  # speeds where the stage integrates
            columns = [np.concatenate([values[:, k] for values in column]) for column in zip(*of_kind, strict=True)]
            views.append(_View(*kind, *columns))
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
class _View:
    """Error of a signal, or of its speed, (n,) over all recordings."""

    quantity: str
    unit: str
    noise_floor: float
    error: Array
    after: Array
    measured: Array
    simulated: Array


def _errors(problem: Problem, theta: Array, repaired: Array | None, recording: Recording) -> list[list[Array]]:
    """[error, error after the repair, measured, simulated], (n, d) each; where the stage integrates, the same of speeds."""
    lanes = theta[None] if repaired is None else np.vstack([theta, repaired])
    measured, predicted = problem.measured(recording), problem.predict(lanes, recording)
    nothing = np.full(measured.shape, np.nan)
    error, after = measured - predicted[0], measured - predicted[1] if repaired is not None else nothing
    if not problem.integrates:
        return [[error, after, nothing, nothing]]
    rate_hz = problem.rate(recording)
    speeds = [speed_of(values, rate_hz) for values in (error, after, measured, predicted[0])]
    return [[error, after, nothing, nothing], speeds]


# -- variables ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Units:
    """Units of the signals of a machine; ``given`` where the machine description leaves them open."""

    machine: Machine
    given: Mapping[str, str]

    def of(self, signal: str) -> str:
        return self.given.get(signal) or self.machine.expected_unit(signal) or "1"


@dataclass(frozen=True)
class MapVariable:
    """Variable of a map: values (n,), their unit, and how they are cut into bins."""

    values: Array
    unit: str
    kind: Cut = "range"


def joined(parts: Sequence[dict[str, MapVariable]], lengths: Sequence[int]) -> dict[str, MapVariable]:
    """The variables of all recordings, one after the other; NaN where a recording does not have one."""
    first: dict[str, MapVariable] = {}
    for part in parts:
        first = {**part, **first}
    return {
        name: MapVariable(
            np.concatenate(
                [part[name].values if name in part else np.full(n, np.nan) for part, n in zip(parts, lengths, strict=True)]
            ),
            about.unit,
            about.kind,
        )
        for name, about in first.items()
    }


def variables_of(problem: Problem, recording: Recording, known: Units) -> dict[str, MapVariable]:
    """Name → variable that the error of a stage may depend on, on its measured rows."""
    rows = problem.rows(recording)
    if problem.target in known.machine.axis_names:
        found = _of_axis(problem, recording, known)
    else:
        found = _of_point(problem, recording, known)
    if recording.kind == "motion":
        found["time"] = MapVariable(recording.values("time"), "s")
    return {name: MapVariable(v.values[rows], v.unit, v.kind) for name, v in found.items()}


def _of_axis(problem: Problem, recording: Recording, known: Units) -> dict[str, MapVariable]:
    axis = known.machine.axis(problem.target)
    found: dict[str, MapVariable] = {}
    position, unit = recording.values(axis.driven), known.of(axis.driven)
    found[axis.driven] = MapVariable(position, unit)
    if recording.kind == "motion":
        speed = speed_of(position, recording.rate_hz)
        found[f"speed of {axis.name}"] = MapVariable(speed, per_second(unit), "signed")
        found[f"direction of {axis.name}"] = MapVariable(direction_of(speed), "1", "sign")
        if problem.stage != "force":  # the force is the output there
            signal = axis_signal(axis.name, "command")
            found[signal] = MapVariable(recording.values(signal), known.of(signal), "signed")
        found |= _of_others(axis.name, recording, known)
    return found | _loads(recording, known, (axis.name,))


def _of_others(axis: str, recording: Recording, known: Units) -> dict[str, MapVariable]:
    """The commands of the other axes one by one, and together in shares of the largest of each."""
    found: dict[str, MapVariable] = {}
    total = np.zeros(len(recording))
    for other in known.machine.axes:
        signal = axis_signal(other.name, "command")
        command = recording.values(signal)
        largest = float(np.nanmax(np.abs(command), initial=0.0))
        if other.name != axis and largest > 0.0:
            found[signal] = MapVariable(command, known.of(signal), "signed")
            total += np.abs(command) / largest
    if len(found) > 1:
        found["other axes together"] = MapVariable(total, "1")
    return found


def _of_point(problem: Problem, recording: Recording, known: Units) -> dict[str, MapVariable]:
    """For the tip: every joint and load. For the tool: speed and acceleration of its pivot."""
    found: dict[str, MapVariable] = {}
    if problem.stage == "tool":
        for coordinate in point_signals("ee"):
            speed = speed_of(recording.values(coordinate), recording.rate_hz)
            found[f"speed of {coordinate}"] = MapVariable(speed, "m/s", "signed")
            found[f"acceleration of {coordinate}"] = MapVariable(speed_of(speed, recording.rate_hz), "m/s²", "signed")
        return found
    for axis in known.machine.axes:
        joint = axis_signal(axis.name, "joint")
        found[joint] = MapVariable(recording.values(joint), known.of(joint))
        if recording.kind == "motion":
            direction = direction_of(speed_of(recording.values(joint), recording.rate_hz))
            found[f"direction of {axis.name}"] = MapVariable(direction, "1", "sign")
    return found | _loads(recording, known, known.machine.axis_names)


def _loads(recording: Recording, known: Units, axes: Sequence[str]) -> dict[str, MapVariable]:
    """Gravity loads of axes that have one."""
    if known.machine.kinematics() is None:
        return {}
    loads = gravity_load(known.machine, recording)
    found = {}
    for name in axes:
        values = loads[:, known.machine.axis_names.index(name)]
        if np.any(values):
            joint_unit = known.of(axis_signal(name, "joint"))
            found[f"load of {name}"] = MapVariable(values, "N" if joint_unit == "m" else "N·m")
    return found
