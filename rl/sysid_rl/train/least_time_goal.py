"""The joints, of all that put the end effector on a target, to which a coordinated motion takes the least time.

A redundant machine has a set of such joints. Inverse kinematics gives the one nearest to its start; here it is started at
random joints as well. Each solution is rated by the duration of the motion within top speeds and the flow of a shared pump.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid_rl.control import CylinderController
from sysid_rl.control.coordinated_motion import MotionLimits, coordinated_motion
from sysid_rl.train.inverse_kinematics import InverseKinematics
from sysid_rl.train.paths import REACHED

Array = npt.NDArray[np.float64]

#: Starts of the search. The solver takes some microseconds for each.
STARTS = 256


def least_time_goal(
    inverse: InverseKinematics,
    controller: CylinderController,
    limits: MotionLimits,
    begin: Array,
    target: Array,
    starts: int = STARTS,
    seed: int = 0,
) -> Array:
    """Joints (A,) for ``target`` (3,) with the fastest motion from rest at ``begin`` (A,); the nearest ones if none reaches it.

    Args:
        controller: its linkages map joints to driven coordinates.
        limits: of the motion.
        starts: of the search: ``begin``, and random joints.
        seed: of these.
    """
    first = np.random.default_rng(seed).uniform(inverse.low, inverse.high, (starts, len(inverse.low)))
    first[0] = begin
    joints, left = inverse.solve(np.tile(target, (starts, 1)), first)
    reached = np.flatnonzero(left < REACHED)
    if not len(reached):
        return np.asarray(joints[0])
    rest, ends = controller.drive(begin[None])[0], controller.drive(joints[reached])
    seconds = [coordinated_motion(rest, end, limits).duration for end in ends]
    return np.asarray(joints[reached[int(np.argmin(seconds))]])
