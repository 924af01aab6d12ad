"""Breakdown of the error of a simulation, for which no effect is needed: by what it may depend on, and by stage.

Maps give the error of a stage over command, speed, position, load, time and other motion.

Shares give the contribution of each stage and axis to the error of a free run. Starting from measured signals, one stage after
the other is simulated, the last of the chain first. The prediction moves by dₖ each time, and Σ dₖ is the total error e. The
share of a stage is ⟨e·dₖ⟩ / ⟨e·e⟩. Shares add up to one; a negative share belongs to a stage whose error compensates for
another's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.gap.result import Map, Share
from sysid.machine import Machine
from sysid.plant import Model, free_run, gravity_load
from sysid.plant.model import measured_point
from sysid.signals import axis_signal, point_signals, split_signal
from sysid.validate.error_analysis import SPEED_WINDOW, Cut, direction_of, edges_of, explained, per_second, places_in, speed_of

Array = npt.NDArray[np.float64]
#: (stage, target) → change of the prediction (n, d) when that stage is simulated too.
Moves = dict[tuple[str, str], Array]

#: Least number of rows of a bin of a map.
MIN_ROWS = 10
#: Median absolute deviation of a normal distribution → its standard deviation.
ROBUST = 1.4826
#: Least number of rows that a share is computed from.
MIN_SHARE_ROWS = 50


# -- maps ----------------------------------------------------------------------------------------------------------------


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
    known = _Units(machine, units)
    parts = [_errors(problem, theta, repaired, r) for r in recordings]
    variables = _joined([_variables_of(problem, r, known) for r in recordings], [part.shape[2] for part in parts])
    errors = np.concatenate(parts, axis=2)
    found: list[Map] = []
    for k, signal in enumerate(problem.signals):
        unit, floor = known.of(signal), float(sigma[k])
        speed_floor = floor * float(np.sqrt(2.0)) / SPEED_WINDOW
        quantities = (("error", unit, floor), ("speed error", per_second(unit), speed_floor))
        of_signal = [
            item
            for quantity, curves in zip(quantities, errors[..., k], strict=False)  # speeds where the stage integrates
            for over, variable in variables.items()
            if not (problem.kind.integrates and quantity[0] == "error" and not _is_own(over, problem.target))
            if (item := _map(problem, signal, over, variable, quantity, curves)) is not None
        ]
        found += sorted(of_signal, key=lambda item: -item.explains)
    return tuple(found)


def _errors(problem: Problem, theta: Array, repaired: Array | None, recording: Recording) -> Array:
    """Error, error after the repair, measured and simulated of each output, (1, 4, n, d); NaN where there is none.

    Where the stage integrates, (2, 4, n, d): the same of the speeds as well. Measured and simulated are those of speeds only.
    """
    lanes = theta[None] if repaired is None else np.vstack([theta, repaired])
    measured, predicted = problem.measured(recording), problem.predict(lanes, recording)
    nothing = np.full(measured.shape, np.nan)
    error, after = measured - predicted[0], measured - predicted[1] if repaired is not None else nothing
    found = [[error, after, nothing, nothing]]
    if problem.kind.integrates:
        rate_hz = problem.rate(recording)
        found.append([speed_of(values, rate_hz) for values in (error, after, measured, predicted[0])])
    return np.array(found)


def _is_own(over: str, target: str) -> bool:
    """Whether a variable belongs to the axis itself."""
    return over == "time" or split_signal(over)[0] == target or over.endswith(f" of {target}")


def _map(
    problem: Problem, signal: str, over: str, variable: _Variable, quantity: tuple[str, str, float], curves: Array
) -> Map | None:
    """One map; None where the variable does not vary.

    Args:
        quantity: what is compared, its unit and noise floor.
        curves: its error, error after the repair, measured and simulated value, (4, n).
    """
    error, after, measured, simulated = curves
    there = np.isfinite(error) & np.isfinite(variable.samples)
    if there.sum() < 2 * MIN_ROWS:
        return None
    x, e = variable.samples[there], error[there]
    edges = edges_of(x, variable.kind)
    if edges is None:
        return None
    place = places_in(edges, x)
    count = np.bincount(place, minlength=len(edges) - 1)
    kept = np.flatnonzero(count >= MIN_ROWS)
    if len(kept) < 2:
        return None
    rows = np.split(np.argsort(place, kind="stable"), np.cumsum(count)[:-1])
    rows = [rows[b] for b in kept]

    def means(values: Array) -> tuple[float, ...]:
        here = values[there]
        return _rounded([np.mean(here[of_bin]) for of_bin in rows]) if np.isfinite(here).any() else ()

    return Map(
        problem.stage, problem.target, signal, over, variable.unit, *quantity, explained(e, place, count),
        at=_rounded([np.median(x[of_bin]) for of_bin in rows]),
        count=tuple(map(int, count[kept])),
        mean=means(error),
        spread=_rounded([ROBUST * np.median(np.abs(e[of_bin] - np.median(e[of_bin]))) for of_bin in rows]),
        after=means(after),
        measured=means(measured),
        simulated=means(simulated),
    )  # fmt: skip


def _rounded(values: Sequence[float | np.floating]) -> tuple[float, ...]:
    """Rounded to six digits, which keeps a result with a hundred maps small."""
    return tuple(float(f"{value:.6g}") for value in values)


# -- variables of a map --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Units:
    """Units of the signals of a machine; ``given`` where the machine description leaves them open."""

    machine: Machine
    given: Mapping[str, str]

    def of(self, signal: str) -> str:
        return self.given.get(signal) or self.machine.expected_unit(signal) or "1"


@dataclass(frozen=True)
class _Variable:
    """What an error may depend on: samples (n,), their unit, and how they are cut into bins."""

    samples: Array
    unit: str
    kind: Cut = "range"


def _joined(parts: Sequence[dict[str, _Variable]], lengths: Sequence[int]) -> dict[str, _Variable]:
    """The variables of all recordings, one after the other; NaN where a recording does not have one."""
    about = {name: variable for part in reversed(parts) for name, variable in part.items()}
    found = {}
    for name, variable in about.items():
        samples = [part[name].samples if name in part else np.full(n, np.nan) for part, n in zip(parts, lengths, strict=True)]
        found[name] = replace(variable, samples=np.concatenate(samples))
    return found


def _variables_of(problem: Problem, recording: Recording, known: _Units) -> dict[str, _Variable]:
    """Name → variable that the error of a stage may depend on, on its measured rows."""
    rows = problem.rows(recording)
    if problem.target in known.machine.axis_names:
        found = _of_axis(problem, recording, known)
    else:
        found = _of_point(problem, recording, known)
    if recording.kind == "motion":
        found["time"] = _Variable(recording.values("time"), "s")
    return {name: _Variable(v.samples[rows], v.unit, v.kind) for name, v in found.items()}


def _of_axis(problem: Problem, recording: Recording, known: _Units) -> dict[str, _Variable]:
    axis = known.machine.axis(problem.target)
    found: dict[str, _Variable] = {}
    position, unit = recording.values(axis.driven), known.of(axis.driven)
    found[axis.driven] = _Variable(position, unit)
    if recording.kind == "motion":
        speed = speed_of(position, recording.rate_hz)
        found[f"speed of {axis.name}"] = _Variable(speed, per_second(unit), "signed")
        found[f"direction of {axis.name}"] = _Variable(direction_of(speed), "1", "sign")
        signal = axis_signal(axis.name, "command")
        if signal not in problem.signals:
            found[signal] = _Variable(recording.values(signal), known.of(signal), "signed")
        found |= _of_others(axis.name, recording, known)
    return found | _loads(recording, known, (axis.name,))


def _of_others(axis: str, recording: Recording, known: _Units) -> dict[str, _Variable]:
    """The commands of the other axes one by one, and together in shares of the largest of each."""
    found: dict[str, _Variable] = {}
    total = np.zeros(len(recording))
    for other in known.machine.axes:
        signal = axis_signal(other.name, "command")
        command = recording.values(signal)
        largest = float(np.nanmax(np.abs(command), initial=0.0))
        if other.name != axis and largest > 0.0:
            found[signal] = _Variable(command, known.of(signal), "signed")
            total += np.abs(command) / largest
    if len(found) > 1:
        found["other axes together"] = _Variable(total, "1")
    return found


def _of_point(problem: Problem, recording: Recording, known: _Units) -> dict[str, _Variable]:
    """For the tip: every joint and load. For the tool: speed and acceleration of its pivot."""
    found: dict[str, _Variable] = {}
    if problem.inputs == point_signals("ee"):
        for coordinate in problem.inputs:
            speed = speed_of(recording.values(coordinate), recording.rate_hz)
            found[f"speed of {coordinate}"] = _Variable(speed, "m/s", "signed")
            found[f"acceleration of {coordinate}"] = _Variable(speed_of(speed, recording.rate_hz), "m/s²", "signed")
        return found
    for axis in known.machine.axes:
        joint = axis_signal(axis.name, "joint")
        found[joint] = _Variable(recording.values(joint), known.of(joint))
        if recording.kind == "motion":
            direction = direction_of(speed_of(recording.values(joint), recording.rate_hz))
            found[f"direction of {axis.name}"] = _Variable(direction, "1", "sign")
    return found | _loads(recording, known, known.machine.axis_names)


def _loads(recording: Recording, known: _Units, axes: Sequence[str]) -> dict[str, _Variable]:
    """Gravity loads of axes that have one."""
    if known.machine.kinematics() is None:
        return {}
    loads = gravity_load(known.machine, recording)
    found = {}
    for name in axes:
        values = loads[:, known.machine.axis_names.index(name)]
        if np.any(values):
            joint_unit = known.of(axis_signal(name, "joint"))
            found[f"load of {name}"] = _Variable(values, "N" if joint_unit == "m" else "N·m")
    return found


# -- shares --------------------------------------------------------------------------------------------------------------


def shares_of(model: Model, recordings: Sequence[Recording]) -> tuple[Share, ...]:
    """Shares in the errors of the tool, the tip, and every joint behind a cylinder, where they are measured.

    Rows with a missing value along the chain are left out.
    """
    parts: dict[str, list[Moves]] = {}
    for recording in recordings:
        for end, moves in _moves(model, recording).items():
            parts.setdefault(end, []).append(moves)
    found: list[Share] = []
    for end, of_recordings in parts.items():
        keys = list(dict.fromkeys(key for moves in of_recordings for key in moves))
        whole = [moves for moves in of_recordings if len(moves) == len(keys)]
        if not whole:
            continue
        d = {key: np.concatenate([moves[key] for moves in whole]) for key in keys}
        there = np.all([np.isfinite(part).all(axis=1) for part in d.values()], axis=0)
        if not there.any():
            continue
        error = np.sum([part[there] for part in d.values()], axis=0)
        total = float(np.sum(error**2))
        found += [
            Share(
                end, stage, target,
                float(np.sum(error * part[there])) / total if total > 0.0 else 0.0,
                float(np.sqrt(np.sum(part[there] ** 2) / there.sum())),
                float(np.sqrt(total / there.sum())),
            )
            for (stage, target), part in d.items()
        ]  # fmt: skip
    return tuple(found)


def _moves(model: Model, recording: Recording) -> dict[str, Moves]:
    """End of the chain (``tool``, ``ee``, or the joint of an axis) → moves of its stages."""
    run = free_run(model, recording)
    linked = {
        axis.name: model.joint(model.theta[None], recording, axis.name)[0]
        for axis in model.machine.axes
        if axis.drives == "cylinder" and axis.name in model.linked
        if _are_measured(recording, axis.driven, axis_signal(axis.name, "joint"))
    }
    ends: dict[str, Moves] = {}
    for name, driven in linked.items():
        joint = axis_signal(name, "joint")
        if joint in run:
            simulated = run[joint].to_numpy(dtype=np.float64)
            chain = [(("joint", name), driven[:, None]), (("command", name), simulated[:, None])]
            ends[joint] = _steps(recording.values(joint)[:, None], chain)
    joints = [axis_signal(name, "joint") for name in model.machine.axis_names]
    if model.posed and set(joints) <= set(run) and _are_measured(recording, *joints, *point_signals("ee")):
        tool = model.has_tool(model.theta, recording)
        tool = tool and _are_measured(recording, *point_signals("ee"), *point_signals("tool"))
        for point in ("ee", "tool") if tool else ("ee",):
            ends[point] = _steps(measured_point(recording, point), _point_chain(model, recording, run, linked, point))
    return ends


def _steps(measured: Array, chain: Iterable[tuple[tuple[str, str], Array]]) -> Moves:
    """Changes of the prediction along a chain that starts from the measurement, (n, d) each."""
    moves: Moves = {}
    last = measured
    for key, predicted in chain:
        moves[key] = predicted - last
        last = predicted
    return moves


def _point_chain(
    model: Model, recording: Recording, run: pd.DataFrame, linked: Mapping[str, Array], point: str
) -> Iterator[tuple[tuple[str, str], Array]]:
    """(stage, target) → position of tip or tool (n, 3), with that stage and those before it in this order simulated.

    Args:
        run: free run of the recording.
        linked: joint angle behind each measured cylinder, from its measured stroke (n,) [rad].
    """
    theta = model.theta[None]

    def predicted(known: Recording) -> Array:
        tip = model.tip(theta, known)[0]
        if point == "ee":
            return np.asarray(tip)
        return np.asarray(model.tool(theta, _with(known, dict(zip(point_signals("ee"), tip.T, strict=True))))[0])

    if point == "tool":
        yield ("tool", "tool"), np.asarray(model.tool(theta, recording)[0])
    yield ("end_effector", "ee"), predicted(recording)
    known = recording
    for name, driven in linked.items():
        known = _with(known, {axis_signal(name, "joint"): driven})
        yield ("joint", name), predicted(known)
    for name in model.machine.axis_names:
        joint = axis_signal(name, "joint")
        known = _with(known, {joint: run[joint].to_numpy(dtype=np.float64)})
        yield ("command", name), predicted(known)


def _with(recording: Recording, columns: dict[str, Array]) -> Recording:
    return replace(recording, table=recording.table.assign(**columns))


def _are_measured(recording: Recording, *signals: str) -> bool:
    there = np.all([np.isfinite(recording.values(name)) for name in signals], axis=0)
    return bool(there.sum() >= MIN_SHARE_ROWS)
