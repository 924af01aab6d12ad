"""Force-driven axes of a MuJoCo model: friction, inertia and masses are parameters of the model itself.

The plant with the same axes, masses, armature, damping and friction loss needs the same forces for a measured motion as the
model; this is checked with MuJoCo's inverse dynamics on the recordings. Its effects are therefore searched on that plant, and
written into the joints, bodies and actuators of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.errors import InputError, SettingsError
from sysid.gap.adapters.mujoco.axes import drives_of
from sysid.gap.problem import split_of
from sysid.machine import Machine, machine_from_files
from sysid.machine.rigid_body import rigid_body
from sysid.machine.sources.mjcf import mjcf_draft
from sysid.machine.sources.mjcf_model import load_mjcf, mujoco_library
from sysid.machine.sources.toml_text import machine_text
from sysid.names import listed
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.plant.link_torque import link_motion

Array = npt.NDArray[np.float64]

#: Rows of a recording at which both inverse dynamics are compared.
ROWS = 200
#: Largest RMS difference of their torques, as a share of the RMS torque; standard gravity differs by 0.03 % from MuJoCo's.
TOLERANCE = 0.01


@dataclass(frozen=True)
class ForceModel:
    """An MJCF whose axes are all driven by forces, and the plant that needs the same forces."""

    path: Path
    plant: Plant


def is_force_driven(machine: Machine) -> bool:
    """Whether every axis is."""
    return all(axis.actuation == "force" for axis in machine.axes)


def open_force_model(path: Path, dataset: Dataset, assets: Sequence[Path] = ()) -> ForceModel:
    """The plant of a model for the recordings of a dataset.

    Args:
        assets: further folders below which the model may open files.

    Raises:
        InputError: not a file that MuJoCo compiles, or it needs other forces than the plant (springs, contacts).
        SettingsError: its axes are not those of the dataset.
    """
    machine, model = machine_of(path, dataset.machine, assets), load_mjcf(path, assets)
    plant = nominal_plant(machine, streams=dataset.streams)
    _check_forces(path, model, plant, dataset)
    return ForceModel(path, plant)


def machine_of(path: Path, machine: Machine, assets: Sequence[Path] = ()) -> Machine:
    """The machine that the model describes, with names, rate and sensor noise of ``machine``.

    Raises:
        SettingsError: other axes.
    """
    draft = mjcf_draft(path, machine.tip, machine.tool, assets=assets)
    found = [axis.joint for axis in draft.axes]
    wanted = [axis.joint or axis.name for axis in machine.axes]
    if found != wanted:
        expected = f"{listed(wanted)}, the joints of machine.toml"
        raise SettingsError(
            path.name, f"driven joints {listed(found)}", expected, f"sysid init --from {path.name} describes it."
        )
    names = {axis.joint: own.name for axis, own in zip(draft.axes, machine.axes, strict=True)}
    axes = tuple(
        replace(axis, name=names[axis.joint], effects=tuple(replace(e, target=names[axis.joint]) for e in axis.effects))
        for axis in draft.axes
    )
    text = machine_text(replace(draft, axes=axes), machine.name)
    own = machine_from_files({"machine.toml": text, f"{machine.name}.urdf": draft.urdf}, path.name)
    return replace(own, rate_hz=machine.rate_hz, noise=machine.noise)


def _check_forces(path: Path, model: Any, plant: Plant, dataset: Dataset) -> None:
    """Compare the torques of both at measured motion, without friction.

    Raises:
        InputError: they differ.
    """
    mujoco, body = mujoco_library(), rigid_body(plant.machine)
    drives = drives_of(model, plant.machine, path.name)
    if body is None:
        return
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.actuator_damping[:] = 0.0
    data, compiled = mujoco.MjData(model), compile_plant(plant)
    places = [int(model.jnt_qposadr[drive.joint]) for drive in drives]
    dofs = [int(model.jnt_dofadr[drive.joint]) for drive in drives]
    rotors = np.array([axis.inertia or 0.0 for axis in plant.machine.axes])
    for recording in split_of(dataset).seen[:1]:
        motion = link_motion(compiled, recording)
        if motion is None:
            return
        rows = np.linspace(0, len(recording) - 1, ROWS).astype(int)
        q, v, a = (part[rows] for part in motion)
        own = body.torque(q, v, a, body.nominal) + rotors * a
        theirs = np.empty_like(own)
        for k in range(len(rows)):
            data.qpos[places], data.qvel[dofs], data.qacc[dofs] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            theirs[k] = data.qfrc_inverse[dofs]
        for axis, ours, other in zip(plant.machine.axis_names, own.T, theirs.T, strict=True):
            difference, size = (float(np.sqrt(np.mean(x**2))) for x in (ours - other, other))
            if difference > TOLERANCE * size:
                found = f"{axis}: its torques differ by {difference:.3g} of {size:.3g} from those of its masses and rotors"
                raise InputError(path, found, f"at most {TOLERANCE:.0%}", "Remove springs, contacts and tendons at the axes.")


def force_drives(model: Any, machine: Machine, source: str) -> Mapping[str, Any]:
    """Axis → its drive."""
    return dict(zip(machine.axis_names, drives_of(model, machine, source), strict=True))


def moved_bodies(model: Any, joint: int) -> Sequence[int]:
    """Bodies that move with a joint and no further one."""
    root = int(model.jnt_bodyid[joint])
    found = [root]
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in found and model.body_jntnum[body] == 0:
            found.append(body)
    return found
