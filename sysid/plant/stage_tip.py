"""Measured joints → end effector over whole recordings, compiled."""

from __future__ import annotations

import numpy as np

from sysid.effects.compiled import kernel
from sysid.plant import chain
from sysid.plant.layout import AXIS_WIDTH, STATE
from sysid.plant.pose import SCRATCH
from sysid.plant.settled_pose import settle


@kernel
def tip(p, arrays, joints, out):
    """Joints at their sensors (n, A) → end effector (n, 3) of the posture under load, NaN where any joint is missing."""
    count, m = joints.shape[1], np.int64(0)  # a literal 0 has another type and would be compiled separately
    s = np.full((count, STATE.input_delay), np.nan)
    straight, q, load = np.empty(count), np.empty(count), np.empty(count)
    scratch = np.empty((len(arrays.links), SCRATCH))
    for k in range(len(joints)):
        missing = False
        for i in range(count):
            missing |= np.isnan(joints[k, i])
        if missing:
            out[k] = np.nan
            continue
        for i in range(count):
            straight[i] = chain.structure_stage(joints[k, i], p, i * AXIS_WIDTH, s[i], m, 0.0)
        settle(straight, p, arrays.links, arrays.base, q, scratch, out[k], load)
