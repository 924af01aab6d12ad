"""A step of the paper's setting, compiled: setpoints → joints → end effector → reward."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, kernel
from sysid.plant import chain
from sysid.plant.layout import AXIS_WIDTH, STATE
from sysid.plant.pose import SCRATCH
from sysid.plant.settled_pose import settle


@inlined
def resting_tip(joints, p, rig, s, straight, q, load, scratch, tip):
    """Joints at rest (A,) in the middle of their backlash → end effector ``tip`` (3,); the other arrays are scratch."""
    for i in range(len(joints)):
        s[STATE.backlash_structure] = np.nan
        straight[i] = chain.structure_stage(joints[i], p, i * AXIS_WIDTH, s, 0, 0.0)
    settle(straight, p, rig.links, rig.base, q, scratch, tip, load)


@kernel
def resting_tips(p, rig, joints, out):
    """End effectors (n, 3) of independent poses (n, A)."""
    axes = joints.shape[1]
    s, straight, q, load = np.empty(STATE.input_delay), np.empty(axes), np.empty(axes), np.empty(axes)
    scratch = np.empty((len(rig.links), SCRATCH))
    for k in range(len(joints)):
        resting_tip(joints[k], p, rig, s, straight, q, load, scratch, out[k])


@kernel
def move_copies(p, rig, wanted, low, high, now, count, rewards, near, outside):
    """Move all copies by one step; False, without motion, if a setpoint is not finite.

    Args:
        wanted: setpoints (n, A); ``low`` and ``high`` (A,) limit them.
        now: observations (n, A + 6), in and out; ``count`` (n,) steps of the episode, in and out; ``rewards`` (n,), out.
        near, outside: reward at zero distance, and penalty for a setpoint outside its limits.
    """
    lanes, axes = wanted.shape
    for lane in range(lanes):
        for i in range(axes):
            if not math.isfinite(wanted[lane, i]):
                return False
    s, straight, q, load = np.empty(STATE.input_delay), np.empty(axes), np.empty(axes), np.empty(axes)
    tip, scratch = np.empty(3), np.empty((len(rig.links), SCRATCH))
    for lane in range(lanes):
        left = False
        for i in range(axes):
            x = wanted[lane, i]
            if x < low[i]:
                x = low[i]
                left = True
            elif x > high[i]:
                x = high[i]
                left = True
            now[lane, i] = x
        resting_tip(now[lane, :axes], p, rig, s, straight, q, load, scratch, tip)
        away = 0.0
        for c in range(3):
            now[lane, axes + c] = tip[c]
            away += (tip[c] - now[lane, axes + 3 + c]) ** 2
        rewards[lane] = near - math.sqrt(away) + (outside if left else 0.0)
        count[lane] += 1
    return True
