"""Measured joints → end effector over whole recordings, compiled."""

from __future__ import annotations

import numpy as np

from sysid.effects.compiled import kernel
from sysid.plant import chain
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.pose import SCRATCH, pose


@kernel
def tip(p, arrays, joints, out):
    """Joints at their sensors (n, A) → end effector (n, 3), NaN where any joint is missing.

    The sag of the structure follows from the load of the pose without sag.
    """
    count = joints.shape[1]
    s = np.full((count, STATE.input_delay), np.nan)
    q, load, none = np.empty(count), np.empty(count), np.zeros(count)
    scratch = np.empty((len(arrays.links), SCRATCH))
    soft = False
    for i in range(count):
        soft |= p[i * AXIS_WIDTH + AT.joint_compliance_structure] != 0.0
    for k in range(len(joints)):
        missing = False
        for i in range(count):
            missing |= np.isnan(joints[k, i])
        if missing:
            out[k] = np.nan
            continue
        for i in range(count):
            q[i] = chain.structure_stage(joints[k, i], p, i * AXIS_WIDTH, s[i], 0, none[i])
        pose(q, p, arrays.links, arrays.base, scratch, out[k], load)
        if soft:
            for i in range(count):
                q[i] = chain.structure_stage(joints[k, i], p, i * AXIS_WIDTH, s[i], 0, load[i])
            pose(q, p, arrays.links, arrays.base, scratch, out[k], load)
