"""Joint distribution of the parameters of a plant, and plants drawn from it (domain randomisation from data)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.effects import effect_named
from sysid.effects.described import side_of
from sysid.errors import SettingsError
from sysid.machine import EffectKey

Array = npt.NDArray[np.float64]
Side = Literal["drive", "structure"] | None

#: A draw outside its bounds is repeated this often before it is clipped to them.
REPEATS = 100


@dataclass(frozen=True)
class PlantNumber:
    """One number of a plant: a component of a parameter of an effect."""

    effect: str
    target: str
    side: Side
    parameter: str
    component: int = 0

    @property
    def key(self) -> EffectKey:
        """Key of its instance."""
        return self.effect, self.target, side_of(effect_named(self.effect), self.side)


@dataclass(frozen=True)
class Uncertainty:
    """Joint normal distribution of some parameters around the values that the plant has.

    Args:
        places: the parameters, (k,).
        covariance: (k, k), in the squared units of the parameters.

    Raises:
        SettingsError: the matrix is not a covariance of that many parameters, or a place occurs twice.
    """

    places: tuple[PlantNumber, ...]
    covariance: Array

    def __post_init__(self) -> None:
        count = len(self.places)
        where, found = "uncertainty of a plant", np.asarray(self.covariance, dtype=np.float64)
        if found.shape != (count, count):
            raise SettingsError(where, f"covariance of shape {found.shape}", f"({count}, {count})")
        if len(set(self.places)) != count:
            raise SettingsError(where, "a parameter twice", "each parameter once")
        size = float(np.max(np.abs(found), initial=0.0))
        if not np.isfinite(found).all() or np.abs(found - found.T).max(initial=0.0) > 1e-9 * size:
            raise SettingsError(where, "a matrix that is not symmetric and finite", "a covariance")
        scale = np.sqrt(np.maximum(np.diag(found), 1e-300))
        if count and np.linalg.eigvalsh(found / np.outer(scale, scale)).min() < -1e-6 * count:
            raise SettingsError(where, "a matrix with negative variances", "a covariance")

    def joined(self, other: Uncertainty) -> Uncertainty:
        """Both, as independent; for the same instance of an effect ``other`` replaces this."""
        kept = self.without({place.key for place in other.places})
        a, b = len(kept.places), len(other.places)
        covariance = np.zeros((a + b, a + b))
        covariance[:a, :a], covariance[a:, a:] = kept.covariance, other.covariance
        return Uncertainty((*kept.places, *other.places), covariance)

    def without(self, keys: set[EffectKey]) -> Uncertainty:
        """The distribution without the parameters of these instances of effects."""
        rows = [k for k, place in enumerate(self.places) if place.key not in keys]
        return Uncertainty(tuple(self.places[k] for k in rows), self.covariance[np.ix_(rows, rows)])

    def draw(self, values: Array, bounds: Sequence[tuple[float, float]], count: int, seed: int) -> Array:
        """``count`` draws around ``values`` (k,), (count, k): normal, truncated at ``bounds``."""
        rng = np.random.default_rng(seed)
        scale = np.sqrt(np.diag(self.covariance))
        unit = np.where(scale > 0.0, scale, 1.0)
        sizes, axes = np.linalg.eigh(self.covariance / np.outer(unit, unit))
        root = unit[:, None] * axes * np.sqrt(np.maximum(sizes, 0.0))
        low, high = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
        drawn = values + rng.standard_normal((count, len(values))) @ root.T
        for _ in range(REPEATS):
            outside = ((drawn < low) | (drawn > high)).any(axis=1)
            if not outside.any():
                break
            drawn[outside] = values + rng.standard_normal((int(outside.sum()), len(values))) @ root.T
        return np.asarray(np.clip(drawn, low, high))

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {"places": [vars(place) for place in self.places], "covariance": self.covariance.tolist()}


NONE = Uncertainty((), np.zeros((0, 0)))


def uncertainty_from(content: Mapping[str, Any]) -> Uncertainty:
    """The :meth:`Uncertainty.plain` of a stored plant."""
    places = tuple(PlantNumber(**place) for place in content["places"])
    return Uncertainty(places, np.array(content["covariance"], dtype=np.float64).reshape(len(places), len(places)))
