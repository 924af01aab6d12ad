"""The discrepancy of a stage: columns of its basis functions, group by group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.likelihood.discrepancy.drives import force_columns, servo_columns, velocity_columns
from sysid.gap.likelihood.discrepancy.geometry import joint_columns, tip_columns, tool_columns
from sysid.gap.likelihood.rows import StageRows, bin_means
from sysid.gap.stage_kind import FORCE, JOINT, POSITION, SERVO, SPEED, TIP, TOOL
from sysid.plant import Model

Array = npt.NDArray[np.float64]

#: (model, problem, recordings, θ) → recording → group → columns on the rows that the problem measures, (n, m, d).
COLUMNS = {
    SPEED: velocity_columns,
    POSITION: servo_columns,
    SERVO: servo_columns,
    FORCE: force_columns,
    JOINT: joint_columns,
    TIP: tip_columns,
    TOOL: tool_columns,
}


@dataclass(frozen=True)
class Discrepancy:
    """Columns of a discrepancy.

    Args:
        columns: (rows, m), unit of the output for a coefficient of one; in single precision, the largest table of a stage.
        group: index in ``groups`` of each column, (m,).
        timing: change of the output by an error of timing of one standard deviation, (rows,).
    """

    columns: npt.NDArray[np.float32]
    group: npt.NDArray[np.int64]
    groups: tuple[str, ...]
    timing: Array


def timing_alone(rows: StageRows, timing: float) -> Discrepancy:
    """No discrepancy but the error of timing; ``timing``: its standard deviation [s]."""
    late = np.zeros(rows.count)
    for k, s in enumerate(rows.series):
        moves = rows.recordings[k // len(rows.problem.signals)].kind == "motion"
        late[s.rows] = timing * _slope(s.measured, s.time) if moves else 0.0
    return Discrepancy(np.zeros((rows.count, 0), np.float32), np.zeros(0, dtype=np.int64), (), late)


def discrepancy_of(model: Model, rows: StageRows, theta: Array, timing: float) -> Discrepancy:
    """The columns of a stage, with the dead time and lag of ``theta``; ``timing``: standard deviation of its error [s]."""
    problem = rows.problem
    make = COLUMNS[problem.kind](model, problem, rows.recordings, theta)
    groups, sizes = tuple[str, ...](), list[int]()
    table = np.empty((rows.count, 0), np.float32)
    at = 0
    signals = len(problem.signals)
    for recording in rows.recordings:
        columns = make(recording)
        if not at:
            groups, sizes = tuple(columns), [values.shape[1] for values in columns.values()]
            table = np.empty((rows.count, sum(sizes)), np.float32)
        width = rows.series[at].width
        first = 0
        for name, size in zip(groups, sizes, strict=True):
            means = np.nan_to_num(bin_means(np.moveaxis(columns[name], 1, 0), width))  # (m, bins, d)
            for k in range(signals):
                table[rows.series[at + k].rows, first : first + size] = means[:, :, k].T
            first += size
        at += signals
    return Discrepancy(table, np.repeat(np.arange(len(groups)), sizes), groups, timing_alone(rows, timing).timing)


def _slope(output: Array, time: Array) -> Array:
    there = ~np.isnan(output)
    if there.sum() < 3:
        return np.zeros(len(output))
    return np.asarray(np.gradient(np.interp(time, time[there], output[there]), time))
