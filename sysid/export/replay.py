"""Replay proof: an export runs the commands of held-out recordings and is compared with the plant and with the machine.

Both begin where the free run of the recording begins, with its first commands held; force axes with their speed there, since a
recording may begin in motion. An export *agrees* with the plant in a signal if the RMS of their difference is at most the
largest of three bounds: :data:`SHARE` of the RMS of the plant's motion about its mean, the noise of the signal's sensor, or
what the rounding of the format's numbers makes at the size of the machine (:func:`roundings`).

An arm under recorded forces does not follow its recorded motion for long, in any simulator: small errors of the forces grow.
Two differences of the forces are therefore computed (:func:`force_replay`), and the larger one counts:

- between the forces that both need for the measured motion, under the filter of :mod:`sysid.plant.force`,
- between the recorded commands and the forces that the plant needs for the motion that the export makes of them, in short runs
  from measured positions and speeds. It is that of the equations of motion, whatever the runs do to the posture.

The end effector is compared at the measured joints, within the same bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.datasets.recording import Recording
from sysid.errors import ExcitationError
from sysid.export.drive_module import true_signals
from sysid.export.target import ForceSimulation, Simulation, Start
from sysid.export.urdf import base_pose, tip_offset
from sysid.gap.adapters.simulator import joint_start
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.arm_forces import arm_forces
from sysid.plant.force import ForceInputs, force_inputs
from sysid.plant.layout import STATE
from sysid.plant.link_torque import link_motion
from sysid.plant.rollout import run_steps, start_states, true_run
from sysid.plant.stepper import Stepper, begin_states, held_commands, step_commands
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Largest difference to the plant, as a share of its motion.
SHARE = 0.01
#: Difference that rounding may make where nothing moves and no noise is known [rad or m].
ROUNDING = 1e-9


@dataclass(frozen=True)
class ReplayRow:
    """One signal over all replayed recordings, RMS values in its unit.

    Args:
        export_error, plant_error: of the export and of the plant against the measurement; NaN where it is not measured.
        noise: of its sensor; NaN where it is not known.
        difference: between export and plant; ``allowed``: the bound of it.
        motion: of the plant about its mean.
    """

    signal: str
    export_error: float
    plant_error: float
    noise: float
    difference: float
    allowed: float
    motion: float

    @property
    def agrees(self) -> bool:
        return self.difference <= self.allowed


@dataclass(frozen=True)
class Replay:
    """Result of the replay of one export.

    Args:
        kind: ``motion``: free runs from recorded commands; ``forces``: forces at measured motion, of an arm.
    """

    recordings: tuple[str, ...]
    seconds: float
    rows: tuple[ReplayRow, ...]
    kind: Literal["motion", "forces"] = "motion"

    @property
    def agrees(self) -> bool:
        return all(row.agrees for row in self.rows)

    def to_json(self) -> dict[str, Any]:
        rows = [{**asdict(row), "agrees": row.agrees} for row in self.rows]
        found = {"recordings": list(self.recordings), "kind": self.kind, "seconds": self.seconds}
        return {**found, "agrees": self.agrees, "rows": rows}


@dataclass(frozen=True)
class Run:
    """Signals (n,) of one recording: by the export, by the plant, and the rows of the recording that they belong to."""

    recording: Recording
    rows: slice
    export: Mapping[str, Array]
    plant: Mapping[str, Array]


def replay(
    plant: Plant,
    simulation: Simulation,
    recordings: Sequence[Recording],
    noise: Mapping[str, float],
    resolution: float = 0.0,
) -> Replay:
    """Run and compare.

    Args:
        noise: signal → standard deviation of its sensor, where it is known.
        resolution: relative rounding of the numbers of the export (:attr:`sysid.export.target.Target.resolution`).

    Raises:
        ExcitationError: no recording has commands of all axes together.
    """
    model = compile_plant(plant)
    runs = [run for recording in recordings if (run := run_both(plant, model, simulation, recording)) is not None]
    if not runs:
        found = f"no stretch in {len(recordings)} recordings has commands and positions of all axes"
        raise ExcitationError(f"replay of {plant.reference or plant.machine.name}", found, "a recording to replay")
    signals = [name for name in runs[0].plant if all(name in run.export for run in runs)]
    seconds = sum((run.rows.stop - run.rows.start) / run.recording.rate_hz for run in runs)
    rounding = roundings(plant, resolution)
    rows = tuple(_row(model, name, runs, noise.get(name, np.nan), rounding.get(name, ROUNDING)) for name in signals)
    return Replay(tuple(run.recording.name for run in runs), seconds, rows)


def roundings(plant: Plant, resolution: float) -> dict[str, float]:
    """Signal → largest difference that rounded frames of the links make at the end effector and the tool [m].

    A frame is a translation and a unit quaternion, both rounded by r/2 of their length, r the ``resolution``. The second turns
    all that follows by at most r and stretches it by at most r. A point no farther than L from a frame is therefore moved by
    at most (½ + 1 + 1)·r·L by each frame; a joint has two, and the base is another joint.
    """
    kinematics = plant.machine.kinematics()
    if kinematics is None:
        return {}
    steps = [joint.origin[:3, 3] for joint in kinematics.chain]
    travel = [max(map(abs, filter(math.isfinite, axis.limits or ())), default=0.0) for axis in plant.machine.axes
              if axis.joint is not None and kinematics.is_prismatic(axis.joint)]  # fmt: skip
    size = float(sum(map(np.linalg.norm, [*steps, base_pose(plant)[1], tip_offset(plant, kinematics)])) + sum(travel))
    bound = max(ROUNDING, 2.5 * resolution * size * 2 * (len(steps) + 1))
    return {signal: bound for point in ("ee", "tool") for signal in point_signals(point)}


def run_both(plant: Plant, model: Model, simulation: Simulation, recording: Recording) -> Run | None:
    """Export and plant over the longest stretch of a recording with commands of all axes; None where there is none."""
    commands = held_commands(plant.machine, recording)
    drive, joints, _ = true_run(model, recording)
    here = ~np.isnan(np.column_stack([commands, drive])).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(np.int8))).reshape(-1, 2)
    if not len(edges):
        return None
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    moved = np.where(np.isnan(joints[first]), 0.0, joints[first])
    start = Start(moved, drive[first], commands[first], _speeds(model, recording, int(first)))
    steps = step_commands(plant.machine, commands[first:last])
    export = [simulation.reset(start), *(simulation.step(command) for command in steps)]
    stepper = Stepper(plant, recording.rate_hz)
    begin = stepper.reset(start.joints, drive=start.drive, commands=start.commands, speed=start.speeds)
    states = [begin, *(stepper.step(command) for command in steps)]
    lanes = (SimpleNamespace(**{key: getattr(state, key)[0] for key in ("drive", "joints", "ee", "tool")}) for state in states)
    ours = [true_signals(plant, lane) for lane in lanes]
    return Run(recording, slice(int(first), int(last)), _columns(export), _columns(ours))


def _speeds(model: Model, recording: Recording, row: int) -> Array:
    """Speeds of the drives (A,) at a row of the free run; zero where no force moves them or no motion is certain there."""
    starts = start_states(model, recording)
    states = begin_states(starts, run_steps(model, recording, starts, row)[1], row)[0]
    rest = replace(recording, table=recording.table.iloc[row:].reset_index(drop=True))
    moving = [axis.actuation == "force" and joint_start(rest, axis.driven).speed != 0.0 for axis in model.machine.axes]
    return np.where(moving, np.nan_to_num(states[:, STATE.speed]), 0.0)


def _columns(rows: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _row(model: Model, signal: str, runs: Sequence[Run], noise: float, rounding: float) -> ReplayRow:
    away = np.concatenate([run.export[signal] - run.plant[signal] for run in runs])
    motion = float(np.sqrt(np.mean(np.concatenate([run.plant[signal] - run.plant[signal].mean() for run in runs]) ** 2)))
    errors = []
    for side in ("export", "plant"):
        parts = []
        for run in runs:
            read = model.sensed(model.theta[None], signal, getattr(run, side)[signal][None], 1.0 / run.recording.rate_hz)[0]
            parts.append(read - run.recording.values(signal)[run.rows])
        whole = np.concatenate(parts)
        errors.append(float(np.sqrt(np.nanmean(whole**2))) if not np.isnan(whole).all() else float("nan"))
    allowed = float(np.nanmax([SHARE * motion, noise, rounding]))
    return ReplayRow(signal, errors[0], errors[1], noise, float(np.sqrt(np.mean(away**2))), allowed, motion)


#: Length of a run from a measured state, and time between their starts [s].
RUN, EVERY = 0.1, 1.0
#: Speed of an axis below which its dry friction is not determined, as a share of the RMS speed.
SLIDES = 0.1


@dataclass(frozen=True)
class Compared:
    """One signal in one recording (m,) each: by the export, by the plant, and measured."""

    export: Array
    plant: Array
    measured: Array


def force_replay(
    plant: Plant, simulation: ForceSimulation, recordings: Sequence[Recording], noise: Mapping[str, float]
) -> Replay:
    """Compare forces at measured motion, and the end effector.

    Args:
        noise: signal → standard deviation of its sensor, where it is known.

    Raises:
        ExcitationError: no recording has motion and forces of all axes.
    """
    model, parts, used = compile_plant(plant), dict[str, list[Compared]](), list[Recording]()
    runs = list[Array]()
    for recording in recordings:
        motion = link_motion(model, recording)
        if motion is None:
            continue
        used.append(recording)
        forces = simulation.forces(*motion)
        runs.append(_run_differences(model, simulation, recording, motion))
        for i, axis in enumerate(plant.machine.axes):
            inputs = force_inputs(recording, axis)
            ours = inputs.model_force(model, model.theta[None], axis.name)[0]
            parts.setdefault(axis_signal(axis.name, "command"), []).append(
                Compared(_filtered(inputs, forces[:, i]), ours, inputs.force)
            )
        for signal_name, compared in _tips(model, simulation, recording, motion[0]).items():
            parts.setdefault(signal_name, []).append(compared)
    if not used:
        found = f"no recording of {len(recordings)} measures all joints"
        raise ExcitationError(f"replay of {plant.reference or plant.machine.name}", found, "a recording to replay")
    seconds = sum(len(recording) / recording.rate_hz for recording in used)
    forward = {axis_signal(n, "command"): x for n, x in zip(plant.machine.axis_names, np.concatenate(runs).T, strict=True)}
    rows = tuple(
        _force_row(name, compared, noise.get(name, np.nan), _rms(forward[name]) if name in forward else 0.0)
        for name, compared in parts.items()
    )
    return Replay(tuple(recording.name for recording in used), seconds, rows, "forces")


def _filtered(inputs: ForceInputs, force: Array) -> Array:
    """A force on all rows (n,) as it enters the comparison: the measured one where friction is not determined."""
    whole = np.where(inputs.rests, inputs.raw, force)
    return np.asarray(signal.sosfiltfilt(inputs.low_pass, whole)[inputs.rows])


def _run_differences(
    model: Model, simulation: ForceSimulation, recording: Recording, motion: tuple[Array, Array, Array]
) -> Array:
    """Recorded commands less the forces that the plant needs for the motion under them, (n, A); NaN where an axis rests."""
    rate, names = recording.rate_hz, model.machine.axis_names
    commands = np.column_stack([recording.values(axis_signal(name, "command")) for name in names])
    length, step = max(2, round(RUN * rate)), max(1, round(EVERY * rate))
    slow = SLIDES * np.sqrt(np.mean(motion[1] ** 2, axis=0))
    ends = np.array([(-np.inf, np.inf) if axis.limits is None else axis.limits for axis in model.machine.axes])
    found = [np.empty((0, len(names)))]
    for first in range(0, len(recording) - length, step):
        held = commands[first : first + length]
        if np.isnan(held).any():
            continue
        q, v, a = simulation.run(motion[0][first], motion[1][first], held)
        away = held - arm_forces(model, model.theta, q, v, a, 1.0 / rate)
        away[((q <= ends[:, 0]) | (q >= ends[:, 1])).any(axis=1)] = np.nan  # an end stop bears forces
        found.append(np.where(np.abs(v) > slow, away, np.nan))
    return np.concatenate(found)


def _tips(model: Model, simulation: ForceSimulation, recording: Recording, joints: Array) -> dict[str, Compared]:
    """The end effector at smoothed joints."""
    names = [axis_signal(name, "joint") for name in model.machine.axis_names]
    table = recording.table.assign(**dict(zip(names, joints.T, strict=True)))
    smooth = Recording(recording.name, table, recording.rate_hz)
    ours, theirs = model.tip(model.theta[None], smooth)[0], simulation.tips(joints)
    signals = point_signals("ee")
    return {name: Compared(theirs[:, k], ours[:, k], recording.values(name)) for k, name in enumerate(signals)}


def _force_row(name: str, compared: Sequence[Compared], noise: float, forward: float) -> ReplayRow:
    """``forward``: RMS difference of the runs; NaN without any."""
    export, plant, measured = (np.concatenate([getattr(c, key) for c in compared]) for key in ("export", "plant", "measured"))
    motion = float(np.sqrt(np.mean(np.concatenate([c.plant - c.plant.mean() for c in compared]) ** 2)))
    errors = [_rms(side - measured) for side in (export, plant)]
    allowed = float(np.nanmax([SHARE * motion, noise, ROUNDING]))
    return ReplayRow(name, errors[0], errors[1], noise, float(np.fmax(_rms(export - plant), forward)), allowed, motion)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if not np.isnan(values).all() else float("nan")
