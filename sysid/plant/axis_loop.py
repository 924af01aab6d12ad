"""One axis by itself, sample by sample, from a given state; compiled."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, loop
from sysid.plant import chain, residual
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.machine_arrays import CYLINDER, FORCE, HIGH, KIND, LOW, POSITION, VELOCITY


@inlined
def begin(s, m, size, position, speed, joint, p, b, first, dt):
    """State of an axis that begins at sample ``first`` of its recording, its first command held since long before.

    ``joint`` NaN begins in the middle of the backlash.
    """
    for k in range(m, m + size):
        s[k] = np.nan
    s[m + STATE.position] = position
    s[m + STATE.speed] = speed
    s[m + STATE.backlash_drive] = joint
    s[m + STATE.backlash_drive + 1] = speed
    if p[b + AT.temperature_drift] != 0.0:
        s[m + STATE.temperature_drift] = math.exp(-first * dt / p[b + AT.temperature_drift + 1])


@loop
def run(p, arrays, i, s, command, load, share, first, last, dt, drive, joint, net):
    """Samples ``first … last`` from the state ``s``; ``joint`` is only written where the joint itself is driven.

    ``net`` is the residual network of the axis (:class:`sysid.plant.residual.StageResidual`), or None.
    """
    b, size, m = i * AXIS_WIDTH, len(s), np.int64(0)  # a literal 0 has another type and would be compiled separately
    fed, jointed = arrays.axes[i, KIND] == VELOCITY, arrays.axes[i, CYLINDER] == 0.0
    if net is not None:
        residual.reset_memory(net.memory)
    for k in range(first, last):
        if net is None:
            demanded = chain.demand(command[k], p, s, m, size, arrays.axes, i, load[k], dt)
            drive[k] = chain.move(demanded * share[k] if fed else demanded, s, m, arrays.axes, i, dt)
        else:
            extra = 0.0
            if arrays.axes[i, KIND] != POSITION:
                extra = residual.update_stage(net, k, s[m + STATE.position], load[k], dt)
            elif k > first:  # the position of a servo at a sample results from the step before
                extra = residual.update_stage(net, k - 1, s[m + STATE.position], load[k - 1], dt)
            if arrays.axes[i, KIND] == FORCE:
                demanded = chain.demand(command[k] - extra, p, s, m, size, arrays.axes, i, load[k], dt)
            else:
                demanded = chain.demand(command[k], p, s, m, size, arrays.axes, i, load[k], dt)
                demanded = demanded * share[k] * (1.0 + extra) if fed else demanded + extra
                if arrays.axes[i, KIND] == POSITION:
                    demanded = min(max(demanded, arrays.axes[i, LOW]), arrays.axes[i, HIGH])
            drive[k] = chain.move(demanded, s, m, arrays.axes, i, dt)
        if jointed:
            joint[k] = chain.joint_stage(drive[k], p, b, s, m, load[k])
