"""Contribution of each stage and axis to the error of a free run.

Starting from measured signals, one stage after the other is simulated, the last of the chain first. The prediction moves by dₖ
each time, and Σ dₖ is the total error e. The share of a stage is ⟨e·dₖ⟩ / ⟨e·e⟩. Shares add up to one; a negative share belongs
to a stage whose error compensates for another's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.result import Share
from sysid.machine import Axis
from sysid.plant import Model, free_run
from sysid.plant.model import measured_point
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
#: (stage, target) → change of the prediction (n, d) when that stage is simulated too.
Moves = dict[tuple[str, str], Array]


def shares_of(model: Model, recordings: Sequence[Recording]) -> tuple[Share, ...]:
    """Shares in the errors of the tool, the tip, and every joint behind a cylinder, where they are measured.

    Rows with a missing value along the chain are left out.
    """
    parts: dict[str, list[Moves]] = {}
    for recording in recordings:
        for end, moves in _moves(model, recording).items():
            parts.setdefault(end, []).append(moves)
    found: list[Share] = []
    for end, of_recordings in parts.items():
        keys = list(dict.fromkeys(key for moves in of_recordings for key in moves))
        whole = [moves for moves in of_recordings if len(moves) == len(keys)]
        if not whole:
            continue
        d = {key: np.concatenate([moves[key] for moves in whole]) for key in keys}
        there = np.all([np.isfinite(part).all(axis=1) for part in d.values()], axis=0)
        if not there.any():
            continue
        error = np.sum([part[there] for part in d.values()], axis=0)
        total = float(np.sum(error**2))
        found += [
            Share(
                end, stage, target,
                float(np.sum(error * part[there])) / total if total > 0.0 else 0.0,
                float(np.sqrt(np.sum(part[there] ** 2) / there.sum())),
                float(np.sqrt(total / there.sum())),
            )
            for (stage, target), part in d.items()
        ]  # fmt: skip
    return tuple(found)


def _moves(model: Model, recording: Recording) -> dict[str, Moves]:
    """End of the chain (``tool``, ``ee``, or the joint of an axis) → moves of its stages."""
    run = free_run(model, recording)
    ends: dict[str, Moves] = {}
    for axis in model.machine.axes:
        joint = axis_signal(axis.name, "joint")
        if axis.drives == "cylinder" and axis.name in model.linked and joint in run and _any(recording, axis.driven, joint):
            ends[joint] = _joint_moves(model, recording, run, axis)
    joints = [axis_signal(name, "joint") for name in model.machine.axis_names]
    if model.posed and set(joints) <= set(run) and _any(recording, *joints, *point_signals("ee")):
        tool = model.has_tool(model.theta, recording) and _any(recording, *point_signals("ee"), *point_signals("tool"))
        for point in ("ee", "tool") if tool else ("ee",):
            ends[point] = _point_moves(model, recording, run, point)
    return ends


def _joint_moves(model: Model, recording: Recording, run: pd.DataFrame, axis: Axis) -> Moves:
    joint = axis_signal(axis.name, "joint")
    driven = model.joint(model.theta[None], recording, axis.name)[0]
    return {
        ("joint", axis.name): (driven - recording.values(joint))[:, None],
        ("command", axis.name): (run[joint].to_numpy(dtype=np.float64) - driven)[:, None],
    }


def _point_moves(model: Model, recording: Recording, run: pd.DataFrame, point: str) -> Moves:
    theta = model.theta[None]
    moves: Moves = {}
    last = measured_point(recording, point)

    def predicted(known: Recording) -> Array:
        tip = model.tip(theta, known)
        if point == "ee":
            return np.asarray(tip[0])
        return np.asarray(model.tool(theta, _with(known, dict(zip(point_signals("ee"), tip[0].T, strict=True))))[0])

    def put(key: tuple[str, str], now: Array) -> None:
        nonlocal last
        moves[key] = now - last
        last = now

    if point == "tool":
        put(("tool", "tool"), np.asarray(model.tool(theta, recording)[0]))
    put(("end_effector", "ee"), predicted(recording))
    known = recording
    for axis in model.machine.axes:
        joint = axis_signal(axis.name, "joint")
        if axis.drives == "cylinder" and axis.name in model.linked and _any(recording, axis.driven, joint):
            known = _with(known, {joint: model.joint(theta, recording, axis.name)[0]})
            put(("joint", axis.name), predicted(known))
    for axis in model.machine.axes:
        joint = axis_signal(axis.name, "joint")
        known = _with(known, {joint: run[joint].to_numpy(dtype=np.float64)})
        put(("command", axis.name), predicted(known))
    return moves


def _with(recording: Recording, columns: dict[str, Array]) -> Recording:
    return replace(recording, table=recording.table.assign(**columns))


def _any(recording: Recording, *signals: str) -> bool:
    there = np.all([np.isfinite(recording.values(name)) for name in signals], axis=0)
    return bool(there.sum() >= 50)
