"""Forces of a whole arm as rows of a linear regression.

Torques are linear in the inertial parameters of all links, and in proportion to the force constant of each axis. Of this
product the regression contains the terms of first order, about the plant under test or about a plant found before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.arm.friction import FRICTION, friction_columns
from sysid.machine.rigid_body import CHUNK
from sysid.plant import Model
from sysid.plant.force import force_inputs
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.link_torque import inertial_parameters, link_motion, link_torque, rotors_and_scales

if TYPE_CHECKING:
    from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Seconds of a block, whose rows may depend on each other, and largest number of blocks.
BLOCK, BLOCKS = 4.0, 60


@dataclass(frozen=True)
class AxisRows:
    """One axis: ``links`` (m, 10·B) slopes by inertial parameters, ``carried`` (m,) by the relative error of the constant.

    ``rotor`` (m,): inertial force of a rotor with known inertia; ``friction`` (m, 7). ``block`` (m,): number of the block of
    seconds. ``target`` (m,): measured force less the rotor's and the torque of the links of the plant under test, and what the
    linearisation adds. Where the sign of friction is unknown, all columns are zero before the low-pass.
    """

    axis: str
    target: Array
    carried: Array
    rotor: Array
    links: Array
    friction: Array
    block: npt.NDArray[np.int64]


def axis_rows(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array) -> list[AxisRows]:
    """The rows of every axis of a links problem."""
    rigid = model.rigid
    assert rigid is not None
    names = [signal_name.rpartition(".")[0] for signal_name in problem.signals]
    scales = rotors_and_scales(model, theta)[1]
    found: dict[str, list[tuple[Array, ...]]] = {name: [] for name in names}
    begin = 0.0
    for recording in recordings:
        motion = link_motion(model, recording)
        assert motion is not None  # the problem contains such recordings only
        measured, rows = problem.measured(recording), problem.rows(recording)
        inputs = [force_inputs(recording, model.machine.axis(name), rows=rows) for name in names]
        slopes = [np.empty((len(recording), rigid.nominal.size)) for _ in names]
        places = [model.axis_index(name) for name in names]
        for k in range(0, len(recording), CHUNK):
            part = rigid.regressor(*(values[k : k + CHUNK] for values in motion)) * scales[:, None]
            for columns, i in zip(slopes, places, strict=True):
                columns[k : k + CHUNK] = part[:, i]
        time = begin + rows / recording.rate_hz
        begin += len(recording) / recording.rate_hz
        for j, name in enumerate(names):
            own = inputs[j]
            nominal = link_torque(model, theta, recording, name)
            inertia, at = model.machine.axis(name).inertia, places[j] * AXIS_WIDTH + AT.inertia_error
            rotor = (inertia or 0.0) * theta[at] * own.acceleration
            friction = friction_columns(own.speed, own.acceleration, nominal.carried, inertia is not None)
            table = np.column_stack(
                [nominal.constant * own.raw - nominal.whole - rotor, nominal.carried, rotor, friction, slopes[j]]
            )
            there = ~np.isnan(measured[:, j])
            used = np.flatnonzero(table.any(axis=0))
            filtered = np.zeros((int(there.sum()), table.shape[1]))
            filtered[:, used] = own.compared(table[:, used])[there]
            last = 3 + FRICTION
            found[name].append((*filtered[:, :3].T, filtered[:, last:], filtered[:, 3:last], time[there]))
    whole = max(begin, 1e-9)
    count = max(1, min(BLOCKS, int(whole / BLOCK)))
    axes = []
    for name, parts in found.items():
        target, carried, rotor, links, friction, time = (np.concatenate(column) for column in zip(*parts, strict=True))
        axes.append(AxisRows(name, target, carried, rotor, links, friction, (time * count / whole).astype(np.int64)))
    return axes


def with_carried(
    rows: Sequence[AxisRows], model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array
) -> list[AxisRows]:
    """The rows with the friction that grows with the torques of the links of ``theta``."""
    found = list[AxisRows]()
    for j, own in enumerate(rows):
        axis, parts = model.machine.axis(own.axis), list[Array]()
        for recording in recordings:
            there = ~np.isnan(problem.measured(recording)[:, j])
            inputs = force_inputs(recording, axis, rows=problem.rows(recording))
            carried = link_torque(model, theta, recording, own.axis).carried
            columns = friction_columns(inputs.speed, inputs.acceleration, carried, axis.inertia is not None)
            parts.append(inputs.compared(columns)[there])
        found.append(replace(own, friction=np.concatenate(parts)))
    return found


def linearised(rows: Sequence[AxisRows], model: Model, theta: Array, about: Array) -> list[AxisRows]:
    """Rows about the plant under test ``theta``, linearised about another vector instead.

    With slopes L, torque T of the links, change x of inertial parameters and relative error c of the force constant,
    (1 + c)·(T + L·x) ≈ T + (1 + ĉ)·L·x + c·(T + L·x̂) − ĉ·L·x̂: a payload is in proportion to the constant, too.
    """
    change = (inertial_parameters(model, about) - inertial_parameters(model, theta)).reshape(-1)
    ratio = rotors_and_scales(model, about)[1] / rotors_and_scales(model, theta)[1]
    found = list[AxisRows]()
    for own in rows:
        scale, added = float(ratio[model.axis_index(own.axis)]), own.links @ change
        target = own.target + (scale - 1.0) * added
        found.append(replace(own, target=target, carried=own.carried + added, links=scale * own.links))
    return found


def inefficiency(residual: Array, columns: Array, block: npt.NDArray[np.int64]) -> float:
    """Rows per independent row, for the estimate of the coefficients of ``columns`` (m, k): one for white residuals (m,).

    Products of residual and column are summed over blocks of seconds: the ratio of the variance of these sums to that of
    independent rows, mean over the columns (Liang and Zeger, Biometrika 73 (1986), 13–22).
    """
    size = (columns**2).sum(axis=0)
    columns, size = columns[:, size > 0.0], size[size > 0.0]
    power = float(np.mean(residual**2))
    if power <= 0.0 or not len(size):
        return 1.0
    _, number = np.unique(block, return_inverse=True)
    sums = np.zeros((int(number.max()) + 1, columns.shape[1]))
    np.add.at(sums, number, columns * residual[:, None])
    return max(1.0, float(np.mean((sums**2).sum(axis=0) / (power * size))))
