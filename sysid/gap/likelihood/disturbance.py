"""What disturbs a stage at random: sensor noise, and a disturbance with a correlation time that an integrating stage sums up.

    s_k     = ρ_k·s_{k−1} + √(1 − ρ_k²)·η_k          ρ_k = e^(−Δt_k/T), stationary variance 1
    level_k = level_{k−1} + Δt_k·a_k·s_{k−1}          (a stage that integrates its input)
    y_k     = level_k + σ·ε_k                         or, where nothing integrates,  y_k = a_k·s_k + σ·ε_k

with the amplitude ``a_k² = still² + moving²·activity_k²``: a flow disturbance grows with the flow. A Kalman filter turns the
residual of a run into independent standard normal innovations; it is linear, so that it whitens the columns of a regression
as well (Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, ch. 3). The level at the beginning of
a run is unknown (diffuse), so that a constant offset of a run is no evidence where the stage integrates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.compiled import kernel

Array = npt.NDArray[np.float64]

#: Standard deviation of the unknown level at the beginning of a run, in what its residual spans.
DIFFUSE = 100.0


@dataclass(frozen=True)
class Disturbance:
    """Noise and disturbance of one signal of a stage.

    Args:
        noise: standard deviation of the sensor noise of one row [unit of the signal].
        still, moving: amplitude at rest and at an activity of one [unit of the signal, a second where the stage integrates].
        memory: correlation time T [s].
    """

    noise: float
    still: float
    moving: float
    memory: float


@dataclass(frozen=True)
class Filter:
    """Gains of the Kalman filter for one series of rows, each (n,); ``deviation`` is that of the innovation."""

    level: Array
    state: Array
    deviation: Array
    correlation: Array
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
        _whiten(
            columns,
            self.level,
            self.state,
            self.deviation,
            self.correlation,
            self.amplitude,
            self.step,
            self.present,
            self.restart,
            self.integrates,
            out,
        )


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
        extra: variance that the level gains before each row beside the disturbance, (n,): the transient of an unknown start.
        span: what the residual spans [unit of the signal].
    """
    n = len(step)
    amplitude = np.sqrt(disturbance.still**2 + (disturbance.moving * activity) ** 2)
    correlation = np.exp(-step / disturbance.memory)
    level, state, deviation = np.zeros(n), np.zeros(n), np.ones(n)
    _gains(
        disturbance.noise**2,
        (DIFFUSE * max(span, disturbance.noise)) ** 2,
        correlation,
        amplitude,
        step,
        extra,
        present,
        restart,
        integrates,
        level,
        state,
        deviation,
    )
    return Filter(level, state, deviation, correlation, amplitude, step, present, restart, integrates)


@kernel
def _gains(noise, diffuse, correlation, amplitude, step, extra, present, restart, integrates, level, state, deviation):
    a, b, c = 0.0, 0.0, 1.0  # covariance of (level, s)
    for k in range(len(step)):
        rho = correlation[k]
        if restart[k]:
            a, b, c = diffuse if integrates else 0.0, 0.0, 1.0
        else:
            if integrates:
                f = step[k] * amplitude[k]
                a = a + 2.0 * f * b + f * f * c + extra[k]
                b = rho * (b + f * c)
            c = rho * rho * c + 1.0 - rho * rho
        if not present[k]:
            continue
        if integrates:
            s = a + noise
            g0, g1 = a / s, b / s
            c = c - g1 * b
            b = b - g0 * b
            a = a - g0 * a
        else:
            h = amplitude[k]
            s = h * h * c + noise
            g0, g1 = 0.0, h * c / s
            c = c - g1 * h * c
        level[k], state[k], deviation[k] = g0, g1, np.sqrt(s)


@kernel
def _whiten(columns, level, state, deviation, correlation, amplitude, step, present, restart, integrates, out):
    m = columns.shape[1]
    w, s = np.zeros(m), np.zeros(m)
    for k in range(len(columns)):
        if restart[k]:
            w[:] = 0.0
            s[:] = 0.0
        else:
            f = step[k] * amplitude[k] if integrates else 0.0
            rho = correlation[k]
            for j in range(m):
                w[j] += f * s[j]
                s[j] *= rho
        if not present[k]:
            for j in range(m):
                out[k, j] = 0.0
            continue
        g0, g1, unit = level[k], state[k], 1.0 / deviation[k]
        if integrates:
            for j in range(m):
                e = columns[k, j] - w[j]
                w[j] += g0 * e
                s[j] += g1 * e
                out[k, j] = e * unit
        else:
            h = amplitude[k]
            for j in range(m):
                e = columns[k, j] - h * s[j]
                s[j] += g1 * e
                out[k, j] = e * unit
