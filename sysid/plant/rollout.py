"""What a plant predicts for a recording: the whole chain, free-running from its commands."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.plant.model import compile_plant, measured_point
from sysid.plant.plant import Plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


def free_run(plant: Plant, recording: Recording) -> pd.DataFrame:
    """The whole chain from recorded commands, restarted only after gaps in the commands.

    Returns:
        ``time`` and one column for each signal the plant can predict, on the recording's rows.
    """
    model = compile_plant(plant)
    theta = model.theta[None]
    columns: dict[str, Array] = {"time": recording.values("time")}
    joints = np.full((len(recording), model.axes), np.nan)
    for i, axis in enumerate(model.machine.axes):
        drive, behind_play = model.drive(theta, recording, axis.name)
        joint_signal = axis_signal(axis.name, "joint")
        if axis.drives == "joint":
            joints[:, i] = behind_play[0]
        else:
            columns[axis.driven] = drive[0]
            if axis.name in model.tables:
                joints[:, i] = model.joint(theta, drive[0], recording.values(joint_signal), axis.name, recording.rate_hz)[0]
        if not np.isnan(joints[:, i]).all():
            columns[joint_signal] = joints[:, i]
    if model.chain is not None and not np.isnan(joints).any(axis=1).all():
        ee = model.tip(theta, joints)[0]
        _add_point(columns, "ee", ee)
        if model.machine.tool is not None:
            _add_point(columns, "tool", model.tool(theta, ee, measured_point(recording, "tool"), recording.rate_hz)[0])
    return pd.DataFrame(columns)


def _add_point(columns: dict[str, Array], point: str, values: Array) -> None:
    for k, signal in enumerate(point_signals(point)):
        columns[signal] = values[:, k]
