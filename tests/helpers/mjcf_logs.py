"""Recordings of a machine that is a MuJoCo model, stepped one row at a time, beside the toolkit's own adapter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd
from plant_data import ROLES
from robots import robot

from sysid.datasets.recording import Dataset, Recording
from sysid.datasets.robot_files import Choices, drafted_files
from sysid.machine import Machine, machine_from_files

Array = npt.NDArray[np.float64]
#: Standard deviation of the joint sensors [rad or m].
NOISE = 2e-4


def machine_of(name: str, tip: str | None = None, tool: str | None = None) -> Machine:
    """The machine that ``init --from`` makes of a robot, with the noise of its joint sensors."""
    files = dict(drafted_files(robot(name), name, Choices(tip=tip, tool=tool)).files)
    del files["recipe.toml"]
    joints = machine_from_files(files, name).axis_names
    files["machine.toml"] += "\n[noise]\n" + "".join(f'"{joint}.joint" = {NOISE}\n' for joint in joints)
    return machine_from_files(files, name)


def held_levels(rng: np.random.Generator, count: int, rate_hz: float, low: float, high: float) -> Array:
    """A random level every 0.4 to 1.2 s, (count,)."""
    out, k = np.empty(count), 0
    while k < count:
        length = int(rate_hz * rng.uniform(0.4, 1.2))
        out[k : k + length] = rng.uniform(low, high)
        k += length
    return out


def commands_for(machine: Machine, seed: int, seconds: float) -> pd.DataFrame:
    """``time`` and a command of each axis: positions in the middle of its range, halves of its speed; at rest for a second."""
    rng, count = np.random.default_rng(seed), round(seconds * machine.rate_hz)
    table = {"time": np.arange(count) / machine.rate_hz}
    for axis in machine.axes:
        assert axis.limits is not None
        middle, reach = np.mean(axis.limits), 0.25 * np.ptp(axis.limits)
        low, high = (middle - reach, middle + reach) if axis.follows_positions else (-0.5, 0.5)
        levels, rest = held_levels(rng, count, machine.rate_hz, low, high), round(machine.rate_hz)
        levels[:rest] = levels[0] if axis.follows_positions else 0.0
        table[f"{axis.name}.command"] = levels
    return pd.DataFrame(table)


def run_model(
    model: mujoco.MjModel,
    machine: Machine,
    commands: pd.DataFrame,
    controls: Callable[[pd.DataFrame], dict[str, Array]],
    positions: Sequence[float],
) -> dict[str, Array]:
    """Joint positions, (n,) each, for ``controls`` (actuator → (n,)) that follow from the commands.

    Args:
        positions: at the start, of all joints (nq,); the controls before it are the first ones.
    """
    data, values = mujoco.MjData(model), controls(commands)
    places = [model.joint(axis.joint).qposadr[0] for axis in machine.axes]
    data.qpos[:] = positions
    for actuator, value in values.items():
        place, samples = model.actuator(actuator).id, int(model.actuator_history[model.actuator(actuator).id, 0])
        if samples:
            times = -model.opt.timestep * np.arange(samples, 0, -1)
            mujoco.mj_initCtrlHistory(model, data, place, times, np.full(samples, value[0]))
    for k in range(model.nactuator):  # an integrated speed holds the joint where it is
        if model.actuator_actnum[k] and model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
            data.act[model.actuator_actadr[k]] = data.qpos[model.jnt_qposadr[model.actuator_trnid[k, 0]]]
    for k in range(model.nactuator):
        if model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_FILTEREXACT:
            data.act[model.actuator_actadr[k]] = values[model.actuator(k).name][0]
    substeps = round(1.0 / (machine.rate_hz * model.opt.timestep))
    rows = np.empty((len(commands), len(places)))
    for k in range(len(commands)):
        rows[k] = data.qpos[places]
        for actuator, value in values.items():
            data.ctrl[model.actuator(actuator).id] = value[k]
        mujoco.mj_step(model, data, substeps)
    return {f"{axis.name}.joint": rows[:, i] for i, axis in enumerate(machine.axes)}


def dataset_of_runs(machine: Machine, tables: Sequence[pd.DataFrame]) -> Dataset:
    """A dataset with a role for each table."""
    found = [Recording(f"run-{k + 1}", table, machine.rate_hz) for k, table in enumerate(tables)]
    return Dataset.of(machine, found, {r.name: role for r, role in zip(found, ROLES, strict=True)})
