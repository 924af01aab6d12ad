"""Sensors and their clocks, compiled: readings of true values, and the inverse."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import clock_offset, clock_skew, sensor_bias, sensor_quantisation, sensor_scale
from sysid.effects.compiled import inlined, kernel
from sysid.plant.layout import AT


@inlined
def reading(x, p, b):
    """One reading of a true value."""
    x = sensor_scale.step(x, p, b + AT.sensor_scale)
    x = sensor_bias.step(x, p, b + AT.sensor_bias)
    return sensor_quantisation.step(x, p, b + AT.sensor_quantisation)


@kernel
def sensed(p, b, true, dt, out):
    """True values on the machine's clock (n,) → readings on the clock of the sensor's stream (n,)."""
    on_time = p[b + AT.clock_skew] == 0.0 and p[b + AT.clock_offset] == 0.0
    for k in range(len(true)):
        x = true[k]
        if not on_time:
            t = clock_offset.machine_time(clock_skew.machine_time(k * dt, p, b + AT.clock_skew), p, b + AT.clock_offset)
            x = _between(true, t / dt)
        out[k] = reading(x, p, b)


@kernel
def true_signal(p, b, measured, dt, out):
    """Readings on the clock of the sensor's stream (n,) → true values on the machine's clock (n,)."""
    on_time = p[b + AT.clock_skew] == 0.0 and p[b + AT.clock_offset] == 0.0
    for k in range(len(measured)):
        y = measured[k]
        if not on_time:
            t = clock_skew.stream_time(clock_offset.stream_time(k * dt, p, b + AT.clock_offset), p, b + AT.clock_skew)
            y = _between(measured, t / dt)
        out[k] = sensor_scale.undo(sensor_bias.undo(y, p, b + AT.sensor_bias), p, b + AT.sensor_scale)


@inlined
def _between(values, at):
    """Linear interpolation; NaN outside and beside missing samples."""
    k = math.floor(at)
    part = at - k
    if part < 1e-9:
        part = 0.0
    elif part > 1.0 - 1e-9:
        part = 0.0
        k += 1
    if k < 0 or k >= len(values) or (part > 0.0 and k + 1 >= len(values)):
        return np.nan
    return values[k] if part == 0.0 else (1.0 - part) * values[k] + part * values[k + 1]
