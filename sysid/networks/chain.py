"""Forward kinematics of any open chain without a URDF: linear in products of sines and cosines of its joints.

Every joint transforms what follows it linearly in ``(1, sin q, cos q)`` of an angle or ``(1, q)`` of a displacement, whatever
the geometry. The tip is therefore *exactly* linear in their products, one factor per joint: 53 for three angles and a slide.
Their coefficients are fitted by ridge regression whose strength minimises the leave-one-out error.

Source: the linearity follows from Rodrigues' formula; leave-one-out for ridge: Golub, Heath, Wahba, Technometrics 21 (1979).
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

#: Largest number of products: more would require days of pose recording.
MAX_PRODUCTS = 400
#: Required number of poses beyond the number of products.
SPARE_POSES = 20
#: Candidate ridge strengths, per pose and for products of unit variance.
RIDGE_STRENGTHS = tuple(10.0**k for k in range(-8, 3))


@dataclass(frozen=True)
class FittedChain:
    """A fitted chain.

    Args:
        revolute: which joints are angles.
        mean, scale: of the products in the fit poses, (P,).
        weights, level: coefficients of the standardised products, (P, 3) [m], and the intercept, (3,) [m].
        covariance: of weights and, last, intercept, for unit noise, (P + 1, P + 1).
        noise: standard deviation of the residuals of each tip coordinate, (3,) [m].
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
        """Coefficients and intercept of the products without standardisation."""
        weights = self.weights / self.scale[:, None]
        return weights, self.level - self.mean @ weights

    def spread(self, q: Array) -> Array:
        """Standard deviation of the prediction from the covariance of the coefficients, (n, 3) [m]."""
        standard = (products(q, self.revolute) - self.mean) / self.scale
        rows = np.column_stack([standard, np.ones(len(q))])
        return np.asarray(np.sqrt(np.einsum("np,pk,nk->n", rows, self.covariance, rows))[:, None] * self.noise)


def fit_chain(q: Array, tip: Array, revolute: tuple[bool, ...]) -> FittedChain:
    """Fit the products to poses.

    Args:
        q: joint values, (n, n_axes) [rad or m].
        tip: measured tips, (n, 3) [m].

    Raises:
        ExcitationError: fewer poses than products plus :data:`SPARE_POSES`.
        SettingsError: a chain of so many joints that it has more than :data:`MAX_PRODUCTS` products.
    """
    from sklearn.linear_model import RidgeCV

    count = math.prod(3 if angle else 2 for angle in revolute) - 1
    if count > MAX_PRODUCTS:
        found = f"{len(revolute)} joints make {count} products"
        raise SettingsError("recipe: forward.model = 'chain'", found, f"at most {MAX_PRODUCTS}", "Use another model.")
    if len(q) < count + SPARE_POSES:
        found, expected = f"{len(q)} poses for {count} products of joints", f"at least {count + SPARE_POSES}"
        raise ExcitationError("chain", found, expected, "Record more static poses, or use 'structured' with a URDF.")
    rows = products(q, revolute)
    mean, spread = rows.mean(axis=0), rows.std(axis=0)
    scale = np.where(spread > 1e-9 * np.maximum(np.abs(mean), 1.0), spread, np.inf)  # a constant product has no coefficient
    standard = (rows - mean) / scale
    strengths = np.array(RIDGE_STRENGTHS) * len(q)
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
    """All products of one factor (1, sin q, cos q) or (1, q) per joint, except the constant one, (n, P)."""
    slides, places = _factor_indices(revolute)
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
def _factor_indices(revolute: tuple[bool, ...]) -> tuple[Index, tuple[Index, ...]]:
    """Indices of the prismatic joints, and for each joint the index of its factor in every product, (P,)."""
    own = np.meshgrid(*(np.arange(3 if angle else 2) for angle in revolute), indexing="ij")
    return np.flatnonzero(~np.array(revolute)), tuple(3 * k + each.ravel()[1:] for k, each in enumerate(own))


def product_names(joints: Sequence[str], revolute: Sequence[bool]) -> tuple[str, ...]:
    """Names of the columns of :func:`products`, for messages: ``sin(boom.joint)·telescope.joint``."""
    names: list[tuple[str, ...]] = [()]
    for joint, angle in zip(joints, revolute, strict=True):
        own = ((), (f"sin({joint})",), (f"cos({joint})",)) if angle else ((), (joint,))
        names = [(*before, *factor) for before in names for factor in own]
    return tuple("·".join(factors) for factors in names[1:])
