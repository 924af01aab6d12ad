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

    ``joint`` NaN begins in the middle of the play.
    """
    for k in range(m, m + size):
        s[k] = np.nan
    s[m + STATE.position] = position
    s[m + STATE.speed] = speed
    s[m + STATE.backlash_drive] = joint
    if p[b + AT.temperature_drift] != 0.0:
        s[m + STATE.temperature_drift] = math.exp(-first * dt / p[b + AT.temperature_drift + 1])


@loop
def run(p, rig, i, s, command, load, share, first, last, dt, drive, joint, own):
    """Samples ``first … last`` from the state ``s``; ``joint`` is only written where the joint itself is driven.

    ``own`` is the network that the axis carries (:class:`sysid.plant.residual.StageResidual`), or None.
    """
    b, size, m = i * AXIS_WIDTH, len(s), np.int64(0)  # a plain 0 would be a type of its own: all compiled once more
    fed, jointed = rig.axes[i, KIND] == VELOCITY, rig.axes[i, CYLINDER] == 0.0
    if own is not None:
        residual.forget(own.memory)
    for k in range(first, last):
        if own is None:
            wanted = chain.ask(command[k], p, s, m, size, rig.axes, i, load[k], dt)
            drive[k] = chain.move(wanted * share[k] if fed else wanted, s, m, rig.axes, i, dt)
        else:
            extra = 0.0
            if rig.axes[i, KIND] != POSITION:
                extra = residual.look(own.nets, own.row, own.memory, own.commands[k], s[m + STATE.position], load[k], dt)
            elif k > first:  # a servo stands at a sample where the step before has led it
                extra = residual.look(
                    own.nets, own.row, own.memory, own.commands[k - 1], s[m + STATE.position], load[k - 1], dt
                )
            if rig.axes[i, KIND] == FORCE:
                wanted = chain.ask(command[k] - extra, p, s, m, size, rig.axes, i, load[k], dt)
            else:
                wanted = chain.ask(command[k], p, s, m, size, rig.axes, i, load[k], dt)
                wanted = wanted * share[k] * (1.0 + extra) if fed else wanted + extra
                if rig.axes[i, KIND] == POSITION:
                    wanted = min(max(wanted, rig.axes[i, LOW]), rig.axes[i, HIGH])
            drive[k] = chain.move(wanted, s, m, rig.axes, i, dt)
        if jointed:
            joint[k] = chain.joint_stage(drive[k], p, b, s, m, load[k])
