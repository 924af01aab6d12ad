"""Recordings for a fit: residuals of free runs in units of noise, as they are or as means over bins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate
from sysid.gap.drift import bins_of
from sysid.gap.problem import Problem
from sysid.plant import Model

Array = npt.NDArray[np.float64]


@dataclass
class Data:
    """Recordings of a problem, with the standard deviation ``sigma`` (d,) of the noise of each of its signals."""

    problem: Problem
    recordings: Sequence[Recording]
    sigma: Array

    def bins(self, thetas: Array, problem: Problem | None = None) -> list[Array]:
        """Binned residuals in units of noise, one (lanes, m, d) a recording."""
        at = problem or self.problem
        return [bins_of(at.measured(r), at.predict(thetas, r), self.sigma, at.rate(r)) for r in self.recordings]

    def residuals(self, thetas: Array, problem: Problem | None = None) -> list[Array]:
        """(measured − predicted)/σ, one (lanes, n, d) a recording, NaN where either is missing."""
        at = problem or self.problem
        return [(at.measured(r)[None] - at.predict(thetas, r)) / self.sigma for r in self.recordings]

    def errors(self, thetas: Array, problem: Problem | None = None) -> Array:
        """(lanes, all bins of all signals), missing ones as zero, so that the length never changes."""
        return joined(self.levelled(self.bins(thetas, problem)))

    def levelled(self, bins: Sequence[Array]) -> list[Array]:
        """Bins of a stage that integrates less their mean in each recording: a run starts at one sample, with its noise."""
        if not self.problem.kind.integrates:
            return list(bins)
        there = [(~np.isnan(part)).sum(axis=1, keepdims=True) for part in bins]
        return [part - np.nansum(part, axis=1, keepdims=True) / np.maximum(n, 1) for part, n in zip(bins, there, strict=True)]

    def log_likelihood(self, theta: Array) -> float:
        """Of independent errors of the bins, each signal with its standard deviation under ``theta`` (N,) [nats]."""
        bins, total = self.levelled(self.bins(theta[None])), 0.0
        for k in range(len(self.sigma)):
            series = np.concatenate([part[0, :, k] for part in bins])
            there = series[~np.isnan(series)]
            noise = max(float(np.sqrt(np.mean(there**2))), 1e-12) if len(there) else 1.0
            total -= len(there) * (np.log(noise) + 0.5)
        return total


@dataclass(frozen=True)
class SearchInput:
    """What the search of a stage begins with.

    Args:
        seen: its recordings, the held-out ones not among them.
        theta: vector of the plant under test, (N,).
        nameable: labels of candidates that the recordings excite enough; the others are compared, but not named.
        on_fit: called with the labels of each fitted set.
    """

    model: Model
    seen: Data
    theta: Array
    candidates: Sequence[Candidate]
    nameable: Sequence[str]
    on_fit: Callable[[str], None]


def joined(bins: Sequence[Array]) -> Array:
    """Bins of recordings, (lanes, m, d) each, signal after signal in one table (lanes, n); missing ones are zero."""
    table: Array = np.concatenate([part[:, :, k] for part in bins for k in range(part.shape[2])], axis=1)
    return np.nan_to_num(table)
