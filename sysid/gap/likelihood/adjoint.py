"""Gradient of a function of whitened columns with respect to the parameters of the whitening filter.

The whitening of :mod:`sysid.gap.likelihood.disturbance` is run backwards once, from the derivative of the function with respect
to each innovation to that with respect to each gain (reverse-mode differentiation: Griewank and Walther, Evaluating
Derivatives, 2nd ed., 2008, ch. 3). The gains as functions of the disturbance parameters are cheap and are differentiated by
finite differences. A gradient costs about two whitenings for any number of parameters.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sysid.compiled import summing
from sysid.gap.likelihood.disturbance import Filter

Array = npt.NDArray[np.float64]

#: Step of the finite differences of the gains, in the logarithm of a parameter.
STEP = 1e-5


def gradient_of(columns: Array, slope: Array, found: Filter, filters: Callable[[Array], Filter], z: Array) -> Array:
    """Derivatives with respect to the parameters of a disturbance, (k,), of a function of innovations plus their log scale.

    Args:
        z: logarithms of the parameters, (k,).
        columns: (n, m), before the whitening. slope: of the function, with respect to each innovation, (n, m).
        found: the filter of the series at ``z``; ``filters``: at other values of it.
    """
    gains, by_gain = _gains(found), _by_gains(columns, slope, found)
    by_gain[3] += found.present / found.deviation  # of the log scale
    return np.array([np.vdot(_gains(filters(z + step)) - gains, by_gain) / STEP for step in STEP * np.eye(len(z))])


def _gains(found: Filter) -> Array:
    """Coefficients of a filter in the order of the kernels, (7, n)."""
    flow = found.amplitude * found.step if found.integrates else found.amplitude
    return np.stack([found.level, found.state, found.ripple, found.deviation, found.correlation, found.decay, flow])


def _by_gains(columns: Array, slope: Array, found: Filter) -> Array:
    """Derivatives with respect to the coefficients of a filter, (7, n)."""
    out = np.zeros((7, len(columns)))
    gains = _gains(found)
    states, ripples = np.empty(columns.shape), np.empty(columns.shape)
    if found.integrates:
        errors = np.empty(columns.shape)
        _backward_integrated(columns, slope, *gains, found.present, found.restart, states, ripples, errors, out)
    else:
        _backward(columns, slope, *gains, found.present, found.restart, states, ripples, out)
    return out


@summing
def _backward_integrated(
    columns, slope, level, state, ripple, deviation, correlation, decay, flow, present, restart, states, ripples, errors, out
):
    """``states``, ``ripples`` and ``errors`` hold s and p before each row, and its prediction error, (n, m)."""
    n, m = columns.shape
    w, s, p = np.zeros(m), np.zeros(m), np.zeros(m)
    for k in range(n):
        if restart[k]:
            w[:] = 0.0
            s[:] = 0.0
            p[:] = 0.0
        f, rho, phi = flow[k], correlation[k], decay[k]
        for j in range(m):
            states[k, j] = s[j]
            ripples[k, j] = p[j]
        for j in range(m):
            w[j] += f * s[j]
            s[j] *= rho
            p[j] *= phi
        if not present[k]:
            continue
        gw, gs, gp = level[k], state[k], ripple[k]
        for j in range(m):
            errors[k, j] = columns[k, j] - w[j] - p[j]
        for j in range(m):
            e = errors[k, j]
            w[j] += gw * e
            s[j] += gs * e
            p[j] += gp * e
    w[:] = 0.0  # from here on derivatives with respect to w, s and p
    s[:] = 0.0
    p[:] = 0.0
    for k in range(n - 1, -1, -1):
        f, rho, phi = flow[k], correlation[k], decay[k]
        if present[k]:
            gw, gs, gp, unit = level[k], state[k], ripple[k], 1.0 / deviation[k]
            by_w, by_s, by_p, by_unit = 0.0, 0.0, 0.0, 0.0
            for j in range(m):
                e = errors[k, j]
                by_w += w[j] * e
                by_s += s[j] * e
                by_p += p[j] * e
                by_unit += slope[k, j] * e
            for j in range(m):
                by_e = slope[k, j] * unit + gw * w[j] + gs * s[j] + gp * p[j]
                w[j] -= by_e
                p[j] -= by_e
            out[0, k], out[1, k], out[2, k], out[3, k] = by_w, by_s, by_p, -by_unit * unit * unit
        by_f, by_rho, by_phi = 0.0, 0.0, 0.0
        for j in range(m):
            by_f += w[j] * states[k, j]
            by_rho += s[j] * states[k, j]
            by_phi += p[j] * ripples[k, j]
        for j in range(m):
            s[j] = f * w[j] + rho * s[j]
            p[j] *= phi
        out[4, k], out[5, k], out[6, k] = by_rho, by_phi, by_f
        if restart[k]:
            w[:] = 0.0
            s[:] = 0.0
            p[:] = 0.0


@summing
def _backward(
    columns, slope, level, state, ripple, deviation, correlation, decay, amplitude, present, restart, states, errors, out
):
    """``states`` holds s before each row, ``errors`` its prediction error, (n, m); level, ripple and decay are not used."""
    n, m = columns.shape
    s = np.zeros(m)
    for k in range(n):
        if restart[k]:
            s[:] = 0.0
        rho, g, h = correlation[k], state[k], amplitude[k]
        for j in range(m):
            states[k, j] = s[j]
            s[j] *= rho
        if not present[k]:
            continue
        for j in range(m):
            e = columns[k, j] - h * s[j]
            errors[k, j] = e
            s[j] += g * e
    s[:] = 0.0  # from here on the derivative with respect to s
    for k in range(n - 1, -1, -1):
        rho, g, h = correlation[k], state[k], amplitude[k]
        if present[k]:
            unit = 1.0 / deviation[k]
            by_g, by_unit, by_h = 0.0, 0.0, 0.0
            for j in range(m):
                e, a = errors[k, j], slope[k, j]
                by_g += s[j] * e
                by_unit += a * e
                by_e = a * unit + g * s[j]
                by_h -= by_e * rho * states[k, j]
                s[j] -= h * by_e
            out[1, k], out[3, k], out[6, k] = by_g, -by_unit * unit * unit, by_h
        by_rho = 0.0
        for j in range(m):
            by_rho += s[j] * states[k, j]
            s[j] *= rho
        out[4, k] = by_rho
        if restart[k]:
            s[:] = 0.0
