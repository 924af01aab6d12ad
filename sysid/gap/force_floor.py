"""Noise floor of a force axis, at most what its recordings leave.

The floor is propagated from the noise of the sensors. An estimate of that noise may contain more than noise (vibration, jitter
of stamps), and then hides effects. A regression of the force on friction, inertia and every smooth function of the discrepancy
leaves the noise and what these functions lack: its residual is an upper bound of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.arm.forces import friction_columns
from sysid.gap.likelihood.discrepancy.drives import force_columns
from sysid.gap.problem import Problem
from sysid.gap.thresholds import EXPLAINED
from sysid.plant import Model
from sysid.plant.force import force_inputs
from sysid.plant.link_torque import link_torque

Array = npt.NDArray[np.float64]

#: Rows for each column at least.
ROWS_PER_COLUMN = 4
#: Residual that is rounding [share of the error]: the columns contain all of it, where the logged force is constant.
ROUNDING = 1e-9


def shown_floor(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array, sigma: Array) -> Array:
    """The noise floor ``sigma`` (1,) of a force stage [N or N·m]; less where the recordings leave clearly less.

    Args:
        theta: vector of the plant, the links of an arm adjusted.
    """
    axis = model.machine.axis(problem.target)
    smooth = force_columns(model, axis, recordings, problem, theta)
    columns, target = list[Array](), list[Array]()
    for recording in recordings:
        inputs = force_inputs(recording, axis, problem.force_filter, problem.rows(recording))
        load = link_torque(model, theta, recording, axis.name).carried
        rigid = inputs.compared(friction_columns(inputs.speed, inputs.acceleration, load))
        moving = ~inputs.rests[inputs.rows]  # at rest the measured force stands for the model's, and leaves nothing
        columns.append(np.hstack([rigid, *(part[:, :, 0] for part in smooth(recording).values())])[moving])
        target.append((problem.measured(recording) - problem.predict(theta[None], recording)[0])[moving, 0])
    table, force = np.concatenate(columns), np.concatenate(target)
    if len(force) < ROWS_PER_COLUMN * table.shape[1]:
        return sigma
    size = np.maximum(np.linalg.norm(table, axis=0), 1e-12)
    found, _, rank, _ = np.linalg.lstsq(table / size, force, rcond=1e-9)
    left = force - table / size @ found
    bound = float(np.sqrt(left @ left / (len(force) - int(rank))))
    least = ROUNDING * float(np.sqrt(np.mean(force**2)))
    return np.array([bound]) if least < bound and bound * EXPLAINED < float(sigma[0]) else sigma
