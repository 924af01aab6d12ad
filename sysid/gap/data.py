"""Recordings as a fit sees them: residuals in units of noise, binned, whitened by the drift of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.drift import BIN, DriftStrength, bins_of, estimate_drift, to_bins, white_noise, whiten_lanes
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: What is left of a wandering 0.1 s later at a stage that does not integrate: it forgets within about a second.
FORGETS = 0.9


@dataclass
class Data:
    """Recordings of a problem with what does not change between fits: noise, activity, how many bins are measured.

    Args:
        wanders: residuals may wander, and what wanders is no evidence. Without it every sample counts as independent, which is
            what a naive BIC does; kept to measure what that would cost.
    """

    problem: Problem
    recordings: Sequence[Recording]
    sigma: Array
    wanders: bool = True
    activities: list[Array] = field(init=False)
    samples: int = field(init=False)

    def __post_init__(self) -> None:
        self.activities = [activity_of(self.problem, r) for r in self.recordings]
        parts = [to_bins(self.problem.measured(r), self.problem.rate(r)) for r in self.recordings]
        self.samples = sum(int((~np.isnan(part)).sum()) for part in parts)

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
        return self.drifts_of(self.bins(theta[None]))

    def drifts_of(self, bins: Sequence[Array]) -> tuple[tuple[DriftStrength, ...], float]:
        """The same, of binned residuals, one (1, m, d) a recording."""
        memory = 1.0 if self.problem.integrates else FORGETS
        found, total = [], 0.0
        for k in range(len(self.sigma)):
            if not self.wanders:
                white, log_likelihood = white_noise([part[0, :, k] for part in bins])
                found.append(white)
                total += log_likelihood * BIN * self.problem.rate(self.recordings[0])
                continue
            drift, log_likelihood = estimate_drift([part[0, :, k] for part in bins], self.activities, memory)
            found.append(drift)
            total += log_likelihood
        return tuple(found), total


def activity_of(problem: Problem, recording: Recording) -> Array:
    """How much the stage moves in each bin, mean 1, (m,); constant where it does not move at all.

    Flow disturbances grow with flow, so a drive drifts while it moves and hardly at rest.
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
