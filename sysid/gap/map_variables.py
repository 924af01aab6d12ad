"""Variables over which errors are mapped: command, speed, direction, position, load, time, the other axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.machine import Machine
from sysid.plant import gravity_load
from sysid.signals import axis_signal, point_signals
from sysid.validate.binning import Cut, direction_of, per_second, speed_of

Array = npt.NDArray[np.float64]


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
