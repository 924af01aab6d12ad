"""Free run of a force-driven model: MuJoCo integrates the recorded commands, from measured positions and speeds.

A small constant error of a torque is within the noise of the forces and moves the joints all the same, because the run
integrates it. The error of the free run therefore decides about parameters that the forces hardly determine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.errors import InputError
from sysid.gap.adapters.adapter import stretches_of
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.adapters.simulator import RunCache, command_signals
from sysid.gap.localise import run_rmse
from sysid.plant import Plant, compile_plant
from sysid.plant.stretches import held
from sysid.signals import axis_signal, split_signal


def free_run_errors(
    path: Path,
    plant: Plant,
    recordings: Sequence[Recording],
    constants: Mapping[str, float] | None = None,
    assets: Sequence[Path] = (),
) -> dict[str, float]:
    """Joint signal → RMSE [rad or m] of the free run of an MJCF, pooled over recordings.

    The model is restarted after gaps in the commands. Recordings without commands of all axes are not run.

    Args:
        plant: of the model; its axes are those of the recordings.
        constants: axis → force constant of the model relative to the recorded commands; 1 where it is absent.
        assets: further folders below which the model may open files.

    Returns:
        Empty where no recording has commands of all axes; NaN where the run diverges.
    """
    machine, model = plant.machine, compile_plant(plant)
    runs, constants = RunCache(MujocoSimulator(path, machine, tuple(assets)), machine), constants or {}
    joints = [axis_signal(name, "joint") for name in machine.axis_names]
    found = list[tuple[Recording, pd.DataFrame]]()
    for recording in recordings:
        stretches = stretches_of(model, recording)
        if len(command_signals(recording, machine)) < len(machine.axes) or not len(stretches):
            continue
        commands = {
            signal: held(recording.values(signal), recording.rate_hz)[0][None] / constants.get(split_signal(signal)[0], 1.0)
            for signal in command_signals(recording, machine)
        }
        try:
            (signals,) = runs.of(recording, commands, stretches)
        except InputError:
            return dict.fromkeys(joints, np.nan)
        found.append((recording, pd.DataFrame({signal: signals[signal] for signal in joints})))
    return run_rmse(found)
