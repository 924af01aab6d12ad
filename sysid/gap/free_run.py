"""Which sets of effects explain the free run of a stage best, by least squares in noise floors.

A free run adds up what acts slowly, which the whitened likelihood of a stage hardly sees where fast dynamics are wrong: what
these leave passes for a random disturbance there, and what acts slowly for its drift. Values of least squares over the output
are also what a calibration is where formulas differ (Tuo and Wu, Ann. Stat. 43 (2015), 2331–2352).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.decision import EXPLAINED, FreeRun
from sysid.gap.likelihood.discrepancy import Discrepancy
from sysid.gap.likelihood.disturbance import Disturbance
from sysid.gap.likelihood.rows import StageRows
from sysid.gap.likelihood.stage import ModelFit, StageLikelihood, Variances
from sysid.gap.proposals import Proposals

Array = npt.NDArray[np.float64]

#: Effects of one set at most; sets of one size that others are added to, and how many of the most promising.
MOST, KEPT, ADDED = 3, 3, 6
#: Blocks over which an error of the free run is taken to last.
LAGS = 4
#: A fit ends where less than this share of what is left is to be gained.
CONVERGED = 1e-4
#: Amplitude of a disturbance that is none, in noise floors.
NONE = 1e-9


@dataclass(frozen=True)
class LeastSquares(FreeRun):
    """Fits of one stage by least squares over its free run."""

    proposals: Proposals

    def nearest(self, model: ModelFit) -> ModelFit:
        """The set of effects with the values that leave least of the output: its own, or those of least squares."""
        return min(model, self.least_squares(model), key=lambda f: f.left)

    def least_squares(self, model: ModelFit) -> ModelFit:
        return self.proposals.warm(model.candidates, model)

    def further(self, model: ModelFit, other: ModelFit) -> float:
        """By how many standard errors a set of effects leaves more of the output than another, block by block."""
        return self.standard_errors(self._squares(model) - self._squares(other))

    def standard_errors(self, blocks: Array) -> float:
        """The sum of differences between blocks (blocks,) in its standard errors.

        What a free run is off by lasts longer than a block, so that the covariance of neighbours counts (Newey and West,
        Econometrica 55 (1987), 703–708).
        """
        recording = self.proposals.likelihood.rows.recording_of_block
        away = blocks - blocks.mean()
        variance = float(away @ away)
        for lag in range(1, LAGS + 1):
            together = recording[lag:] == recording[:-lag]
            variance += 2.0 * (1.0 - lag / (LAGS + 1)) * float((away[lag:] * away[:-lag])[together].sum())
        return float(blocks.sum() / np.sqrt(variance)) if variance > 0.0 else 0.0

    def moved(self, model: ModelFit, candidate: Candidate) -> float:
        """What stays without one of its effects, the others fitted again, beyond what stays with it."""
        less = self.proposals.without(self.nearest(model), candidate)
        return float(np.sqrt(max(less.left**2 - self.left(model) ** 2, 0.0)))

    def _squares(self, model: ModelFit) -> Array:
        """Sum of the squared errors of each block, in noise floors, (blocks,)."""
        rows = self.proposals.likelihood.rows
        left = rows.scaled(rows.residuals(self.nearest(model).theta[None]).T)[:, 0]
        return np.asarray(np.bincount(rows.block, left**2, minlength=rows.blocks), dtype=np.float64)

    def sets(self) -> list[ModelFit]:
        """Sets of effects, smallest first, each size in the order of what they leave."""
        level = [self.proposals.fit(())]
        found = list(level)
        for _ in range(MOST):
            first = not level[0].candidates
            grown = {f.labels: f for model in level[:KEPT] for f in self.proposals.grown(model, None if first else ADDED)}
            best = level[0].left
            level = sorted(grown.values(), key=lambda f: f.left)
            found += level
            for model in level[:KEPT]:
                self._settle(model)
            if not level or level[0].left <= EXPLAINED or level[0].left * EXPLAINED > best:
                break
        return [self.proposals.fits[f.labels] for f in found]

    def _settle(self, model: ModelFit) -> None:
        """Fit what a set has without one of its effects from where the set ended: alone it may be caught elsewhere."""
        for candidate in model.candidates:
            rest = [c for c in model.candidates if c.key != candidate.key]
            if rest:
                self.proposals.fit(rest, np.concatenate([model.values_of(c) for c in rest])[None])


def free_run_of(rows: StageRows, discrepancy: Discrepancy, candidates: Sequence[Candidate]) -> LeastSquares:
    white = tuple(Disturbance(float(f), NONE * float(f), NONE * float(f), 1.0, NONE * float(f), 1.0) for f in rows.floor)
    variances = Variances(white, np.zeros(len(discrepancy.groups)), np.ones(rows.count))
    calm = [np.zeros(len(s.step)) for s in rows.series]
    likelihood = StageLikelihood(rows, discrepancy, variances, calm, _clusters(rows), False, CONVERGED)
    return LeastSquares(Proposals(likelihood, candidates))


def _clusters(rows: StageRows) -> npt.NDArray[np.int64]:
    """Rows whose errors may depend on one another, (rows,): as many neighbouring blocks of a recording as an error lasts."""
    first = np.searchsorted(rows.recording_of_block, np.arange(len(rows.recordings)))  # blocks of a recording are neighbours
    within = np.arange(rows.blocks) - first[rows.recording_of_block]
    return np.asarray(rows.recording_of_block * rows.blocks + within // (LAGS + 1), dtype=np.int64)[rows.block]
