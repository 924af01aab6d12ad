"""The triangle behind a linkage table: levers, offset and retracted length that fit it, where a triangle does."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.machine import TabulatedLinkage
from sysid.machine.description import Linkage
from sysid.machine.linkage import TriangleLinkage

Array = npt.NDArray[np.float64]

#: Largest RMS error of the cylinder displacement, and of the joint, as shares of their ranges, of a table that counts as a
#: triangle: a tenth of what the replay of an export may differ by.
SHARE = 1e-3
#: Start values: both levers in strokes, and the angle between them in the middle of the stroke [rad].
LEVERS, ANGLES = (0.6, 1.5, 4.0), (0.8, 1.5, 2.2)
#: Points of a table that are fitted.
POINTS = 60


def triangle_of(table: TabulatedLinkage) -> Linkage | None:
    """The triangle of a table; None where none fits, or the table runs through its dead centre.

    Fitted is ``length² = a² + b² − 2ab·cos(sense·(q + offset))`` with displacement = length − retracted, in displacements.
    """
    rows = np.linspace(0, len(table.displacements) - 1, POINTS).astype(int)
    x, q = table.displacements[rows], table.joints[rows]
    stroke = float(x[-1] - x[0])
    sense: int = 1 if q[-1] > q[0] else -1
    best: Linkage | None = None
    least = SHARE * stroke
    for a, b, angle in itertools.product(LEVERS, LEVERS, ANGLES):
        start = np.array([a * stroke, b * stroke, angle - sense * q[POINTS // 2], 0.0])
        start[3] = _lengths(start, sense, q)[POINTS // 2] - x[POINTS // 2]
        bounds = (np.array([0.05 * stroke, 0.05 * stroke, -10.0, -100.0 * stroke]), np.full(4, np.inf))
        scale = np.array([stroke, stroke, 1.0, stroke])
        found = least_squares(_misfit, np.maximum(start, bounds[0]), bounds=bounds, x_scale=scale, args=(sense, q, x))
        error = float(np.sqrt(np.mean(found.fun**2)))
        turned = found.x[2] + sense * q
        if error < least and found.x[3] >= 0.0 and turned.min() > 0.0 and turned.max() < np.pi:
            lever, other, turn, retracted = (float(value) for value in found.x)
            least, best = error, Linkage("triangle", lever, other, sense * turn, retracted, sense=1 if sense > 0 else -1)
            if error < 1e-2 * SHARE * stroke:
                break
    if best is None or _joint_error(best, table) > SHARE * float(np.ptp(table.joints)):
        return None
    return best


def _misfit(p: Array, sense: int, q: Array, x: Array) -> Array:
    """Errors of the displacements (n,) [m] for the levers, the angle between them at joint zero, and the retracted length."""
    return np.asarray(_lengths(p, sense, q) - p[3] - x)


def _lengths(p: Array, sense: int, q: Array) -> Array:
    a, b, turn = p[0], p[1], p[2]
    return np.asarray(np.sqrt(np.maximum(a * a + b * b - 2.0 * a * b * np.cos(turn + sense * q), 1e-12)))


def _joint_error(linkage: Linkage, table: TabulatedLinkage) -> float:
    """RMS error of the joint of a triangle over a table [rad]."""
    return float(np.sqrt(np.mean((TriangleLinkage(linkage).joint(table.displacements) - table.joints) ** 2)))
