"""A MuJoCo model as a simulator of a machine: commands in, joints, end effector and tool out.

Each axis of the machine is a joint of the model with one actuator. A command is held over its sample, as a controller holds it;
input effects act on it at the time steps of the model, the largest that divide the sample and are not above the model's own.
Joints start at their measured position and speed, activations and delayed controls at the first command, and passive joints in
their equilibrium.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.errors import InputError, SettingsError, nearest
from sysid.foreign import shown
from sysid.gap.adapters.simulator import joint_start, starting_value
from sysid.machine import Machine
from sysid.machine.sources.mjcf_actuator import Drive, drive_of
from sysid.machine.sources.mjcf_model import (
    actuator_name,
    body_name,
    joint_actuators,
    joint_name,
    load_mjcf,
    load_spec,
    mujoco_library,
)
from sysid.names import listed
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Steps that one call of the library runs, so that its outputs stay small.
CHUNK_STEPS = 4096
#: Place of the time in a physics state.
TIME = 0
#: Time in which passive joints come to rest, and the share of their speed that is kept in a step of it.
SETTLE_S, SETTLE_KEPT = 5.0, 0.98
#: Inertia of a driven joint while passive ones come to rest: it does not move [kg·m² or kg].
HELD = 1e9
#: Name of the sensors that are added to the model.
_SENSOR = "sysid"


@dataclass(frozen=True)
class Compiled:
    """A model compiled for one sample rate: ``substeps`` of its time step in a sample; ``columns`` of its sensor data."""

    model: Any
    drives: Mapping[str, Drive]
    substeps: int
    columns: Mapping[str, int]


@dataclass
class MujocoSimulator:
    """The simulator of an MJCF for a machine.

    Args:
        path: of the MJCF.
        machine: whose axes are joints of the model with one actuator each; its ``tip`` and ``tool`` are sites or bodies.
        assets: further folders below which the model may open files.
        threads: in which lanes run at the same time; by default one a processor.

    Raises:
        InputError: not a file that MuJoCo compiles.
        SettingsError: the model does not fit the machine.
    """

    path: Path
    machine: Machine
    assets: tuple[Path, ...] = ()
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    _compiled: dict[float, Compiled] = field(default_factory=dict, repr=False)
    _starts: dict[tuple[int, float], tuple[Recording, Array]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        model = load_mjcf(self.path, self.assets)
        drives_of(model, self.machine, self.name)
        links = {"ee": self.machine.tip, "tool": self.machine.tool}
        self._points = {owner: point_of(model, link, self.name) for owner, link in links.items() if link is not None}

    @property
    def name(self) -> str:
        return self.path.name

    def simulate(self, recording: Recording) -> pd.DataFrame:
        """Signals for the commands of a recording; axes without a command hold their starting position, speed or no force."""
        names = [axis_signal(axis, "command") for axis in self.machine.axis_names]
        present = {name: recording.values(name)[None] for name in names if not np.isnan(recording.values(name)).all()}
        return pd.DataFrame({signal: values[0] for signal, values in self.simulate_many(recording, present).items()})

    def simulate_many(
        self, recording: Recording, commands: Mapping[str, Array], starts: Array | None = None
    ) -> Mapping[str, Array]:
        """``<axis>.command`` → (lanes, n) to signal → (lanes, n).

        Args:
            starts: (lanes, axes, 2) positions [rad or m] and speeds [rad/s or m/s] of the axes at the first row, from the
                measured ones.

        Raises:
            InputError: the simulation is unstable at the time step of the model.
        """
        compiled = self.compiled(recording.rate_hz)
        controls = self._controls(compiled, recording, commands)
        sensors = self._rollout(compiled, recording, controls, np.zeros((len(controls), 1, 2)) if starts is None else starts)
        found = {signal: sensors[:, :, column] for signal, column in compiled.columns.items()}
        if not all(np.isfinite(values).all() for values in found.values()):
            expected = "a stable simulation"
            raise InputError(
                f"simulator {self.name}, recording {recording.name}", "it diverges", expected, "Shorten its time step."
            )
        return found

    def start_positions(self, recording: Recording) -> Array:
        """Joint positions (nq,) at the first row: measured ones of the axes, passive ones in equilibrium."""
        key = id(recording), recording.rate_hz
        if key not in self._starts or self._starts[key][0] is not recording:
            compiled = self.compiled(recording.rate_hz)
            positions = np.array(compiled.model.key_qpos[0] if compiled.model.nkey else compiled.model.qpos0)
            for axis, drive in compiled.drives.items():
                at = int(compiled.model.jnt_qposadr[drive.joint])
                positions[at] = joint_start(recording, axis_signal(axis, "joint"), float(positions[at])).position
            self._starts[key] = recording, settled(compiled, positions)
        return self._starts[key][1]

    def compiled(self, rate_hz: float) -> Compiled:
        """The model for a sample rate [Hz]."""
        if rate_hz not in self._compiled:
            self._compiled[rate_hz] = self._compile(rate_hz)
        return self._compiled[rate_hz]

    def steps_in_sample(self, rate_hz: float) -> int:
        """Time steps of the model in a sample of a recording."""
        return self.compiled(rate_hz).substeps

    def _compile(self, rate_hz: float) -> Compiled:
        """The model with a sensor for each signal, its time step a part of the sample."""
        mujoco, spec = mujoco_library(), load_spec(self.path, self.assets)
        substeps = max(1, math.ceil(1.0 / (rate_hz * spec.option.timestep) - 1e-6))
        spec.option.timestep = step = 1.0 / (rate_hz * substeps)
        for actuator in spec.actuators:
            if actuator.delay > 0.0:  # a sample a step, and one on either side
                actuator.nsample = max(int(actuator.nsample), math.ceil(actuator.delay / step) + 2)
        joint, position = mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtSensor.mjSENS_JOINTPOS
        for axis in self.machine.axes:
            name = f"{_SENSOR}:{axis_signal(axis.name, 'joint')}"
            spec.add_sensor(name=name, type=position, objtype=joint, objname=axis.joint or axis.name)
        for owner, (kind, point) in self._points.items():
            place = mujoco.mjtSensor.mjSENS_FRAMEPOS
            spec.add_sensor(name=f"{_SENSOR}:{owner}", type=place, objtype=mujoco.mjtObj(kind), objname=point)
        model = spec.compile()
        columns = dict[str, int]()
        for sensor in (*(axis_signal(axis, "joint") for axis in self.machine.axis_names), *self._points):
            first = int(model.sensor_adr[model.sensor(f"{_SENSOR}:{sensor}").id])
            signals = point_signals(sensor) if sensor in self._points else (sensor,)
            columns |= {signal: first + k for k, signal in enumerate(signals)}
        return Compiled(model, drives_of(model, self.machine, self.name), substeps, columns)

    def _controls(self, compiled: Compiled, recording: Recording, commands: Mapping[str, Array]) -> Array:
        """Controls (lanes, n, nu); of actuators beside the axes those of the first keyframe, else zero."""
        model, shape = compiled.model, next(iter(commands.values())).shape
        controls = np.tile(np.array(model.key_ctrl[0]) if model.nkey else np.zeros(model.nu), (*shape, 1))
        for axis in self.machine.axes:
            drive = compiled.drives[axis.name]
            held = starting_value(recording, axis.driven) if drive.control == "position" else 0.0
            given = commands.get(axis_signal(axis.name, "command"), np.full(shape, held))
            controls[:, :, int(model.actuator_ctrladr[drive.actuator])] = drive.scale * given
        return controls

    def _rollout(self, compiled: Compiled, recording: Recording, controls: Array, starts: Array) -> Array:
        """Sensor data at the beginning of each row, (lanes, n, sensors)."""
        from mujoco.rollout import Rollout

        model, steps = compiled.model, compiled.substeps
        lanes, rows = controls.shape[:2]
        threads = min(self.threads, lanes)
        datas = [mujoco_library().MjData(model) for _ in range(threads)]
        state = np.stack([self._start(compiled, recording, c[0], away) for c, away in zip(controls, starts, strict=True)])
        out = np.empty((lanes, rows, model.nsensordata))
        with Rollout(nthread=threads if threads > 1 else 0) as pool:
            chunk = max(1, CHUNK_STEPS // steps)
            for first in range(0, rows, chunk):
                held = np.repeat(controls[:, first : first + chunk], steps, axis=1)
                states, sensors = pool.rollout([model] * lanes, datas, state, held)
                out[:, first : first + chunk] = sensors[:, ::steps]
                state = states[:, -1]
                # MuJoCo resets a run with values beyond its range, or stops it; its time then lags behind.
                lags = np.abs(state[:, TIME] - (first * steps + held.shape[1]) * model.opt.timestep) > 0.5 * model.opt.timestep
                out[lags, first:] = np.nan
        return out

    def _start(self, compiled: Compiled, recording: Recording, control: Array, away: Array) -> Array:
        """Physics state at the first row for the first control (nu,), the axes by ``away`` (axes or 1, 2) from their start."""
        mujoco, model = mujoco_library(), compiled.model
        data = mujoco.MjData(model)
        data.qpos[:] = self.start_positions(recording)
        moved = np.broadcast_to(away, (len(compiled.drives), 2))
        for (axis, drive), (position, speed) in zip(compiled.drives.items(), moved, strict=True):
            data.qpos[int(model.jnt_qposadr[drive.joint])] += position
            data.qvel[int(model.jnt_dofadr[drive.joint])] = joint_start(recording, axis_signal(axis, "joint")).speed + speed
        data.ctrl[:] = control
        for k in range(model.nactuator):
            _begin(model, data, k)
        spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(model, spec))
        mujoco.mj_getState(model, data, state, spec)
        return state


def settled(compiled: Compiled, positions: Array) -> Array:
    """Positions (nq,) with the passive joints in their equilibrium, the driven ones held."""
    mujoco, model = mujoco_library(), compiled.model
    driven = {drive.joint for drive in compiled.drives.values()}
    passive = [j for j in range(model.njnt) if j not in driven]
    if not passive:
        return positions
    model = copy.copy(model)
    model.dof_armature[[int(model.jnt_dofadr[j]) for j in driven]] = HELD
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    for _ in range(round(SETTLE_S / model.opt.timestep)):
        mujoco.mj_step(model, data)
        data.qvel[:] *= SETTLE_KEPT
    held = [int(model.jnt_qposadr[j]) for j in driven]
    data.qpos[held] = positions[held]
    return np.array(data.qpos)


def _begin(model: Any, data: Any, actuator: int) -> None:
    """Activation and history of an actuator at rest under its present control."""
    mujoco, dyns = mujoco_library(), mujoco_library().mjtDyn
    at, kind = int(model.actuator_ctrladr[actuator]), int(model.actuator_dyntype[actuator])
    if kind in (dyns.mjDYN_FILTER, dyns.mjDYN_FILTEREXACT) or (kind == dyns.mjDYN_PID and model.actuator_actnum[actuator]):
        data.act[model.actuator_actadr[actuator]] = data.ctrl[at]
    elif kind == dyns.mjDYN_INTEGRATOR:
        joint = int(model.actuator_trnid[actuator, 0])
        data.act[model.actuator_actadr[actuator]] = gear_of(model, actuator) * data.qpos[model.jnt_qposadr[joint]]
    samples = int(model.actuator_history[actuator, 0])
    if samples > 0:
        times = model.opt.timestep * np.arange(-samples, 0)
        mujoco.mj_initCtrlHistory(model, data, actuator, times, np.full(samples, data.ctrl[at]))


def drives_of(model: Any, machine: Machine, source: str) -> dict[str, Drive]:
    """Axis → its drive, in the order of the machine.

    Raises:
        SettingsError: an axis without its joint or actuator, or with another kind of command.
    """
    joints = {joint_name(model, k): k for k in range(model.njnt)}
    actuators, found = joint_actuators(model), dict[str, Drive]()
    for axis in machine.axes:
        where = f"{source}: axis {shown(axis.name)}"
        name = axis.joint or axis.name
        if axis.drives != "joint":
            raise SettingsError(where, "it drives a cylinder", "joint axes, which MJCF has")
        if name not in joints:
            raise SettingsError(where, f"no joint {name!r} in the model", nearest(name, joints))
        own = actuators.get(joints[name], [])
        if len(own) != 1:
            names = f"actuators {listed([actuator_name(model, k) for k in own])}" if own else "no actuator"
            raise SettingsError(where, f"{names} on joint {name!r}", "one actuator")
        drive = drive_of(model, own[0], source)
        led = drive.actuation == "position" and axis.follows_positions
        if drive.actuation != axis.actuation and not led:
            found_as = f"actuator {actuator_name(model, own[0])} takes a {drive.control}, machine.toml says {axis.actuation}"
            remedy = f"sysid init --from {source} makes the machine.toml of this model."
            raise SettingsError(where, found_as, "the same actuation in both", remedy)
        found[axis.name] = drive
    return found


def gear_of(model: Any, actuator: int) -> float:
    """Gear ratio between an actuator and its joint."""
    return float(model.actuator_gear[int(model.actuator_outadr[actuator]), 0])


def point_of(model: Any, link: str, source: str) -> tuple[int, str]:
    """MuJoCo object type and name of the site, or of the body, that a URDF link of ``machine.toml`` names.

    Raises:
        SettingsError: the model has neither a site nor a body of that name.
    """
    kinds = mujoco_library().mjtObj
    sites = [str(model.site(k).name) for k in range(model.nsite)]
    bodies = [body_name(model, k) for k in range(1, model.nbody)]
    for name in (link, link.removesuffix("_tip")):  # the suffix of a fixed link beside a body of that name
        if name in sites:
            return int(kinds.mjOBJ_SITE), name
        if name in bodies:
            return int(kinds.mjOBJ_XBODY), name
    raise SettingsError(f"{source}: link {shown(link)} of machine.toml", "no site or body", nearest(link, [*sites, *bodies]))
