"""What a recording that nobody has made yet would tell: expected discrimination between models, and precision of parameters.

T-optimality (Atkinson & Fedorov, Biometrika 62 (1975) 57 and 289): make data with one model, let the rival fit them as well as
it can, and count what is left. Whitened by the noise floor and by the wandering of the machine, half the sum of squares is the
Kullback-Leibler divergence of the rival, in nats: the log likelihood ratio that the recording is expected to yield. The rival
may not forget what it has learned: earlier recordings hold its parameters by their Fisher information (sequential design:
Pronzato, Automatica 44 (2008) 303).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.drift import CLIP, Drift
from sysid.gap.fit import Data, jacobian, place

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


def discrimination(data: Data, truth: Hypothesis, rival: Hypothesis, drifts: Sequence[Drift], refits: int = 12) -> float:
    """Expected log likelihood ratio of ``truth`` over ``rival`` [nats], with the rival's parameters refitted.

    Args:
        data: recordings as ``truth`` would make them, without noise.
        refits: most steps of the refit; 0: a single linear step, which overstates where the rival bends.
    """
    own = 0.5 * _total(data.whitened(truth.theta[None], drifts)[0])
    low, high = (np.array([u.bounds[k] for u in rival.unknowns]) for k in (0, 1))
    start = np.clip(rival.values, low, high)
    if not rival.unknowns:
        return max(0.5 * _total(data.whitened(rival.theta[None], drifts)[0]) - own, 0.0)
    root = _root(rival.known)

    def errors(x: Array) -> Array:
        r = data.whitened(place(rival.theta, rival.unknowns, x[None]), drifts)[0]
        return np.concatenate([np.clip(r, -CLIP, CLIP), root @ (x - rival.values)])

    def slopes(x: Array) -> Array:
        return np.vstack([jacobian(data, rival.theta, rival.unknowns, x, drifts, high)[1], root])

    if refits == 0:
        r, slope = errors(start), slopes(start)
        step = np.linalg.lstsq(slope, -r, rcond=None)[0]
        step = np.clip(start + step, low, high) - start
        return max(0.5 * _total(r + slope @ step) - own, 0.0)
    room = 1e-9 * (high - low)
    scale = np.array([u.negligible for u in rival.unknowns])
    solution = least_squares(
        errors, np.clip(start, low + room, high - room), slopes, (low, high), x_scale=scale, max_nfev=refits
    )
    return max(float(solution.cost) - own, 0.0)


def precision(data: Data, model: Hypothesis, drifts: Sequence[Drift]) -> Array:
    """Standard deviations of the unknowns of ``model`` with these recordings and all so far, (k,): Cramér and Rao's bound."""
    slopes = jacobian(data, model.theta, model.unknowns, model.values, drifts)[1]
    information = model.known + slopes.T @ slopes
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0.0)) / scale)


def _total(errors: Array) -> float:
    return float(np.sum(np.clip(errors, -CLIP, CLIP) ** 2))


def _root(information: Array) -> Array:
    """R with RᵀR = the matrix, which may be singular."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * scale)
