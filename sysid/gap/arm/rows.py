"""Forces of a whole arm as rows of a linear regression: torques are linear in the inertial parameters of all links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.datasets.recording import Recording
from sysid.gap.arm.friction import FRICTION, friction_columns
from sysid.machine.rigid_body import CHUNK
from sysid.plant import Model
from sysid.plant.force import force_inputs
from sysid.plant.link_torque import inertial_parameters, link_motion, link_torque

if TYPE_CHECKING:
    from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Seconds of a block of cross-validation, and largest number of blocks.
BLOCK, BLOCKS = 2.0, 60


@dataclass(frozen=True)
class AxisRows:
    """One axis: ``target`` (m,) force, ``links`` (m, 10·B) slopes by inertial parameters, ``friction`` (m, 7), ``block`` (m,).

    The target is the measured force less the torque of the links of the plant under test. Where the sign of friction is
    unknown, all of them are zero before the low-pass.
    """

    axis: str
    target: Array
    links: Array
    friction: Array
    block: npt.NDArray[np.int64]


def axis_rows(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array) -> list[AxisRows]:
    """The rows of every axis of a links problem."""
    rigid = model.rigid
    assert rigid is not None
    names = [signal_name.rpartition(".")[0] for signal_name in problem.signals]
    found: dict[str, list[tuple[Array, Array, Array, Array]]] = {name: [] for name in names}
    begin = 0.0
    for recording in recordings:
        motion = link_motion(model, recording)
        assert motion is not None  # the problem contains such recordings only
        measured, rows = problem.measured(recording), problem.rows(recording)
        inputs = [force_inputs(recording, model.machine.axis(name), rows=rows) for name in names]
        slopes = [np.empty((len(recording), rigid.nominal.size)) for _ in names]
        places = [model.axis_index(name) for name in names]
        for k in range(0, len(recording), CHUNK):
            part = rigid.regressor(*(values[k : k + CHUNK] for values in motion))
            for own, i in zip(slopes, places, strict=True):
                own[k : k + CHUNK] = part[:, i]
        time = begin + rows / recording.rate_hz
        begin += len(recording) / recording.rate_hz
        for j, name in enumerate(names):
            own = inputs[j]
            moving = ~own.rests
            nominal = link_torque(model, theta, recording, name)
            friction = friction_columns(own.speed, own.acceleration, slopes[j] @ inertial_parameters(model, theta).ravel())
            table = np.column_stack([own.raw - nominal, friction, slopes[j]]) * moving[:, None]
            there = ~np.isnan(measured[:, j])
            used = np.flatnonzero(table.any(axis=0))
            filtered = np.zeros((int(there.sum()), table.shape[1]))
            filtered[:, used] = signal.sosfiltfilt(own.low_pass, table[:, used], axis=0)[rows[there]]
            found[name].append((filtered[:, 0], filtered[:, 1 + FRICTION :], filtered[:, 1 : 1 + FRICTION], time[there]))
    whole = max(begin, 1e-9)
    count = max(1, min(BLOCKS, int(whole / BLOCK)))
    rows = []
    for name, parts in found.items():
        target, links, friction, time = (np.concatenate(column) for column in zip(*parts, strict=True))
        rows.append(AxisRows(name, target, links, friction, (time * count / whole).astype(np.int64)))
    return rows


def inefficiency(residual: Array) -> float:
    """Rows per independent row: one plus twice the sum of the autocorrelation up to its first value below zero.

    Source: Chodera et al., J. Chem. Theory Comput. 3 (2007), 26–41 (statistical inefficiency).
    """
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, len(centred) // 4):
        share = float(centred[:-lag] @ centred[lag:]) / power
        if share <= 0.0:
            break
        total += 2.0 * share
    return max(1.0, total)
