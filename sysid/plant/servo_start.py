"""Start state of a position axis: its position, and the setpoints in its dead time; compiled.

During the dead time the lag is inverted: ``u_k = (x_k − a·x_{k−1})/(1 − a)``, ``a = e^(−dt/T)``, with the measured x. That
is the most probable past under a prior as wide as the range of the axis, against which the sensor noise is negligible.
Without a dead time ``x_k = run_k + δx·a^k``, and δx is found by least squares under the same prior. Errors of it decay.
A second-order lag starts at the position and speed of a line through the first samples, and is inverted as a lag of the same
delay at low frequencies, 2ζT.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import input_delay, second_order_lag
from sysid.effects.compiled import inlined, loop
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import line
from sysid.plant.machine_arrays import HIGH, LOW

#: After this number of time constants the initial state of the lag has decayed.
FADED = 4.0
#: The speed at the start is that of a line over this time [s], in at least three samples.
LINE = 0.05
#: Weight of the prior in samples: noise over range, squared.
PRIOR = 1e-6


@inlined
def _between(measured, at, last):
    """The measured motion at sample ``at`` ≥ 0 by linear interpolation; NaN beside missing samples."""
    k = math.floor(at)
    part = at - k
    if k + 1 >= last or part < 1e-9:
        return measured[min(k, last - 1)]
    return (1.0 - part) * measured[k] + part * measured[k + 1]


@loop
def start_servo(p, arrays, i, start, command, measured, load, first, last, dt, zeros):
    """Correct the state ``start`` (size,) of a position axis; the first sample is the result of a step of the chain.

    The axis sags under its ``load``, (n,); ``zeros`` (n,) is overwritten.
    """
    b, low, high = i * AXIS_WIDTH, arrays.axes[i, LOW], arrays.axes[i, HIGH]
    lag, delay = p[b + AT.first_order_lag], p[b + AT.input_delay]
    at = b + AT.second_order_lag
    sag = 0.0 if np.isnan(load[first]) else p[b + AT.joint_compliance_drive] * load[first]
    if p[at] >= second_order_lag.ABSENT:
        lag += 2.0 * p[at + 1] * p[at]
        near = min(last, first + max(3, round(LINE / dt)))
        seen = 0
        for k in range(first, near):
            zeros[k] = 0.0
            if not np.isnan(measured[k]):
                seen += 1
        place, slope = line(measured, zeros, first, near)
        if seen > 0:
            start[STATE.second_order_lag] = min(max(place + sag - slope, low), high)  # of the sample before
            start[STATE.second_order_lag + 1] = slope / dt
    kept = math.exp(-dt / lag) if lag > 1e-6 else 0.0
    cells = math.ceil(delay / dt - 1e-9)
    if cells == 0:
        if kept == 0.0 or p[at] >= second_order_lag.ABSENT:
            return
        x, share, top, bottom = command[first], 1.0, 0.0, PRIOR
        for k in range(first, min(last, first + math.ceil(FADED * lag / dt))):
            x = command[k] + (x - command[k]) * kept
            share *= kept
            if not np.isnan(measured[k]):
                top += share * (measured[k] + sag - x)
                bottom += share * share
        start[STATE.first_order_lag] = min(max(command[first] + top / bottom, low), high)
        return
    ring, size = STATE.input_delay, len(start) - STATE.input_delay
    input_delay.fill(command[first], p, b + AT.input_delay, start, ring, size, dt)
    setpoint, known = command[first], False
    for back in range(cells, -1, -1):  # a command may be taken a row late, so that the first one is of the past too
        acts = first + delay / dt - back  # the sample that the step with this set-point leads to
        if acts >= first:
            x = _between(measured, acts, last) + sag
            before = _between(measured, acts - 1.0, last) + sag if acts - 1.0 >= first else x
            if not (np.isnan(x) or np.isnan(before)):
                setpoint = min(max((x - kept * before) / (1.0 - kept), low), high)
                if not known:  # before the measurement it was held there
                    known = True
                    start[STATE.first_order_lag] = min(max(before, low), high)
                    for older in range(back, cells + 1):
                        input_delay.put(setpoint, start, ring, size, older)
        if back > 0:
            input_delay.put(setpoint, start, ring, size, back)
        elif known:
            start[STATE.setpoint] = setpoint
