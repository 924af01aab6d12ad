"""The named effects of the command stage in their documented order, implemented again for evaluating cases.

It is fitted to the simulated test bench as an engineer would do; it is not part of that simulation. One row of parameters for
each axis:

    delay → hysteresis → dead-band → curve → saturation → rate limit → lag → gain, sides → stiction → temperature → load
    → leakage → second-order oscillation → pump → position → end stops
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled

Array = npt.NDArray[np.float64]

#: (effect, parameter) → neutral value, lower and upper bound, typical size. The order is that of a row.
PARAMETERS: dict[tuple[str, str], tuple[float, float, float, float]] = {
    ("input_delay", "delay"): (0.0, 0.0, 0.5, 0.03),
    ("valve_hysteresis", "width"): (0.0, 0.0, 0.3, 0.04),
    ("valve_deadband", "positive"): (0.0, 0.0, 0.6, 0.1),
    ("valve_deadband", "negative"): (0.0, 0.0, 0.6, 0.1),
    ("gain_curve", "exponent"): (1.0, 0.4, 3.0, 1.2),
    ("flow_saturation", "limit"): (1.0, 0.1, 1.0, 0.7),
    ("command_rate_limit", "rate"): (1e3, 0.3, 1e3, 5.0),
    ("first_order_lag", "time_constant"): (0.0, 0.0, 0.6, 0.05),
    ("stiction", "breakaway"): (0.0, 0.0, 0.6, 0.1),
    ("stiction", "release"): (0.0, 0.0, 0.6, 0.05),
    ("gain_error", "ratio"): (1.0, 0.2, 3.0, 0.9),
    ("asymmetric_gain", "ratio"): (1.0, 0.3, 3.0, 0.9),
    ("temperature_drift", "fraction"): (0.0, -0.6, 0.6, 0.1),
    ("temperature_drift", "time_constant"): (100.0, 5.0, 3000.0, 150.0),
    ("load_dependent_flow", "coefficient"): (0.0, -0.05, 0.05, 1e-3),
    ("internal_leakage", "rate"): (0.0, -1e-2, 1e-2, 1e-4),
    ("oil_compressibility", "frequency"): (0.0, 0.0, 40.0, 8.0),
    ("oil_compressibility", "damping_ratio"): (0.1, 0.01, 1.5, 0.1),
}
KEYS = tuple(PARAMETERS)


def neutral_row() -> Array:
    return np.array([values[0] for values in PARAMETERS.values()])


@compiled
def speeds(command: Array, load: Array, row: Array, gain: float, step: float, out: Array) -> None:
    """Speed of one drive (n,) [m/s or rad/s] into ``out``, from its held command (n,) and the load on it (n,) [N·m or N]."""
    delay, play, positive, negative, curve, limit, rate, lag = row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7]
    breakaway, release, ratio, sides, warm, warming, per_load, leak = (
        row[8], row[9], row[10], row[11], row[12], row[13], row[14], row[15],
    )  # fmt: skip
    omega = 2.0 * math.pi * row[16]
    damping = row[17]
    whole = math.floor(delay / step)
    part = delay / step - whole
    keep = math.exp(-step / lag) if lag > 0.0 else 0.0
    share = lag / step * (1.0 - keep)
    held = command[0]
    ramp = 0.0
    filtered = 0.0
    flowing = False
    ringing = 0.0
    slope = 0.0
    for k in range(len(command)):
        late = command[max(k - whole, 0)]
        u = late + part * (command[max(k - whole - 1, 0)] - late)
        held = min(max(held, u - 0.5 * play), u + 0.5 * play)
        u = held
        if u > positive:
            u -= positive
        elif u < -negative:
            u += negative
        else:
            u = 0.0
        if curve != 1.0:
            u = math.copysign(abs(u) ** curve, u)
        u = min(max(u, -limit), limit)
        ramp += min(max(u - ramp, -rate * step), rate * step)
        # A drive moves by the mean over the step; the value at its end would be half a step early.
        x = ratio * (ramp + (filtered - ramp) * share)
        filtered = ramp + (filtered - ramp) * keep
        if x < 0.0:
            x *= sides
        if breakaway > 0.0:
            if flowing and abs(x) < min(release, breakaway):
                flowing = False
            elif not flowing and abs(x) > breakaway:
                flowing = True
            if not flowing:
                x = 0.0
        v = gain * x * (1.0 + warm * (1.0 - math.exp(-k * step / warming)))
        if v > 0.0:
            v *= 1.0 - per_load * load[k]
        elif v < 0.0:
            v *= 1.0 + per_load * load[k]
        v -= leak
        if omega > 0.0:
            slope += step * (omega * omega * (v - ringing) - 2.0 * damping * omega * slope)
            v = ringing + 0.5 * step * slope
            ringing += step * slope
        out[k] = v


@compiled
def share_pump(rates: Array, gains: Array, limit: float) -> None:
    """Scale all speeds (axes, n) in place by one factor where Σ |speed|/gain exceeds ``limit``."""
    for k in range(rates.shape[1]):
        total = 0.0
        for i in range(len(gains)):
            total += abs(rates[i, k]) / gains[i]
        if total > limit:
            for i in range(len(gains)):
                rates[i, k] *= limit / total


@compiled
def travel(rates: Array, start: float, low: float, high: float, step: float, out: Array) -> None:
    """Position (n,) before each step, held by the end stops."""
    position = start
    for k in range(len(rates)):
        out[k] = position
        position = min(max(position + rates[k] * step, low), high)
