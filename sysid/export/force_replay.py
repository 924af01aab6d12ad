"""Replay of an arm: the forces that its export and the plant need for the measured motion of held-out recordings.

An arm under recorded forces does not follow its recorded motion for long, in any simulator: small errors of the forces grow.
Two differences of the forces are therefore computed, and the larger one counts:

- between the forces that both need for the measured motion, under the filter of :mod:`sysid.plant.force`,
- between the recorded commands and the forces that the plant needs for the motion that the export makes of them, in short runs
  from measured positions and speeds. It is that of the equations of motion, whatever the runs do to the posture.

The end effector is compared at the measured joints. The bounds are those of :mod:`sysid.export.replay`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.datasets.recording import Recording
from sysid.errors import ExcitationError
from sysid.export.replay import ROUNDING, SHARE, Replay, ReplayRow
from sysid.export.target import ForceSimulation
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.arm_forces import arm_forces
from sysid.plant.force import ForceInputs, force_inputs
from sysid.plant.link_torque import link_motion
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


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
        _row(name, compared, noise.get(name, np.nan), _rms(forward[name]) if name in forward else 0.0)
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


def _row(name: str, compared: Sequence[Compared], noise: float, forward: float) -> ReplayRow:
    """``forward``: RMS difference of the runs; NaN without any."""
    export, plant, measured = (np.concatenate([getattr(c, key) for c in compared]) for key in ("export", "plant", "measured"))
    motion = float(np.sqrt(np.mean(np.concatenate([c.plant - c.plant.mean() for c in compared]) ** 2)))
    errors = [_rms(side - measured) for side in (export, plant)]
    allowed = float(np.nanmax([SHARE * motion, noise, ROUNDING]))
    return ReplayRow(name, errors[0], errors[1], noise, float(np.fmax(_rms(export - plant), forward)), allowed, motion)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if not np.isnan(values).all() else float("nan")
