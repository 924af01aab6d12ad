"""Free run of a plant: the whole chain from the commands of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.plant import axis_run, layout, servo_arm, servo_axis
from sysid.plant.machine_run import run_machine
from sysid.plant.model import SETTLE_WINDOW, Model, compile_plant
from sysid.plant.plant import Plant
from sysid.plant.residual import ResidualStage, check_step, new_memory
from sysid.plant.servo_series import servo_begins
from sysid.plant.stretches import Segments, common_stretches
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
        if not np.isnan(joints[:, i]).all():
            columns[signal] = model.sensed(theta, signal, joints[None, :, i], dt)[0]
        speed = axis_signal(axis.name, "speed")
        if speed in recording.signals:
            driven = drive if axis.drives == "cylinder" else joints
            columns[speed] = model.sensed_rate(theta, axis.name, driven[None, :, i], recording.rate_hz)[0]
    if not np.isnan(tip).all():
        points = {"ee": tip}
        if model.has_tool(model.theta, recording):
            measured = model.true_point(theta, recording, "tool")
            points["tool"] = model.tool_motion(theta, tip[None], measured, recording.rate_hz)[0]
        for point, values in points.items():
            for c, signal in enumerate(point_signals(point)):
                columns[signal] = model.sensed(theta, signal, values[None, :, c], dt)[0]
    return pd.DataFrame({name: np.ascontiguousarray(values) for name, values in columns.items()})


def true_run(model: Model, recording: Recording) -> tuple[Array, Array, Array]:
    """True drives (n, A), joints (n, A) and end effector (n, 3), without sensors."""
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
    return StartStates(edges, states, np.column_stack([model.held(recording, name)[0] for name in names]))


def run_steps(
    model: Model, recording: Recording, starts: StartStates, count: int
) -> tuple[tuple[Array, Array, Array], MachineState]:
    """The first ``count`` samples of a free run, as of :func:`true_run`, and the state after them."""
    dt = 1.0 / recording.rate_hz
    drive, joints, tip = np.empty((count, model.axes)), np.empty((count, model.axes)), np.empty((count, 3))
    check_step(model.residuals, dt)
    networks = None if model.nets is None else new_memory(model.nets)
    memory, load = np.full(model.axes * starts.states.shape[2], np.nan), np.zeros(model.axes)
    run_machine(
        model.theta, model.arrays, starts.commands[: count + 1], starts.edges, starts.states, dt, drive, joints, tip, memory,
        load, servo_arm.workspace(model.arrays), model.nets, networks,
    )  # fmt: skip
    return (drive, joints, tip), MachineState(memory, load, networks)


@dataclass(frozen=True)
class MachineState:
    """All axes at a sample: ``memory`` (A · size,), gravity ``load`` (A,), memory of the residual networks (R, M)."""

    memory: Array
    load: Array
    networks: Array | None
