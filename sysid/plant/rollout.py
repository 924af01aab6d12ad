"""Free run of a plant: the whole chain from the commands of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.chunked import copied, measured
from sysid.datasets.recording import Recording
from sysid.plant import axis_run, layout, servo_arm, servo_axis
from sysid.plant.machine_run import run_machine
from sysid.plant.model import SETTLE_WINDOW, Model, compile_plant
from sysid.plant.plant import Plant
from sysid.plant.residual import ResidualStage, check_step, new_memory
from sysid.plant.servo_series import servo_begins
from sysid.plant.stretches import Segments, common_stretches
from sysid.scratch import empty, pieces, put
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


def free_run(plant: Plant | Model, recording: Recording) -> pd.DataFrame:
    """The whole chain from recorded commands, restarted only after gaps in the commands.

    Start states are estimated from the first seconds of the measurement (:mod:`sysid.plant.axis_start`).

    Returns:
        ``time`` and one column for each signal that the plant can predict, on the recording's rows, as its sensors read it;
        the speed of an axis where the recording contains it.
    """
    model = plant if isinstance(plant, Model) else compile_plant(plant)
    theta, dt = model.theta[None], 1.0 / recording.rate_hz
    drive, joints, tip = true_run(model, recording)
    columns: dict[str, Array] = {"time": recording.values("time")}
    for i, axis in enumerate(model.machine.axes):
        signal = axis_signal(axis.name, "joint")
        if axis.drives == "cylinder":
            columns[axis.driven] = model.sensed(theta, axis.driven, drive[None, :, i], dt)[0]
        if measured(joints[:, i]):
            columns[signal] = model.sensed(theta, signal, joints[None, :, i], dt)[0]
        speed = axis_signal(axis.name, "speed")
        if speed in recording.signals:
            driven = drive if axis.drives == "cylinder" else joints
            columns[speed] = model.sensed_rate(theta, axis.name, driven[None, :, i], recording.rate_hz)[0]
    if model.posed and not np.isnan(tip).all():
        points = {"ee": tip}
        if model.has_tool(model.theta, recording):
            tool = model.true_point(theta, recording, "tool")
            points["tool"] = model.tool_motion(theta, tip[None], tool, recording.rate_hz)[0]
        for point, values in points.items():
            for c, signal in enumerate(point_signals(point)):
                columns[signal] = model.sensed(theta, signal, values[None, :, c], dt)[0]
    return pd.DataFrame({k: v if v.flags.c_contiguous else copied(v) for k, v in columns.items()}, copy=False)


def true_run(model: Model, recording: Recording) -> tuple[Array, Array, Array]:
    """True drives (n, A), joints (n, A) and end effector (n, 3), without sensors; NaN without kinematics."""
    return run_steps(model, recording, start_states(model, recording), len(recording))[0]


@dataclass(frozen=True)
class StartStates:
    """Start states of the axes of a free run, after each gap of their commands.

    Args:
        edges: (A, m, 2) first and last+1 sample of each stretch, in order; beyond the last one the number of samples.
        states: (A, m, size) state of the axis before the first sample of the stretch.
        commands: (n, A), short gaps held.
    """

    edges: Segments
    states: Array
    commands: Array

    def since(self, first: int) -> tuple[Segments, Array]:
        """Edges and states of the stretches that do not end before sample ``first``, which is number 0 of the edges."""
        number = np.count_nonzero(self.edges[:, :, 1] < first, axis=1)  # of those that do
        left = np.minimum(number[:, None] + np.arange(self.edges.shape[1] - number.min()), self.edges.shape[1] - 1)
        axes = np.arange(len(left))[:, None]
        return np.ascontiguousarray(self.edges[axes, left] - first), np.ascontiguousarray(self.states[axes, left])


def start_states(model: Model, recording: Recording) -> StartStates:
    """Start states of a free run, estimated from the first seconds of each stretch."""
    names, dt = model.machine.axis_names, 1.0 / recording.rate_hz
    stretches = [model.held(recording, name)[1] for name in names]
    if model.coupled:
        stretches = [common_stretches(stretches, len(recording))] * model.axes
    rows = max(1, *(len(part) for part in stretches))
    edges = np.full((model.axes, rows, 2), len(recording), dtype=np.int64)
    states = np.full((model.axes, rows, layout.axis_memory(dt)), np.nan)
    theta = model.theta[None]
    share, load = model.share(theta, recording, SETTLE_WINDOW)[0], model.load(theta, recording, SETTLE_WINDOW)
    for i, (axis, segments) in enumerate(zip(model.machine.axes, stretches, strict=True)):
        edges[i, : len(segments)] = segments
        if model.coupled:
            places, speeds = servo_begins(model.machine, model.arrays, model.theta, recording)
            own = (np.ascontiguousarray(part[:, i]) for part in (places, speeds))
            servo_axis.starts_of(model.theta, model.arrays, i, *own, segments, dt, states[i])
            continue
        if model.rigid is not None and axis.actuation == "force":  # no forward dynamics of an arm: no free run
            continue
        stage: ResidualStage = "force" if axis.actuation == "force" else "command"
        driven, joint = (model.true_signal(theta, recording, s)[0] for s in (axis.driven, axis_signal(axis.name, "joint")))
        axis_run.find_starts(
            model.theta, model.arrays, i, model.held(recording, axis.name)[0], driven, joint, load[i], share, segments, dt,
            model.window(recording), round(SETTLE_WINDOW / dt), states.shape[2], states[i],
            model.stage_net(stage, axis.name, model.residual_commands(stage, axis.name, recording)),
        )  # fmt: skip
    commands, held = empty(len(recording) * model.axes), [model.held(recording, name)[0] for name in names]
    for first, last in pieces(len(recording)):
        put(commands, first * model.axes, np.column_stack([values[first:last] for values in held]).ravel())
    return StartStates(edges, states, commands.reshape(-1, model.axes))


def run_steps(
    model: Model, recording: Recording, starts: StartStates, count: int
) -> tuple[tuple[Array, Array, Array], MachineState]:
    """The first ``count`` samples of a free run, as of :func:`true_run`, and the state after them."""
    dt, axes = 1.0 / recording.rate_hz, model.axes
    check_step(model.residuals, dt)
    networks = None if model.nets is None else new_memory(model.nets)
    memory, load, servos = np.full(axes * starts.states.shape[2], np.nan), np.zeros(axes), servo_arm.workspace(model.arrays)
    runs = [empty(count * width) for width in (axes, axes, 3 if model.posed else 0)]
    for first, last in pieces(count):
        drive, joints, tip = (np.empty((last - first, width)) for width in (axes, axes, 3))
        run_machine(
            model.theta, model.arrays, starts.commands[first : last + 1], *starts.since(first), dt, drive, joints,
            tip, memory, load, servos, model.nets, networks,
        )  # fmt: skip
        for run, part in zip(runs, (drive, joints, tip), strict=True):
            if len(run):
                put(run, first * part.shape[1], part.ravel())
    points = runs[2].reshape(-1, 3) if model.posed else np.broadcast_to(np.nan, (count, 3))
    return (runs[0].reshape(-1, axes), runs[1].reshape(-1, axes), points), MachineState(memory, load, networks)


@dataclass(frozen=True)
class MachineState:
    """All axes at a sample: ``memory`` (A · size,), gravity ``load`` (A,), memory of the residual networks (R, M)."""

    memory: Array
    load: Array
    networks: Array | None
