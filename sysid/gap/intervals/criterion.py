"""Cost of a parameter vector in nats: the sum of softly winsorised squares of standardised residuals.

Where errors may be a drift, residuals are the prediction errors of the fit's drift model; the model is always applied, since it
also accounts for the noise of the sample from which a run starts. Elsewhere they are the residuals themselves, as in the fit,
and their drift widens the intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Unknown
from sysid.gap.data import Data
from sysid.gap.drift import DriftStrength, robust_scale, to_bins, whiten_lanes
from sysid.gap.fit import outlier_scale, place

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Criterion:
    """The cost around one fit.

    Args:
        theta: vector of the plant under test.
        drifts: of every signal, where errors may be a drift.
        scales: standard deviation of every signal's residuals in units of noise (d,).
        outlier: number of standard deviations beyond which a residual is an outlier.
    """

    data: Data
    theta: Array
    unknowns: tuple[Unknown, ...]
    drifts: tuple[DriftStrength, ...]
    scales: Array
    outlier: float

    @property
    def low(self) -> Array:
        return np.array([u.bounds[0] for u in self.unknowns])

    @property
    def high(self) -> Array:
        return np.array([u.bounds[1] for u in self.unknowns])

    def errors(self, lanes: Array) -> Array:
        """Standardised residuals of values (L, k) of the unknowns, (L, n); missing bins are zero."""
        data = self.data
        return self.joined(data.bins(place(self.theta, self.unknowns, lanes)), data.activities)

    def joined(self, bins: Sequence[Array], activities: Sequence[Array]) -> Array:
        """Binned residuals in units of noise, one (L, m, d) a recording → standardised ones, (L, n)."""
        lanes = []
        for part, activity in zip(bins, activities, strict=True):
            for k, (drift, scale) in enumerate(zip(self.drifts, self.scales, strict=True)):
                series = part[:, :, k]
                lanes.append((whiten_lanes(series, activity, drift) if self.data.models_drift else series) / scale)
        joined: Array = np.nan_to_num(np.concatenate(lanes, axis=1))
        return joined

    def predicted(self, values: Array, recordings: Sequence[Recording]) -> list[Array]:
        """Outputs (1, n, d) of each recording at ``values`` (k,)."""
        thetas = place(self.theta, self.unknowns, values[None])
        return [self.data.problem.predict(thetas, recording) for recording in recordings]

    def between(self, made: Sequence[Array], predicted: Sequence[Array]) -> Array:
        """Standardised residuals (n,) of outputs ``made`` without noise, where the outputs are measured."""
        data, bins = self.data, []
        for recording, one, other in zip(data.recordings, made, predicted, strict=True):
            missing = np.isnan(data.problem.measured(recording))
            residual = np.where(missing, np.nan, (one - other) / data.sigma)
            bins.append(to_bins(residual, data.problem.rate(recording)))
        joined: Array = self.joined(bins, data.activities)[0]
        return joined

    def weights(self, errors: Array) -> Array:
        """Below one for outliers."""
        return np.asarray(1.0 / np.sqrt(1.0 + (errors / self.outlier) ** 2))

    def costs(self, errors: Array) -> Array:
        """(…, n) → (…), half the squares where there are no outliers."""
        squared = self.outlier**2
        return np.asarray(squared * (np.sqrt(1.0 + errors**2 / squared) - 1.0).sum(axis=-1))

    def lengths(self) -> list[int]:
        """Number of residuals of each recording and signal, in order."""
        rows = [len(activity) for activity in self.data.activities]
        return [count for count in rows for _ in self.scales]


def criterion_at(data: Data, theta: Array, unknowns: tuple[Unknown, ...], values: Array) -> Criterion:
    """The cost with noise and drift as estimated at ``values`` (k,)."""
    at = place(theta, unknowns, values[None])
    if data.models_drift:
        drifts, _ = data.drifts(at[0])
        scales = np.array([drift.noise for drift in drifts])
    else:
        drifts = (DriftStrength(),) * len(data.sigma)
        parts = data.bins(at)
        series = [np.concatenate([part[0, :, k] for part in parts]) for k in range(len(data.sigma))]
        scales = np.array([robust_scale(s[~np.isnan(s)]) if not np.isnan(s).all() else 1.0 for s in series])
    rough = Criterion(data, theta, unknowns, drifts, np.maximum(scales, 1e-9), np.inf)
    return Criterion(data, theta, unknowns, drifts, rough.scales, outlier_scale(rough.errors(values[None])[0]))
