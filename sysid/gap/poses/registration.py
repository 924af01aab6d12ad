"""Registration of a pose set: the frame of the measurement, at which a search linearises first.

The frame of a tracker or a capture system is arbitrary. At the described frame a linearisation has no meaning if the other is
turned by 90° or a metre away, so that the frame is fitted to the described geometry before anything else is compared: from the
closed form for points of equal weight (Arun, Huang, Blostein, IEEE TPAMI 9 (1987), 698–700), then with a loss that a few wrong
poses do not dominate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sysid.gap.candidates import Unknown
from sysid.gap.fit import place
from sysid.gap.poses.rows import PoseRows

Array = npt.NDArray[np.float64]

#: Error from which the loss grows linearly, in noise floors.
LINEAR = 10.0
#: Components of a frame: translation and rotation vector.
FRAME = 6


def registered(rows: PoseRows, unknowns: Sequence[Unknown], nominal: Array) -> Array:
    """Values of the unknowns with the least error of the described geometry, (k,).

    Args:
        unknowns: the six components of the frame first, then others of the measurement.
        nominal: their values in the plant under test.
    """

    def residual(values: Array) -> Array:
        return rows.residual(place(rows.theta, unknowns, values[None])[0])

    def slopes(values: Array) -> Array:
        return np.asarray(-rows.linearised(place(rows.theta, unknowns, values[None])[0], unknowns)[1])

    fits = [
        least_squares(residual, start, slopes, loss="soft_l1", f_scale=LINEAR, x_scale="jac")
        for start in (nominal, np.r_[_closed_form(rows, unknowns, nominal), nominal[FRAME:]])
    ]
    return np.asarray(min(fits, key=lambda fit: float(fit.cost)).x)


def _closed_form(rows: PoseRows, unknowns: Sequence[Unknown], nominal: Array) -> Array:
    """Translation and rotation vector of the frame, (6,), by which predicted points fit measured ones best."""
    predicted = rows.predicted(place(rows.theta, unknowns, np.r_[np.zeros(FRAME), nominal[FRAME:]][None]))[0]
    there = rows.present.all(axis=1)
    if np.count_nonzero(there) < 3:
        return np.asarray(nominal[:FRAME])
    model, measured = predicted[there], rows.output[there]
    turn, _ = Rotation.align_vectors(measured - measured.mean(axis=0), model - model.mean(axis=0))
    return np.asarray(np.r_[measured.mean(axis=0) - turn.apply(model.mean(axis=0)), turn.as_rotvec()])
