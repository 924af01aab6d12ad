"""Random disturbance of a stage: sensor noise, a correlated disturbance that an integrating stage accumulates, and an error of
the output itself in motion (fast dynamics that no formula contains).

    s_k     = ρ_k·s_{k−1} + √(1 − ρ_k²)·η_k          ρ_k = e^(−Δt_k/T), stationary variance 1
    level_k = level_{k−1} + Δt_k·a_k·s_{k−1}          (a stage that integrates its input)
    p_k     = φ_k·p_{k−1} + √(1 − φ_k²)·r_k·ζ_k      φ_k = e^(−Δt_k/R), error of the output, not integrated
    y_k     = level_k + p_k + σ·ε_k                   or, without integration,  y_k = a_k·s_k + σ·ε_k

with the amplitudes ``a_k² = still² + moving²·activity_k²`` (a flow disturbance grows with the flow) and
``r_k = ripple·activity_k``. Without the latter, an oscillation of millimetres would pass for a flow disturbance, and with it
every slow error. A Kalman filter turns the residual of a run into independent standard normal
innovations; it is linear, so that it whitens the columns of a regression as well (Harvey, Forecasting, Structural Time Series
Models and the Kalman Filter, 1989, ch. 3). The level at the beginning of a run is unknown (diffuse), so that a constant offset
of a run does not change the likelihood where the stage integrates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.compiled import kernel

Array = npt.NDArray[np.float64]

#: Standard deviation of the unknown level at the beginning of a run, in ranges of its output.
DIFFUSE = 100.0


@dataclass(frozen=True)
class Disturbance:
    """Noise and disturbance of one signal of a stage.

    Args:
        noise: standard deviation of the sensor noise of one row [unit of the signal].
        still, moving: amplitude at rest and at an activity of one [unit of the signal, a second where the stage integrates].
        memory: correlation time T [s].
        ripple: amplitude of the error of the output itself at an activity of one [unit of the signal].
        ripple_memory: its correlation time R [s].
    """

    noise: float
    still: float
    moving: float
    memory: float
    ripple: float = 0.0
    ripple_memory: float = 0.1


@dataclass(frozen=True)
class Filter:
    """Gains of the Kalman filter for one series of rows, each (n,); ``deviation`` is that of the innovation."""

    level: Array
    state: Array
    ripple: Array
    deviation: Array
    correlation: Array
    decay: Array
    amplitude: Array
    step: Array
    present: npt.NDArray[np.bool_]
    restart: npt.NDArray[np.bool_]
    integrates: bool

    @property
    def log_scale(self) -> float:
        """Sum of the log standard deviations of the innovations."""
        return float(np.log(self.deviation[self.present]).sum())

    def whiten(self, columns: Array, out: Array) -> None:
        """Innovations of ``columns`` (n, m) in standard deviations into ``out`` (n, m); missing rows are zero."""
        if self.integrates:
            _whiten_integrated(
                columns,
                self.level,
                self.state,
                self.ripple,
                self.deviation,
                self.correlation,
                self.decay,
                self.amplitude * self.step,
                self.present,
                self.restart,
                out,
            )
        else:
            _whiten(columns, self.state, self.deviation, self.correlation, self.amplitude, self.present, self.restart, out)


def filter_of(
    disturbance: Disturbance,
    step: Array,
    activity: Array,
    present: npt.NDArray[np.bool_],
    restart: npt.NDArray[np.bool_],
    extra: Array,
    span: float,
    integrates: bool,
) -> Filter:
    """The filter of one series.

    Args:
        step: time since the row before [s], (n,); ``activity``: of the stage, (n,), about 1 while it moves.
        restart: where a run begins anew.
        extra: further variance added to the level before each row, (n,): the transient of an unknown initial state.
        span: range of the output [unit of the signal].
    """
    n = len(step)
    amplitude = np.sqrt(disturbance.still**2 + (disturbance.moving * activity) ** 2)
    correlation = np.exp(-step / disturbance.memory)
    decay = np.exp(-step / disturbance.ripple_memory)
    level, state, ripple, deviation = np.zeros(n), np.zeros(n), np.zeros(n), np.ones(n)
    if integrates:
        diffuse = (DIFFUSE * max(span, disturbance.noise)) ** 2
        own = (disturbance.ripple * activity) ** 2
        _gains_integrated(
            disturbance.noise**2,
            diffuse,
            correlation,
            decay,
            amplitude * step,
            own,
            extra,
            present,
            restart,
            level,
            state,
            ripple,
            deviation,
        )
    else:
        _gains(disturbance.noise**2, correlation, amplitude, present, restart, state, deviation)
    return Filter(level, state, ripple, deviation, correlation, decay, amplitude, step, present, restart, integrates)


@kernel
def _gains_integrated(noise, diffuse, correlation, decay, flow, own, extra, present, restart, level, state, ripple, deviation):
    # Covariances of w (level), s (disturbance) and p (error of the output itself).
    ww, ws, wp, ss, sp, pp = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0
    for k in range(len(flow)):
        rho, phi, f = correlation[k], decay[k], flow[k]
        if restart[k]:
            ww, ws, wp, ss, sp, pp = diffuse, 0.0, 0.0, 1.0, 0.0, own[k]
        else:
            ww += 2.0 * f * ws + f * f * ss + extra[k]
            wp = phi * (wp + f * sp)
            ws = rho * (ws + f * ss)
            ss = rho * rho * ss + 1.0 - rho * rho
            sp = rho * phi * sp
            pp = phi * phi * pp + (1.0 - phi * phi) * own[k]
        if not present[k]:
            continue
        hw, hs, hp = ww + wp, ws + sp, wp + pp  # covariance with the prediction
        unit = hw + hp + noise
        gw, gs, gp = hw / unit, hs / unit, hp / unit
        ww -= gw * hw
        ws -= gw * hs
        wp -= gw * hp
        ss -= gs * hs
        sp -= gs * hp
        pp -= gp * hp
        level[k], state[k], ripple[k], deviation[k] = gw, gs, gp, np.sqrt(unit)


@kernel
def _gains(noise, correlation, amplitude, present, restart, state, deviation):
    c = 1.0
    for k in range(len(correlation)):
        rho = correlation[k]
        c = 1.0 if restart[k] else rho * rho * c + 1.0 - rho * rho
        if not present[k]:
            continue
        h = amplitude[k]
        unit = h * h * c + noise
        g = h * c / unit
        c = c - g * h * c
        state[k], deviation[k] = g, np.sqrt(unit)


@kernel
def _whiten_integrated(columns, level, state, ripple, deviation, correlation, decay, flow, present, restart, out):
    m = columns.shape[1]
    w, s, p = np.zeros(m), np.zeros(m), np.zeros(m)
    for k in range(len(columns)):
        if restart[k]:
            w[:] = 0.0
            s[:] = 0.0
            p[:] = 0.0
        else:
            f, rho, phi = flow[k], correlation[k], decay[k]
            for j in range(m):
                w[j] += f * s[j]
                s[j] *= rho
                p[j] *= phi
        if not present[k]:
            for j in range(m):
                out[k, j] = 0.0
            continue
        gw, gs, gp, unit = level[k], state[k], ripple[k], 1.0 / deviation[k]
        for j in range(m):
            e = columns[k, j] - w[j] - p[j]
            w[j] += gw * e
            s[j] += gs * e
            p[j] += gp * e
            out[k, j] = e * unit


@kernel
def _whiten(columns, state, deviation, correlation, amplitude, present, restart, out):
    m = columns.shape[1]
    s = np.zeros(m)
    for k in range(len(columns)):
        if restart[k]:
            s[:] = 0.0
        else:
            rho = correlation[k]
            for j in range(m):
                s[j] *= rho
        if not present[k]:
            for j in range(m):
                out[k, j] = 0.0
            continue
        g, h, unit = state[k], amplitude[k], 1.0 / deviation[k]
        for j in range(m):
            e = columns[k, j] - h * s[j]
            s[j] += g * e
            out[k, j] = e * unit
