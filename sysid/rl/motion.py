"""A step of the paper's setting, compiled: setpoints → joints → end effector → reward."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, kernel
from sysid.plant import chain
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.pose import SCRATCH, pose


@inlined
def resting_tip(joints, p, rig, soft, s, q, load, scratch, tip):
    """Joints at rest (A,) in the middle of their backlash → end effector ``tip`` (3,); the other arrays are scratch."""
    for sag in range(2 if soft else 1):
        for i in range(len(joints)):
            s[STATE.backlash_structure] = np.nan
            q[i] = chain.structure_stage(joints[i], p, i * AXIS_WIDTH, s, 0, load[i] if sag == 1 else 0.0)
        pose(q, p, rig.links, rig.base, scratch, tip, load)


@inlined
def is_compliant(p, axes):
    """Whether any joint of the structure is compliant."""
    soft = False
    for i in range(axes):
        soft |= p[i * AXIS_WIDTH + AT.joint_compliance_structure] != 0.0
    return soft


@kernel
def resting_tips(p, rig, joints, out):
    """End effectors (n, 3) of independent poses (n, A)."""
    axes = joints.shape[1]
    s, q, load = np.empty(STATE.input_delay), np.empty(axes), np.empty(axes)
    scratch = np.empty((len(rig.links), SCRATCH))
    soft = is_compliant(p, axes)
    for k in range(len(joints)):
        resting_tip(joints[k], p, rig, soft, s, q, load, scratch, out[k])


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
    s, q, load, tip = np.empty(STATE.input_delay), np.empty(axes), np.empty(axes), np.empty(3)
    scratch = np.empty((len(rig.links), SCRATCH))
    soft = is_compliant(p, axes)
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
        resting_tip(now[lane, :axes], p, rig, soft, s, q, load, scratch, tip)
        away = 0.0
        for c in range(3):
            now[lane, axes + c] = tip[c]
            away += (tip[c] - now[lane, axes + 3 + c]) ** 2
        rewards[lane] = near - math.sqrt(away) + (outside if left else 0.0)
        count[lane] += 1
    return True
