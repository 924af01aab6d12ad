"""Discrepancies behind the drives: cylinder → joint, joints → end effector, end effector → hanging tool."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.likelihood.discrepancy.shapes import filled, slope, slow_cosines, smooth, span_of, waves
from sysid.plant import Model, gravity_load
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.signals import axis_signal, point_signals

if TYPE_CHECKING:
    from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]
Make = Callable[[Recording], dict[str, Array]]

#: Step of a joint for its column of the Jacobian [rad].
TURN = 0.01


def joint_columns(model: Model, problem: Problem, recordings: Sequence[Recording], _: Array) -> Make:
    """Cylinder → joint: as a function of the cylinder, of direction, of speed, of load, and of time."""
    i = model.axis_index(problem.target)
    cylinder = axis_signal(problem.target, "cylinder")
    middle, half = span_of(tuple(recordings), cylinder)
    scale = span_of(tuple(recordings), axis_signal(problem.target, "joint"))[1]
    load_of = _loads(model, recordings)

    def columns(recording: Recording) -> dict[str, Array]:
        dt = 1.0 / recording.rate_hz
        c = (filled(recording.values(cylinder)) - middle) / half
        v = slope(recording.values(cylinder), dt) / half if recording.kind == "motion" else np.zeros(len(c))
        time = np.arange(len(c)) * dt
        parts = {
            "position": [np.ones_like(c), c, c * c, c**3, *waves(c, (1.5, 3.0, 4.5, 7.5)).T],
            "direction": [np.tanh(v / 0.02), np.tanh(v / 0.1)],
            "speed": [v, v * np.abs(v), v * c],
            "time": [*slow_cosines(time).T],
        }
        load = load_of(recording)[:, i]
        if load.any():
            parts["load"] = [load, load * load, load * c]
        return {name: scale * np.column_stack(values)[:, :, None] for name, values in parts.items()}

    return columns


def tip_columns(model: Model, _: Problem, recordings: Sequence[Recording], theta: Array) -> Make:
    """Joints → end effector: every joint turned by functions of posture, direction, speed, load and time; the base likewise.

    A joint moves the end effector along its column of the Jacobian, (n, 3), which is computed by the plant.
    """
    names = model.machine.axis_names
    load_of = _loads(model, recordings)
    spans = [span_of(tuple(recordings), axis_signal(name, "joint")) for name in names]
    reach = _reach(recordings)

    def columns(recording: Recording) -> dict[str, Array]:
        n, moving = len(recording), recording.kind == "motion"
        lanes = np.repeat(theta[None], len(names) + 1, axis=0)
        for i in range(len(names)):
            lanes[i + 1, i * AXIS_WIDTH + AT.joint_offset] += TURN
        ends = model.tip(lanes, recording)
        jacobian = np.nan_to_num(ends[1:] - ends[:1]) / TURN  # (A, n, 3)
        joints = [(filled(recording.values(axis_signal(a, "joint"))) - m) / h for a, (m, h) in zip(names, spans, strict=True)]
        speeds = [slope(q, 1.0 / recording.rate_hz) if moving else np.zeros(n) for q in joints]
        loads = load_of(recording)
        time = np.arange(n) / recording.rate_hz if moving else np.zeros(n)
        found: dict[str, list[Array]] = {}
        for k, (q, v, column) in enumerate(zip(joints, speeds, jacobian, strict=True)):
            turns = {
                "position": np.column_stack([np.ones(n), q, q * q, waves(q, (1.5, 3.0, 6.0))]),
                "direction": np.column_stack([np.tanh(v / 0.05), np.tanh(v / 0.2)]),
                "speed": v[:, None],
                "time": slow_cosines(time, 1) if moving and n > 1 else np.zeros((n, 0)),
                "load": loads[:, k : k + 1],
            }
            for name, turn in turns.items():
                found.setdefault(name, []).append(turn[:, :, None] * column[:, None, :])
        first = joints[0]
        frame = np.column_stack([np.ones(n), waves(first * spans[0][1] + spans[0][0], (1.0, 2.0))])
        found["frame"] = [frame[:, :, None] * axis[None, None, :] for axis in reach * np.eye(3)]
        return {name: np.concatenate(parts, axis=1) for name, parts in found.items()}

    return columns


def tool_columns(model: Model, problem: Problem, recordings: Sequence[Recording], _: Array) -> Make:
    """End effector → tool: as functions of place, speed and acceleration of the end effector, and of time."""
    reach = _reach(recordings)

    def columns(recording: Recording) -> dict[str, Array]:
        dt = 1.0 / recording.rate_hz
        ends = np.column_stack([filled(recording.values(s)) for s in problem.inputs])
        v = np.column_stack([slope(x, dt) for x in ends.T])
        a = np.column_stack([np.gradient(smooth(x, round(0.3 / dt)), dt) for x in v.T])
        time = np.arange(len(ends)) * dt
        ones = np.ones(len(ends))
        parts = {
            "position": [ones, *(ends / reach).T],
            "speed": list(v.T / 0.2),
            "acceleration": list(a.T),
            "time": list(slow_cosines(time, 1).T),
        }
        return {
            name: reach * np.concatenate([np.column_stack(values)[:, :, None] * axis for axis in np.eye(3)], axis=1)
            for name, values in parts.items()
        }

    return columns


def _reach(recordings: Sequence[Recording]) -> float:
    """Largest coordinate of the end effector [m]."""
    ends = [np.abs(r.values(s)) for r in recordings for s in point_signals("ee")]
    return max(float(np.nanmax(np.concatenate(ends))), 1e-6)


def _loads(model: Model, recordings: Sequence[Recording]) -> Callable[[Recording], Array]:
    """Gravity loads relative to the largest of each axis, (n, A); zero where an axis' load does not vary."""
    tables = [np.nan_to_num(gravity_load(model.machine, r)) for r in recordings]
    joined = np.concatenate(tables)
    largest, varies = np.abs(joined).max(axis=0), np.ptp(joined, axis=0)
    scale = np.where((largest > 0.0) & (varies > 0.02 * largest), 1.0 / np.maximum(largest, 1e-12), 0.0)
    known = {id(r): table * scale for r, table in zip(recordings, tables, strict=True)}

    def load_of(recording: Recording) -> Array:
        found = known.get(id(recording))
        return found if found is not None else np.nan_to_num(gravity_load(model.machine, recording)) * scale

    return load_of
