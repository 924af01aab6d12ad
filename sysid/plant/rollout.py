"""What a plant predicts for a recording: the whole chain, free-running from its commands."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.plant import axis_run, layout
from sysid.plant.machine_run import run_machine
from sysid.plant.model import SETTLE_WINDOW, Model, compile_plant
from sysid.plant.plant import Plant
from sysid.plant.residual import Place, check_step, memory_of
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


def free_run(plant: Plant | Model, recording: Recording) -> pd.DataFrame:
    """The whole chain from recorded commands, restarted only after gaps in the commands.

    Returns:
        ``time`` and one column for each signal the plant can predict, on the recording's rows, as its sensors would read it.
    """
    model = plant if isinstance(plant, Model) else compile_plant(plant)
    theta, dt = model.theta[None], 1.0 / recording.rate_hz
    drive, joints, tip = true_run(model, recording)
    columns: dict[str, Array] = {"time": recording.values("time")}
    for i, axis in enumerate(model.machine.axes):
        signal = axis_signal(axis.name, "joint")
        if axis.drives == "cylinder":
            columns[axis.driven] = model.sensed(theta, axis.driven, drive[None, :, i], dt)[0]
        if not np.isnan(joints[:, i]).all():
            columns[signal] = model.sensed(theta, signal, joints[None, :, i], dt)[0]
    if not np.isnan(tip).all():
        points = {"ee": tip}
        if model.has_tool(model.theta, recording):
            measured = model.believed_point(theta, recording, "tool")
            points["tool"] = model.hang(theta, tip[None], measured, recording.rate_hz)[0]
        for point, values in points.items():
            for c, signal in enumerate(point_signals(point)):
                columns[signal] = model.sensed(theta, signal, values[None, :, c], dt)[0]
    return pd.DataFrame({name: np.ascontiguousarray(values) for name, values in columns.items()})


def true_run(model: Model, recording: Recording) -> tuple[Array, Array, Array]:
    """Drives (n, A), joints (n, A), end effector (n, 3), before any sensor reads them."""
    count, dt = len(recording), 1.0 / recording.rate_hz
    stretches = [model.held(recording, name)[1] for name in model.machine.axis_names]
    rows = max(1, *(len(part) for part in stretches))
    edges = np.full((model.axes, rows, 2), count, dtype=np.int64)
    begins = np.full((model.axes, rows, axis_run.START), np.nan)
    share = model.share(model.theta[None], recording, SETTLE_WINDOW)[0]
    load = model.load(model.theta[None], recording, SETTLE_WINDOW)
    for i, part in enumerate(stretches):
        edges[i, : len(part)] = part
        begins[i, : len(part)] = _starts(model, recording, model.machine.axis_names[i], load[i], share)
    commands = np.column_stack([model.held(recording, name)[0] for name in model.machine.axis_names])
    drive, joints, tip = np.empty((count, model.axes)), np.empty((count, model.axes)), np.empty((count, 3))
    check_step(model.residuals, dt)
    memory = None if model.nets is None else memory_of(model.nets)
    run_machine(
        model.theta, model.rig, commands, edges, begins, dt, layout.axis_memory(dt), drive, joints, tip, model.nets, memory
    )
    return drive, joints, tip


def _starts(model: Model, recording: Recording, axis: str, load: Array, share: Array) -> Array:
    """Where a free run of one axis starts after each gap of its command, (m, 3): see :data:`sysid.plant.axis_run.START`."""
    theta, dt = model.theta[None], 1.0 / recording.rate_hz
    i, about = model.axis_index(axis), model.machine.axis(axis)
    command, segments = model.held(recording, axis)
    measured, joint = (model.believed(theta, recording, s)[0] for s in (about.driven, axis_signal(axis, "joint")))
    out = np.empty((len(segments), axis_run.START))
    place: Place = "force" if about.actuation == "force" else "command"
    own = model.own(place, axis, model.in_steps(recording, i) if model.carries(place, axis, dt) else None)
    axis_run.find_starts(
        model.theta, model.rig, i, command, measured, joint, load, share, segments, dt, model.window(recording),
        round(SETTLE_WINDOW / dt), layout.axis_memory(dt), out, own,
    )  # fmt: skip
    return out
