"""Runs a machine in MuJoCo for one recording, without noise."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd

from hidden.foreign.excitation import Take, levers
from hidden.foreign.machines import Tables, axes_of
from hidden.foreign.mjcf import mjcf
from hidden.foreign.programs import REST, arm_paths, counts, force_path, tracking_force

Array = npt.NDArray[np.float64]


def run_mujoco(tables: Tables, take: Take) -> pd.DataFrame:
    """``time`` and the true signals of the machine on the controller's grid, without sensors."""
    mujoco.set_mju_user_warning(_warned)
    model = mujoco.MjModel.from_xml_string(mjcf(tables))
    data = mujoco.MjData(model)
    ticks, before, substeps = counts(tables, take)
    rows, columns = np.empty((ticks, 0)), list[str]()
    if tables["family"] == "mujoco_crane":
        rows, columns = _crane(model, data, tables, take, ticks, before, substeps)
    elif tables["family"] == "mujoco_arm":
        rows, columns = _arm(model, data, tables, take, ticks, before, substeps)
    else:
        rows, columns = _slide(model, data, tables, take, ticks, before, substeps)
    if any(warning.number for warning in data.warning):
        raise ValueError(f"{tables['family']}: MuJoCo calls the simulation unstable; expected settings that its step can take")
    return pd.DataFrame(rows[before:], columns=columns).assign(time=np.arange(ticks - before) / tables["rate"])


def _warned(text: str) -> None:
    """Suppress MuJoCo's warning file; warnings are counted in the data."""


def _crane(
    model: mujoco.MjModel, data: mujoco.MjData, tables: Tables, take: Take, ticks: int, before: int, substeps: int
) -> tuple[Array, list[str]]:
    axes = tables["axes"]
    draw = np.random.default_rng([take.seed, 1])
    joints = np.array([model.joint(name).qposadr[0] for name in axes])
    start = [
        float(np.mean(axis["limits"])) + 0.2 * np.diff(axis["limits"])[0] * draw.uniform(-1.0, 1.0) for axis in axes.values()
    ]
    for name, value in zip(axes, start, strict=True):
        for joint in (name, f"{name}_rotor"):
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) >= 0:
                data.qpos[model.joint(joint).qposadr[0]] = value
        for k in range(2):
            _begin_at(model, data, f"{name}_{k}", value if k == 0 else 0.0)
    _hang(model, data, take.swing)
    commanded = levers(take.program, take.seed, ticks / tables["rate"], axes)
    gains = np.array([axis["gain"] for axis in axes.values()])
    # The actuators include passive motors without a control.
    driven = [k for k in range(model.nactuator) if model.actuator_ctrlnum[k]]
    owners = [list(axes).index(model.actuator(k).name.rpartition("_")[0]) for k in driven]
    places = [model.site(name).id for name in ("ee", "tool")]
    rows = np.empty((ticks, 2 * len(axes) + 6))
    # A recording from standstill begins with the program; otherwise it is under way already.
    late = before / tables["rate"] + REST if take.lead == 0.0 else 0.0
    mujoco.mj_forward(model, data)
    for tick in range(ticks):
        seen = data.qpos[joints]
        at = tick / tables["rate"] - late
        command = np.array(
            [lever.command(at, place) if at >= 0.0 else 0.0 for lever, place in zip(commanded, seen, strict=True)]
        )
        mujoco.mj_kinematics(model, data)
        rows[tick] = [*command, *seen, *data.site_xpos[places].ravel()]
        data.ctrl[:] = (command * gains)[owners]
        mujoco.mj_step(model, data, substeps)
    points = [f"{point}.{c}" for point in ("ee", "tool") for c in "xyz"]
    return rows, [*(f"{name}.command" for name in axes), *(f"{name}.joint" for name in axes), *points]


def _begin_at(model: mujoco.MjModel, data: mujoco.MjData, actuator: str, value: float) -> None:
    """A drive that integrates its speed holds the place where the joint is."""
    place = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator)
    if place >= 0 and model.actuator_dyntype[place] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        data.act[model.actuator_actadr[place]] = value


def _hang(model: mujoco.MjModel, data: mujoco.MjData, swing: tuple[float, float]) -> None:
    """The tool hangs straight down, but for ``swing`` about x and y."""
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "hook") < 0:
        return
    mujoco.mj_kinematics(model, data)
    parent, tilted, relative = np.empty(4), np.empty(4), np.empty(4)
    mujoco.mju_negQuat(parent, data.xquat[model.body("telescope").id])
    angle = math.hypot(*swing)
    mujoco.mju_axisAngle2Quat(tilted, np.array([*swing, 0.0]) / (angle or 1.0), angle)
    mujoco.mju_mulQuat(relative, parent, tilted)
    place = model.joint("hook").qposadr[0]
    data.qpos[place : place + 4] = relative


def _arm(
    model: mujoco.MjModel, data: mujoco.MjData, tables: Tables, take: Take, ticks: int, before: int, substeps: int
) -> tuple[Array, list[str]]:
    names = axes_of(tables)
    wanted = arm_paths(tables, take, ticks, before)
    joints = np.array([model.joint(name).qposadr[0] for name in names])
    for k, name in enumerate(names):
        for joint in (name, f"{name}_rotor"):
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) >= 0:
                data.qpos[model.joint(joint).qposadr[0]] = wanted[0, k]
    rows = np.empty((ticks, 2 * len(names)))
    for tick in range(ticks):
        rows[tick] = [*wanted[tick], *data.qpos[joints]]
        data.ctrl[:] = wanted[tick]
        mujoco.mj_step(model, data, substeps)
    return rows, [f"{name}.{part}" for part in ("command", "joint") for name in names]


def _slide(
    model: mujoco.MjModel, data: mujoco.MjData, tables: Tables, take: Take, ticks: int, before: int, substeps: int
) -> tuple[Array, list[str]]:
    wanted, speeds = force_path(tables, take, ticks, before)
    data.qpos[0] = wanted[0]
    rows = np.empty((ticks, 2))
    for tick in range(ticks):
        force = tracking_force(tables, wanted[tick], speeds[tick], data.qpos[0], data.qvel[0])
        rows[tick] = force, data.qpos[0]
        data.ctrl[0] = force
        mujoco.mj_step(model, data, substeps)
    return rows, ["carriage.command", "carriage.joint"]
