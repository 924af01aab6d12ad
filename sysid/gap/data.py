"""Recordings for a fit: residuals in units of noise, binned, whitened by the drift of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.drift import DriftStrength, bins_of, estimate_drift, to_bins, whiten_lanes
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Share of the drift that is left after 0.1 s at a stage that does not integrate: its memory is about a second.
MEMORY = 0.9


@dataclass
class Data:
    """Recordings of a problem with what does not change between fits: noise and activity.

    Args:
        drifting: whether errors may be a drift of the machine; else a fit is least squares over the free run.
    """

    problem: Problem
    recordings: Sequence[Recording]
    sigma: Array
    drifting: bool = True
    activities: list[Array] = field(init=False)

    def __post_init__(self) -> None:
        self.activities = [activity_of(self.problem, r) for r in self.recordings]

    @property
    def models_drift(self) -> bool:
        """Whether residuals are prediction errors of a drift model: at a stage that integrates, if errors may be a drift."""
        return self.problem.integrates and self.drifting

    def bins(self, thetas: Array, problem: Problem | None = None) -> list[Array]:
        """Binned residuals in units of noise, one (lanes, m, d) a recording."""
        at = problem or self.problem
        return [bins_of(at.measured(r), at.predict(thetas, r), self.sigma, at.rate(r)) for r in self.recordings]

    def residuals(self, thetas: Array, problem: Problem | None = None) -> list[Array]:
        """(measured − predicted)/σ, one (lanes, n, d) a recording, NaN where either is missing."""
        at = problem or self.problem
        return [(at.measured(r)[None] - at.predict(thetas, r)) / self.sigma for r in self.recordings]

    def whitened(self, thetas: Array, drifts: Sequence[DriftStrength], problem: Problem | None = None) -> Array:
        """(lanes, all bins of all signals), missing ones as zero, so that the length never changes."""
        lanes = []
        for part, activity in zip(self.bins(thetas, problem), self.activities, strict=True):
            for k, drift in enumerate(drifts):
                series = part[:, :, k]
                if drift.present:
                    series = whiten_lanes(series, activity, drift)
                lanes.append(series / drift.noise)
        return np.nan_to_num(np.concatenate(lanes, axis=1))

    def drifts(self, theta: Array) -> tuple[tuple[DriftStrength, ...], float]:
        """Drift of every signal under one parameter vector, and the log-likelihood."""
        bins = self.bins(theta[None])
        memory = 1.0 if self.problem.integrates else MEMORY
        found, total = [], 0.0
        for k in range(len(self.sigma)):
            if not self.drifting:
                joined = np.concatenate([part[0, :, k] for part in bins])
                there = joined[~np.isnan(joined)]
                noise = max(float(np.sqrt(np.mean(there**2))), 1e-12) if len(there) else 1.0
                found.append(DriftStrength(noise=noise, memory=memory))
                total -= len(there) * (np.log(noise) + 0.5)
                continue
            drift, log_likelihood = estimate_drift([part[0, :, k] for part in bins], self.activities, memory)
            found.append(drift)
            total += log_likelihood
        return tuple(found), total


def activity_of(problem: Problem, recording: Recording) -> Array:
    """Activity of the stage in each bin, mean 1, (m,); constant where it does not move.

    Flow disturbances grow with the flow: a drive drifts in motion and hardly at rest.
    """
    measured = to_bins(problem.measured(recording), problem.rate(recording))
    if not problem.integrates or len(measured) < 3:
        return np.ones(len(measured))
    rows = np.arange(len(measured))
    there = ~np.isnan(measured[:, 0])
    if there.sum() < 3:
        return np.ones(len(measured))
    moved = np.abs(np.gradient(np.interp(rows, rows[there], measured[there, 0])))
    mean = float(moved.mean())
    return moved / mean if mean > 0 else np.ones(len(measured))
