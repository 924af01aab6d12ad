"""The tip of any open chain, without knowing the chain: linear in products of sines and cosines of its joints.

Every joint moves what follows it by a transform that is linear in ``(1, sin q, cos q)`` of an angle or ``(1, q)`` of a
displacement, whatever the geometry. The tip is therefore *exactly* linear in their products, one factor a joint: 53 of them for
three angles and a slide. Their weights are fitted by ridge regression whose strength leave-one-out errors decide: no URDF, no
iteration, and with more poses than products hardly more error than the noise.

Source: that each joint's transform is affine in these follows from Rodrigues' formula; leave-one-out for ridge: Golub, Heath,
Wahba, Technometrics 21 (1979).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.errors import ExcitationError, SettingsError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: More products than this are not offered: poses to match them would take days.
MOST = 400
#: So many poses more than products tell noise from geometry.
SPARE = 20
#: Strengths of the ridge that are tried, relative to products that vary by one.
STRENGTHS = tuple(10.0**k for k in range(-8, 3))


@dataclass(frozen=True)
class FittedChain:
    """A fitted chain.

    Args:
        revolute: which joints are angles.
        mean, scale: of the products in the poses that it was fitted on, (P,).
        weights, level: of the standardised products, (P, 3), and the tip where all are at their mean, (3,) [m].
        covariance: of the weights and, last, the level, for noise of one, (P + 1, P + 1).
        noise: standard deviation of a tip coordinate that is left, (3,) [m].
    """

    revolute: tuple[bool, ...]
    mean: Array
    scale: Array
    weights: Array
    level: Array
    covariance: Array
    noise: Array

    def predict(self, q: Array) -> Array:
        """Tip at joint values ``q`` (n, n_axes), (n, 3) [m]."""
        weights, level = self._folded
        return np.asarray(products(q, self.revolute).dot(weights) + level)

    @cached_property
    def _folded(self) -> tuple[Array, Array]:
        """Weights of the products as they are, and the level that belongs to them."""
        weights = self.weights / self.scale[:, None]
        return weights, self.level - self.mean @ weights

    def spread(self, q: Array) -> Array:
        """Standard deviation of the prediction by what the poses leave open, (n, 3) [m]."""
        rows = np.column_stack([self._standard(q), np.ones(len(q))])
        return np.asarray(np.sqrt(np.einsum("np,pk,nk->n", rows, self.covariance, rows))[:, None] * self.noise)

    def _standard(self, q: Array) -> Array:
        return np.asarray((products(q, self.revolute) - self.mean) / self.scale)


def fit_chain(q: Array, tip: Array, revolute: tuple[bool, ...]) -> FittedChain:
    """Fit the products to poses.

    Args:
        q: joint values, (n, n_axes) [rad or m].
        tip: measured tips, (n, 3) [m].

    Raises:
        ExcitationError: fewer poses than products and :data:`SPARE` more.
        SettingsError: a chain of so many joints that its products outnumber any calibration routine.
    """
    from sklearn.linear_model import RidgeCV

    count = _count(revolute)
    if count > MOST:
        found = f"{len(revolute)} joints make {count} products"
        raise SettingsError("recipe: forward.model = 'chain'", found, f"at most {MOST}", "Use another model.")
    if len(q) < count + SPARE:
        found, expected = f"{len(q)} poses for {count} products of joints", f"at least {count + SPARE}"
        raise ExcitationError("chain", found, expected, "Record more static poses, or use 'structured' with a URDF.")
    rows = products(q, revolute)
    mean, spread = rows.mean(axis=0), rows.std(axis=0)
    scale = np.where(spread > 1e-9 * np.maximum(np.abs(mean), 1.0), spread, np.inf)  # what never varies says nothing
    standard = (rows - mean) / scale
    strengths = np.array(STRENGTHS) * len(q)
    ridge = RidgeCV(strengths).fit(standard, tip)
    weights, level = np.asarray(ridge.coef_).T, np.asarray(ridge.intercept_)
    penalty = np.append(np.full(count, float(ridge.alpha_)), 0.0)
    whole = np.column_stack([standard, np.ones(len(q))])
    covariance = np.linalg.inv(whole.T @ whole + np.diag(penalty))
    used = float(np.trace(covariance @ (whole.T @ whole)))
    left = tip - standard @ weights - level
    noise = np.sqrt(np.sum(left**2, axis=0) / (len(q) - used))
    return FittedChain(revolute, mean, scale, weights, level, covariance, noise)


def products(q: Array, revolute: tuple[bool, ...]) -> Array:
    """All products with one of (1, sin q, cos q) or (1, q) from each joint but the one of ones alone, (n, P)."""
    slides, places = _places(revolute)
    factors = np.ones((len(q), len(revolute), 3))
    np.sin(q, out=factors[:, :, 1])
    np.cos(q, out=factors[:, :, 2])
    if len(slides):
        factors[:, slides, 1] = q[:, slides]
    flat = factors.reshape(len(q), -1)
    rows = flat.take(places[0], axis=1)
    for place in places[1:]:
        rows *= flat.take(place, axis=1)
    return rows


@functools.lru_cache(maxsize=64)
def _places(revolute: tuple[bool, ...]) -> tuple[Index, tuple[Index, ...]]:
    """Which joints slide, and for each joint which of all factors stands in each of the products, (P,)."""
    own = np.meshgrid(*(np.arange(3 if angle else 2) for angle in revolute), indexing="ij")
    return np.flatnonzero(~np.array(revolute)), tuple(3 * k + each.ravel()[1:] for k, each in enumerate(own))


def product_names(joints: Sequence[str], revolute: Sequence[bool]) -> tuple[str, ...]:
    """What the columns of :func:`products` are, for messages: ``sin(boom.joint)·telescope.joint``."""
    names: list[tuple[str, ...]] = [()]
    for joint, angle in zip(joints, revolute, strict=True):
        own = ((), (f"sin({joint})",), (f"cos({joint})",)) if angle else ((), (joint,))
        names = [(*before, *factor) for before in names for factor in own]
    return tuple("·".join(factors) for factors in names[1:])


def _count(revolute: tuple[bool, ...]) -> int:
    return math.prod(3 if angle else 2 for angle in revolute) - 1
