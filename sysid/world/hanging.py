"""Inverse kinematics of the passive joints for the tool position of the compiled plant."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.machine.kinematics import rotation_about
from sysid.world.bodies import HangingTool

Array = npt.NDArray[np.float64]

#: Initial angles of the upper joint [rad].
_STARTS = np.linspace(-np.pi, np.pi, 4, endpoint=False) + 0.1


def passive_joints(hanging: HangingTool, tip: Array, reach: Array, speed: Array) -> tuple[Array, Array]:
    """Angles and rates of the two passive joints.

    Args:
        tip: orientation of the tip in the world, 3×3.
        reach: horizontal position (x, y) of the tool relative to the tip, world directions [m].
        speed: its rate [m/s].

    Returns:
        Angles [rad] and rates [rad/s], (2,) each.
    """
    length = float(np.linalg.norm(hanging.reach))
    flat = np.asarray(reach, dtype=np.float64)
    size = float(np.linalg.norm(flat))
    if size > 0.99 * length:
        flat = flat * (0.99 * length / size)
    drop = float(np.sqrt(length**2 - flat @ flat))
    goal = np.array([*flat, -drop])
    rate = np.array([*speed, float(flat @ speed) / drop])

    def place(angles: Array) -> Array:
        rotation = tip
        for joint, angle in zip(hanging.joints, angles, strict=True):
            rotation = rotation @ joint.origin[:3, :3] @ rotation_about(joint.axis, np.array([angle]))[0]
        return np.asarray(rotation @ hanging.reach)

    def away(angles: Array) -> Array:
        return np.asarray(place(angles) - goal)

    # Of the two solutions, take the one with the smaller angle of the lower joint.
    trials = [least_squares(away, [start, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15) for start in _STARTS]
    best = min(trials, key=lambda trial: (round(float(np.sqrt(trial.cost)) / length, 6), abs(_wrapped(trial.x[1]))))
    angles = _wrapped(best.x)
    step = 1e-6
    jacobian = np.column_stack([(place(angles + step * e) - place(angles - step * e)) / (2.0 * step) for e in np.eye(2)])
    return angles, np.linalg.lstsq(jacobian, rate, rcond=None)[0]


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
