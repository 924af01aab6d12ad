"""Replay a file: joint setpoints, valve commands, or an experiment that the gap workflow requests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.errors import InputError, SettingsError
from sysid.gap.experiment import Experiment
from sysid.machine import Machine
from sysid.plant import Plant
from sysid.signals import axis_signal, split_signal
from sysid_rl.run.limits import Limits
from sysid_rl.run.modes.mode import Approach, Goal, done

Array = npt.NDArray[np.float64]


class ReplayJoints:
    """Joint setpoints (n, A), one per cycle, after a move to the first ones."""

    name, moves, writes, computes = "replay", True, True, True

    def __init__(self, joints: Array, limits: Limits, dt: float) -> None:
        self.joints, self._approach = joints, Approach(joints[0], limits, dt)

    def begin(self, joints: Array, ee: Array) -> None:
        self._approach.begin(joints)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        here = k - self._approach.steps
        if here < 0:
            return self._approach.goal(k)
        return done("replay") if here >= len(self.joints) else Goal("replay", joints=self.joints[here])


class ReplayCommands:
    """Valve commands (n, A), one per cycle, open loop.

    Args:
        commands: (n, A) in [-1, 1].
        start: joints (A,) of a move before; None: from the present position.
        watched: joint column → range (lowest, highest); the run ends outside of it.
    """

    moves, writes, computes = True, True, True

    def __init__(
        self,
        commands: Array,
        limits: Limits,
        dt: float,
        *,
        start: Array | None = None,
        watched: Mapping[int, tuple[float, float]] | None = None,
        name: str = "replay",
    ) -> None:
        self.name, self.commands, self._watched = name, commands, dict(watched or {})
        self._approach = Approach(start, limits, dt) if start is not None else None

    def begin(self, joints: Array, ee: Array) -> None:
        if self._approach is not None:
            self._approach.begin(joints)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        here = k - (self._approach.steps if self._approach is not None else 0)
        if here < 0:
            assert self._approach is not None
            return self._approach.goal(k)
        if here >= len(self.commands):
            return done(self.name)
        for column, (low, high) in self._watched.items():
            if not low <= joints[column] <= high:
                return Goal(self.name, stop=f"joint {column} left {low:.4g} … {high:.4g}, the limits of the experiment")
        return Goal(self.name, commands=self.commands[here])


def of_experiment(experiment: Experiment, plant: Plant, limits: Limits, dt: float) -> ReplayCommands:
    """An experiment that :func:`sysid.gap.find_gap` requests: from its start, within its limits.

    Raises:
        SettingsError: another rate, or an axis without a valve.
    """
    machine = plant.machine
    where = f"experiment {experiment.name}"
    if abs(experiment.rate_hz * dt - 1.0) > 1e-6:
        raise SettingsError(where, f"{experiment.rate_hz:g} Hz", f"{1.0 / dt:g} Hz, the rate of the machine")
    for axis in machine.axes:
        if axis.actuation != "velocity":
            raise SettingsError(where, f"axis {axis.name} has actuation = {axis.actuation!r}", "valves")
    start = 0.5 * (limits.low + limits.high)
    for signal, value in experiment.start.items():
        _set(start, signal, value, plant)
    watched: dict[int, tuple[float, float]] = {}
    for signal, (low, high) in experiment.limits.items():
        owner, quantity = split_signal(signal)
        if owner in machine.axis_names and quantity in ("joint", "cylinder"):
            ends = np.array([low, high])
            if quantity == "cylinder":
                ends = np.sort(plant.linkages[owner].joint(ends))
            i = machine.axis_names.index(owner)
            old = watched.get(i, (-np.inf, np.inf))
            watched[i] = max(old[0], float(ends[0])), min(old[1], float(ends[1]))
    columns = [axis_signal(axis, "command") for axis in machine.axis_names]
    return ReplayCommands(
        experiment.commands[columns].to_numpy(dtype=np.float64), limits, dt, start=start, watched=watched, name="experiment"
    )


def of_file(path: Path, machine: Machine, limits: Limits) -> ReplayJoints | ReplayCommands:
    """A CSV file with ``time`` and, for every axis, ``<axis>.joint`` or ``<axis>.command``.

    Raises:
        InputError: no such file, other columns, values that are not finite, or time that does not increase.
    """
    dt = 1.0 / machine.rate_hz
    try:
        table = pd.read_csv(path)
    except FileNotFoundError:
        raise InputError(path, "no such file", "a CSV file with time and <axis>.joint or <axis>.command") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(path, f"not a CSV file ({error})", "time and <axis>.joint or <axis>.command") from None
    for quantity in ("joint", "command"):
        columns = [axis_signal(axis, quantity) for axis in machine.axis_names]
        if "time" in table.columns and all(column in table.columns for column in columns):
            break
    else:
        raise InputError(path, f"columns {', '.join(map(str, table.columns))}", f"time and {', '.join(columns)} or joints")
    rows = table[["time", *columns]].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    if len(rows) < 2 or not np.isfinite(rows).all() or not (np.diff(rows[:, 0]) > 0.0).all():
        raise InputError(path, "fewer than two rows, a value that is not finite, or decreasing time", "a whole table")
    time = np.arange(int((rows[-1, 0] - rows[0, 0]) * machine.rate_hz + 1e-6) + 1) * dt + rows[0, 0]
    values = np.column_stack([np.interp(time, rows[:, 0], column) for column in rows.T[1:]])
    if quantity == "joint":
        return ReplayJoints(values, limits, dt)
    if np.abs(values).max() > 1.0:
        raise InputError(path, f"a command of {np.abs(values).max():.4g}", "commands in -1 … 1")
    return ReplayCommands(values, limits, dt)


def _set(joints: Array, signal: str, value: float, plant: Plant) -> None:
    owner, quantity = split_signal(signal)
    if owner in plant.machine.axis_names:
        i = plant.machine.axis_names.index(owner)
        if quantity == "joint":
            joints[i] = value
        elif quantity == "cylinder":
            joints[i] = float(plant.linkages[owner].joint(np.array([value]))[0])
