"""Fits of sets of effects, each made once, and how well each does on what it was fitted to and on what it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.drift import log_density
from sysid.gap.evidence import Comparison, gain_p_value
from sysid.gap.fit import Fit, at_common_thresholds, fit_candidates, jacobian, least_left, spread_of
from sysid.gap.free_curve import free_curve
from sysid.gap.starts import starting_values

Array = npt.NDArray[np.float64]


@dataclass
class Scores:
    """A cache of fits and of their figures.

    Args:
        theta: vector of the questioned plant.
        folds: (fitted, unseen) recordings; more than one where they change places.
        whitened: unseen recordings count as evidence; without it a naive BIC is all there is.
    """

    theta: Array
    folds: tuple[tuple[Data, Data], ...]
    whitened: bool = True
    seed: int = 0
    on_fit: Callable[[str], None] = lambda text: None
    _fits: dict[frozenset[str], tuple[Fit, ...]] = field(default_factory=dict)
    _scores: dict[frozenset[str], tuple[Array, float]] = field(default_factory=dict)
    _fitted: dict[frozenset[str], float] = field(default_factory=dict)
    _least: dict[frozenset[str], tuple[float, float]] = field(default_factory=dict)

    @property
    def fitted(self) -> Data:
        """What the first fold is fitted to."""
        return self.folds[0][0]

    @property
    def short(self) -> bool:
        """Whether fitting and selecting recordings change places, since one half alone says too little."""
        return len(self.folds) > 1

    def fit(self, candidates: tuple[Candidate, ...], parents: tuple[Fit, ...]) -> Fit:
        key = frozenset(c.label for c in candidates)
        if key not in self._fits:
            self.on_fit(", ".join(sorted(key)) or "nominal")
            starts = starting_values(candidates, parents, self.seed)
            fits = [fit_candidates(self.fitted, self.theta, candidates, starts)]
            for data, _ in self.folds[1:]:
                fits.append(fit_candidates(data, self.theta, candidates, [fits[0].values, *starts]))
            self._fits[key] = tuple(fits)
        return self._fits[key][0]

    def without(self, candidate: Candidate, model: Fit) -> Fit:
        """The fit of what is left of ``model``."""
        return self.fit(tuple(c for c in model.candidates if c is not candidate), (model,))

    def _score(self, fit: Fit) -> tuple[Array, float]:
        """(log predictive density of every unseen bin, NaN where there is none, and unseen RMSE in noise floors).

        How much a machine wanders belongs to what it was recorded doing, so every model has the drift there that suits it best:
        with that of the fitted recordings, a model that leaves more of them is forgiven more elsewhere. Nor does it matter
        where in its interval a threshold was fitted.
        """
        key = frozenset(fit.labels)
        if key not in self._scores:
            densities, left = [], []
            for (data, unseen), fitted in zip(self.folds, self._fits_of(fit), strict=True):
                theta = at_common_thresholds(fitted, (data, unseen))[None]
                bins = unseen.bins(theta)
                drifts, _ = unseen.drifts_of(bins)
                for part, activity in zip(bins, unseen.activities, strict=True):
                    densities += [log_density(part[0, :, k], activity, d) for k, d in enumerate(drifts)]
                left += unseen.residuals(theta)
            self._scores[key] = np.concatenate(densities), spread_of(left)
        return self._scores[key]

    def log_densities(self, *fits: Fit) -> Array:
        """Of the unseen bins that all of them predict, (fits, m): a clock that is wrong loses some at the ends."""
        table = np.array([self._score(fit)[0] for fit in fits])
        return np.asarray(table[:, ~np.isnan(table).any(axis=0)])

    def density(self, fit: Fit) -> float:
        return float(np.nansum(self._score(fit)[0]))

    def told(self, fit: Fit) -> Array:
        """Log likelihood of fitted recordings and log predictive density of unseen ones, (2,)."""
        return np.array([fit.log_likelihood, self.density(fit)])

    def merit(self, fit: Fit) -> float:
        """Log evidence from fitted recordings (penalised for parameters) and from unseen ones together."""
        fitted = sum(
            f.log_likelihood - 0.5 * len(f.unknowns) * np.log(max(data.samples, 2))
            for (data, _), f in zip(self.folds, self._fits_of(fit), strict=True)
        )
        return float(fitted) + self.density(fit) if self.whitened else float(fitted)

    def rmse(self, fit: Fit) -> float:
        return self._score(fit)[1]

    def fitted_rmse(self, fit: Fit) -> float:
        """Of the recordings that are fitted, in noise floors."""
        key = frozenset(fit.labels)
        if key not in self._fitted:
            self._fitted[key] = spread_of(self.fitted.residuals(fit.theta[None]))
        return self._fitted[key]

    def left(self, fit: Fit) -> tuple[float, float]:
        """RMSE in noise floors of fitted and of unseen recordings."""
        return self.fitted_rmse(fit), self.rmse(fit)

    def least(self, fit: Fit) -> tuple[float, float]:
        """The same with the values that leave least of the fitted ones."""
        key = frozenset(fit.labels)
        if key not in self._least:
            seen, unseen = list[Array](), list[Array]()
            for (data, other), fitted in zip(self.folds, self._fits_of(fit), strict=True):
                moved = least_left(fitted, data)
                seen += data.residuals(moved.theta[None])
                unseen += other.residuals(at_common_thresholds(moved, (data, other))[None])
            self._least[key] = spread_of(seen), spread_of(unseen)
        return self._least[key]

    def compare(self, smaller: Fit, larger: Fit) -> Comparison:
        gain = -np.diff(self.log_densities(larger, smaller), axis=0)[0]
        p_value = gain_p_value(gain, self.seed)
        ratio = self.rmse(smaller) / max(self.rmse(larger), 1e-12)
        return Comparison(self.delta_bic(smaller, larger), float(gain.sum()), p_value, ratio)

    def delta_bic(self, one: Fit, other: Fit) -> float:
        """BIC(one) − BIC(other) on the fitted recordings: above zero speaks for the other."""
        extra = len(other.unknowns) - len(one.unknowns)
        total = 0.0
        for (data, _), a, b in zip(self.folds, self._fits_of(one), self._fits_of(other), strict=True):
            total += 2.0 * (b.log_likelihood - a.log_likelihood) - extra * np.log(max(data.samples, 2))
        return total

    def beyond(self, fit: Fit) -> tuple[float, float]:
        """Nats that a speed of no known form over the command gains beside ``fit``.

        Of fitted recordings, less what BIC asks for so many numbers, and with the same curve of unseen ones.
        """
        seen = other = 0.0
        for (data, unseen), fitted in zip(self.folds, self._fits_of(fit), strict=True):
            curve = free_curve(data, fitted.theta, fitted.drifts[0])
            values = curve.values()
            seen += curve.gain(values) - 0.5 * len(values) * np.log(max(data.samples, 2))
            theta = at_common_thresholds(fitted, (data, unseen))
            (drift, *_), _ = unseen.drifts(theta)
            other += free_curve(unseen, theta, drift, curve.fastest).gain(values)
        return seen, other

    def curved(self, fit: Fit, smaller: Sequence[Fit]) -> list[float]:
        """Share of what the effects do that ``fit`` has and each of ``smaller`` lacks that is a curve of speed over command."""
        curve = free_curve(self.fitted, fit.theta, fit.drifts[0])
        return [curve.imitates(self.fitted.whitened(without.theta[None], fit.drifts)[0]) for without in smaller]

    def own_shares(self, model: Fit) -> dict[str, float]:
        """For each effect, the smallest share of a parameter's influence that the other parameters cannot imitate.

        Where a parameter that acts in steps changes nothing nearby, its slope says nothing about that: it counts as its own.
        """
        if not model.unknowns:
            return {}
        _, slopes = jacobian(self.fitted, self.theta, model.unknowns, model.values, model.drifts)
        norms = np.linalg.norm(slopes, axis=0)
        shares = []
        for k in range(slopes.shape[1]):
            others = np.delete(slopes, k, axis=1)
            left = slopes[:, k]
            if others.shape[1]:
                weights, *_ = np.linalg.lstsq(others, left, rcond=None)
                left = left - others @ weights
            flat = 1.0 if model.unknowns[k].stepwise else 0.0
            shares.append(float(np.linalg.norm(left) / norms[k]) if norms[k] > 0 else flat)
        result: dict[str, float] = {}
        at = 0
        for candidate in model.candidates:
            width = len(candidate.unknowns)
            result[candidate.label] = min(shares[at : at + width], default=0.0)
            at += width
        return result

    def _fits_of(self, fit: Fit) -> tuple[Fit, ...]:
        """The fits of the same effects on every fold."""
        return self._fits[frozenset(fit.labels)]
