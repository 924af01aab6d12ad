"""Expected information of a planned recording: discrimination between models, and precision of parameters.

T-optimality (Atkinson & Fedorov, Biometrika 62 (1975) 57 and 289): data are simulated with one model, the alternative is fitted
to them, and its residual is evaluated. Whitened by noise floor and drift, half its sum of squares is the Kullback-Leibler
divergence of the alternative in nats: the expected log-likelihood ratio of the recording. Earlier recordings constrain the
parameters of the alternative by their Fisher information (sequential design: Pronzato, Automatica 44 (2008) 303).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import MEMORY, Data
from sysid.gap.drift import BIN, CLIP, DriftStrength, estimate_drift
from sysid.gap.fit import jacobian, place

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PlausibleModel:
    """A model that may be the true one.

    Args:
        candidate: the effect that distinguishes it; None for the model without that effect.
        values: of ``unknowns``, (k,).
        theta: the whole parameter vector with them in place.
        known: Fisher information of the unknowns from the recordings so far, (k, k).
    """

    candidate: Candidate | None
    unknowns: tuple[Unknown, ...]
    values: Array
    theta: Array
    known: Array


def plausible_model(
    base: Array,
    candidate: Candidate | None,
    unknowns: Sequence[Unknown],
    values: Array,
    seen: Data,
    drifts: Sequence[DriftStrength],
) -> PlausibleModel:
    """A model with the information of the recordings ``seen`` on its parameters; ``base`` (N,) gives all others."""
    unknowns = tuple(unknowns)
    known = np.zeros((len(unknowns), len(unknowns)))
    if unknowns:
        slopes = jacobian(seen, base, unknowns, values, drifts)[1]
        known = slopes.T @ slopes
    return PlausibleModel(candidate, unknowns, values, place(base, unknowns, values[None])[0], known)


@dataclass(frozen=True)
class Discrimination:
    """Expected difference between the true model and an alternative.

    Args:
        nats: expected log-likelihood ratio after the alternative has been refitted.
        rmse: error of its prediction before that, in noise floors.
    """

    nats: float
    rmse: float


def discrimination(
    data: Data, truth: PlausibleModel, alternative: PlausibleModel, drifts: Sequence[DriftStrength], seed: int = 0
) -> Discrimination:
    """Expected discrimination between ``truth`` and ``alternative``.

    Nats are the smaller of two values: with the known drift (``drifts``), and with the drift estimated for each model after
    noise is added, as in the workflow, where an alternative may fit a residual that it cannot explain as drift.

    Args:
        data: recordings simulated with ``truth``, without noise.
    """
    best = _refitted(data, alternative, drifts)
    own, left = (0.5 * float(np.sum(_clipped(data.whitened(theta[None], drifts)[0]) ** 2)) for theta in (truth.theta, best))
    estimated = _log_likelihood(data, truth.theta, seed) - _log_likelihood(data, best, seed)
    error = np.concatenate([part.ravel() for part in data.residuals(alternative.theta[None])])
    return Discrimination(max(min(left - own, estimated), 0.0), math.sqrt(1.0 + float(np.nanmean(error**2))))


def _refitted(data: Data, alternative: PlausibleModel, drifts: Sequence[DriftStrength]) -> Array:
    """Parameter vector of the alternative, fitted to ``data`` and its prior information, (N,)."""
    if not alternative.unknowns:
        return alternative.theta
    low, high = (np.array([u.bounds[k] for u in alternative.unknowns]) for k in (0, 1))
    root = _root(alternative.known)

    def errors(x: Array) -> Array:
        r = data.whitened(place(alternative.theta, alternative.unknowns, x[None]), drifts)[0]
        return np.concatenate([_clipped(r), root @ (x - alternative.values)])

    def slopes(x: Array) -> Array:
        return np.vstack([jacobian(data, alternative.theta, alternative.unknowns, x, drifts, high)[1], root])

    margin = 1e-9 * (high - low)
    scale = np.array([u.negligible for u in alternative.unknowns])
    start = np.clip(alternative.values, low + margin, high - margin)
    solution = least_squares(errors, start, slopes, (low, high), x_scale=scale, max_nfev=12)
    return np.asarray(place(alternative.theta, alternative.unknowns, solution.x[None])[0])


def _log_likelihood(data: Data, theta: Array, seed: int) -> float:
    """Log-likelihood of the residuals with noise on every bin, under the drift estimated from them."""
    memory = 1.0 if data.problem.integrates else MEMORY
    rng = np.random.default_rng(seed)
    parts = [bins[0] for bins in data.bins(theta[None])]
    levels = [noise_of_bin(data.problem.rate(recording)) for recording in data.recordings]
    noisy = [part + rng.normal(0.0, level, part.shape) for part, level in zip(parts, levels, strict=True)]
    signals = range(len(data.sigma))
    return float(sum(estimate_drift([part[:, k] for part in noisy], data.activities, memory)[1] for k in signals))


def noise_of_bin(rate_hz: float) -> float:
    """Standard deviation of the mean of a bin of white noise, relative to that of a sample."""
    return 1.0 / math.sqrt(max(1, round(BIN * rate_hz)))


def precision(data: Data, model: PlausibleModel, drifts: Sequence[DriftStrength]) -> Array:
    """Standard deviations of the unknowns of ``model`` from these and all earlier recordings, (k,): Cramér-Rao bound."""
    slopes = jacobian(data, model.theta, model.unknowns, model.values, drifts)[1]
    information = model.known + slopes.T @ slopes
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0.0)) / scale)


def _clipped(errors: Array) -> Array:
    return np.asarray(np.clip(errors, -CLIP, CLIP))


def _root(information: Array) -> Array:
    """R with RᵀR = the matrix, which may be singular."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * scale)
