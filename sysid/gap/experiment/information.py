"""What a recording that nobody has made yet would tell: expected discrimination between models, and precision of parameters.

T-optimality (Atkinson & Fedorov, Biometrika 62 (1975) 57 and 289): make data with one model, let the rival fit them as well as
it can, and count what is left. Whitened by the noise floor and by the wandering of the machine, half the sum of squares is the
Kullback-Leibler divergence of the rival, in nats: the log likelihood ratio that the recording is expected to yield. The rival
may not forget what it has learned: earlier recordings hold its parameters by their Fisher information (sequential design:
Pronzato, Automatica 44 (2008) 303).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import FORGETS, Data
from sysid.gap.drift import BIN, CLIP, Drift, estimate_drift
from sysid.gap.fit import jacobian, place

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Hypothesis:
    """A model that may be the true one.

    Args:
        candidate: the effect that makes it what it is; None for the model without it.
        values: of ``unknowns``, (k,).
        theta: the whole parameter vector with them in place.
        known: Fisher information of the unknowns from the recordings so far, (k, k).
    """

    candidate: Candidate | None
    unknowns: tuple[Unknown, ...]
    values: Array
    theta: Array
    known: Array


def hypothesis(
    base: Array, candidate: Candidate | None, unknowns: Sequence[Unknown], values: Array, seen: Data, drifts: Sequence[Drift]
) -> Hypothesis:
    """A model with what the recordings ``seen`` say of its parameters; ``base`` (N,) gives all the others."""
    unknowns = tuple(unknowns)
    known = np.zeros((len(unknowns), len(unknowns)))
    if unknowns:
        slopes = jacobian(seen, base, unknowns, values, drifts)[1]
        known = slopes.T @ slopes
    return Hypothesis(candidate, unknowns, values, place(base, unknowns, values[None])[0], known)


@dataclass(frozen=True)
class Discrimination:
    """What sets a rival apart.

    Args:
        nats: expected log likelihood ratio after the rival has been refitted.
        rmse: error of its prediction before that, in noise floors.
    """

    nats: float
    rmse: float


def discrimination(data: Data, truth: Hypothesis, rival: Hypothesis, drifts: Sequence[Drift], seed: int = 0) -> Discrimination:
    """How far ``truth`` and ``rival`` are expected to come apart.

    Nats are the smaller of two: with the wandering that is known (``drifts``), and with the wandering that each model is found
    to have when noise is added, as the workflow will judge it: a rival may pass what it cannot explain off as wandering.

    Args:
        data: recordings as ``truth`` would make them, without noise.
    """
    best = _refit(data, rival, drifts)
    own, left = (0.5 * float(np.sum(_clipped(data.whitened(theta[None], drifts)[0]) ** 2)) for theta in (truth.theta, best))
    judged = _judged(data, truth.theta, seed) - _judged(data, best, seed)
    error = np.concatenate([part.ravel() for part in data.residuals(rival.theta[None])])
    return Discrimination(max(min(left - own, judged), 0.0), math.sqrt(1.0 + float(np.nanmean(error**2))))


def _refit(data: Data, rival: Hypothesis, drifts: Sequence[Drift]) -> Array:
    """The rival's parameter vector that predicts ``data`` best and does not forget what is known, (N,)."""
    if not rival.unknowns:
        return rival.theta
    low, high = (np.array([u.bounds[k] for u in rival.unknowns]) for k in (0, 1))
    root = _root(rival.known)

    def errors(x: Array) -> Array:
        r = data.whitened(place(rival.theta, rival.unknowns, x[None]), drifts)[0]
        return np.concatenate([_clipped(r), root @ (x - rival.values)])

    def slopes(x: Array) -> Array:
        return np.vstack([jacobian(data, rival.theta, rival.unknowns, x, drifts, high)[1], root])

    room = 1e-9 * (high - low)
    scale = np.array([u.negligible for u in rival.unknowns])
    start = np.clip(rival.values, low + room, high - room)
    solution = least_squares(errors, start, slopes, (low, high), x_scale=scale, max_nfev=12)
    return np.asarray(place(rival.theta, rival.unknowns, solution.x[None])[0])


def _judged(data: Data, theta: Array, seed: int) -> float:
    """Log likelihood of the residuals with noise on every bin, under the wandering that is estimated from them."""
    memory = 1.0 if data.problem.integrates else FORGETS
    rng = np.random.default_rng(seed)
    parts = [bins[0] for bins in data.bins(theta[None])]
    levels = [noise_of_bin(data.problem.rate(recording)) for recording in data.recordings]
    noisy = [part + rng.normal(0.0, level, part.shape) for part, level in zip(parts, levels, strict=True)]
    signals = range(len(data.sigma))
    return float(sum(estimate_drift([part[:, k] for part in noisy], data.activities, memory)[1] for k in signals))


def noise_of_bin(rate_hz: float) -> float:
    """Standard deviation of the mean of a bin of white noise, in that of a sample."""
    return 1.0 / math.sqrt(max(1, round(BIN * rate_hz)))


def precision(data: Data, model: Hypothesis, drifts: Sequence[Drift]) -> Array:
    """Standard deviations of the unknowns of ``model`` with these recordings and all so far, (k,): Cramér and Rao's bound."""
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
