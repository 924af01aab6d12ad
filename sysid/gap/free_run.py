"""Sets of effects fitted to the free run of a stage by least squares in noise floors.

A free run accumulates slow errors. The whitened likelihood hardly shows them where fast dynamics are wrong: their remainder
passes for a random disturbance, and slow errors for its drift. Where formulas differ, calibration is by least squares over the
output (Tuo and Wu, Ann. Stat. 43 (2015), 2331–2352).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.comparison import left_where_acting, may_be_smallest, smallest_sets
from sysid.gap.decision import FreeRun
from sysid.gap.likelihood.discrepancy import Discrepancy
from sysid.gap.likelihood.disturbance import Disturbance
from sysid.gap.likelihood.rows import StageRows
from sysid.gap.likelihood.stage import ModelFit, StageLikelihood, Variances
from sysid.gap.proposals import Proposals
from sysid.gap.thresholds import as_little, at_floor

Array = npt.NDArray[np.float64]

#: Largest number of effects of a set; sets of one size whose subsets are fitted again, and from which larger ones grow; sets of
#: one size, and where none of them can be the smallest that explains the output.
MAX_EFFECTS, BEST_SETS, GROWING_SETS, MOST_SETS, FEWER_SETS = 3, 3, 8, 12, 6
#: Number of blocks over which errors of the free run are correlated.
LAGS = 4
#: Remaining errors within this factor are those of one optimum.
SAME = 1.001
#: A fit ends where the expected gain is below this share of the cost.
CONVERGED = 1e-4
#: Amplitude that stands for no disturbance, in noise floors.
NO_DISTURBANCE = 1e-9


@dataclass(frozen=True)
class LeastSquares(FreeRun):
    """Fits of one stage by least squares over its free run."""

    proposals: Proposals

    def nearest(self, model: ModelFit) -> ModelFit:
        """The set with the values of least error: its own, or those of least squares."""
        return min(model, self.least_squares(model), key=lambda f: f.left)

    def least_squares(self, model: ModelFit) -> ModelFit:
        """The set with values of least squares, fitted again from those of ``model`` where these leave less.

        Alone a set may end at another local optimum: a limit of the flow that no command reaches, for instance.
        """
        found = self.proposals.warm(model.candidates, model)
        return found if found.left <= SAME * model.left else self.proposals.fit(model.candidates, model.values[None])

    def left_where_acting(self, model: ModelFit) -> float:
        rows, fitted = self.proposals.likelihood.rows, self.nearest(model)
        errors = rows.scaled(np.column_stack([rows.nominal, rows.residuals(fitted.theta[None])[0]]))
        before, after, moved = (self._of_recordings(each**2) for each in (*errors.T, errors[:, 1] - errors[:, 0]))
        count = self._of_recordings(rows.present.astype(float))
        return min(fitted.left, left_where_acting(before, after, moved, count, rows.averaged_out))

    def excess(self, model: ModelFit, other: ModelFit) -> float:
        return self.standard_errors(self._squares(model) - self._squares(other))

    def standard_errors(self, blocks: Array) -> float:
        """The sum of differences of blocks (blocks,) in its standard errors.

        Errors of a free run last longer than a block: the covariance of neighbouring blocks counts (Newey and West,
        Econometrica 55 (1987), 703–708).
        """
        recording = self.proposals.likelihood.rows.recording_of_block
        away = blocks - blocks.mean()
        variance = float(away @ away)
        for lag in range(1, LAGS + 1):
            together = recording[lag:] == recording[:-lag]
            variance += 2.0 * (1.0 - lag / (LAGS + 1)) * float((away[lag:] * away[:-lag])[together].sum())
        return float(blocks.sum() / np.sqrt(variance)) if variance > 0.0 else 0.0

    def change(self, model: ModelFit, candidate: Candidate) -> float:
        """Error without one of the effects, the others refitted, less the error with it (in quadrature)."""
        less = self.proposals.without(self.nearest(model), candidate)
        return float(np.sqrt(max(less.left**2 - self.left(model) ** 2, 0.0)))

    def extended(self, model: ModelFit) -> ModelFit | None:
        """The set with the further effect that leaves least, if this is a tenth less."""
        size = len(model.candidates) + 1
        larger = [f for f in self.proposals.fits.values() if len(f.candidates) == size and model.labels < f.labels]
        best = min(larger, key=lambda f: f.left, default=None)
        return best if best is not None and not as_little(model.left, best.left) else None

    def _of_recordings(self, values: Array) -> Array:
        """Sums of values (rows,) over each recording, (recordings,)."""
        rows = self.proposals.likelihood.rows
        recording = rows.recording_of_block[rows.block]
        return np.asarray(np.bincount(recording, values, minlength=len(rows.recordings)), dtype=np.float64)

    def _squares(self, model: ModelFit) -> Array:
        """Sum of the squared errors of each block, in noise floors, (blocks,)."""
        rows = self.proposals.likelihood.rows
        left = rows.scaled(rows.residuals(self.nearest(model).theta[None]).T)[:, 0]
        return np.asarray(np.bincount(rows.block, left**2, minlength=rows.blocks), dtype=np.float64)

    def smallest(self, excited: Collection[str]) -> list[ModelFit]:
        """The smallest sets that explain the output, in ascending order of the remaining error.

        What the recordings do not excite gets no name; it may be the cause all the same, and competes with the effects
        ``excited``.
        """
        every = frozenset(c.label for c in self.proposals.candidates)
        found = {f.labels: f for among in dict.fromkeys((every & set(excited), every)) for f in self.sets(among)}
        return smallest_sets(list(found.values()), self.left_where_acting)

    def sets(self, among: Collection[str]) -> list[ModelFit]:
        """Sets of effects, smallest first, each size in the order of the remaining error."""
        level = [self.proposals.fit(())]
        found = list(level)
        for size in range(1, MAX_EFFECTS + 1):
            wide = may_be_smallest(size, found)
            best = level[0].left
            grown = self.proposals.grown(level[:GROWING_SETS], among, MOST_SETS if wide else FEWER_SETS)
            if not grown:
                break
            level = sorted(grown, key=lambda f: f.left)
            if size > 1 and wide and not at_floor(level[0].left):
                swapped = self.proposals.swapped(level[0], among)
                level = sorted({f.labels: f for f in (*level, *swapped)}.values(), key=lambda f: f.left)
            self._refit_subsets(level)
            found += level
            if at_floor(level[0].left) or as_little(best, level[0].left):
                break
        return [self.proposals.fits[f.labels] for f in found]

    def _refit_subsets(self, level: Sequence[ModelFit]) -> None:
        """Fit each subset of the best sets without one effect from the optimum of the set: alone it may end at another one."""
        for model in level[:BEST_SETS]:
            for candidate in model.candidates:
                rest = [c for c in model.candidates if c.key != candidate.key]
                if rest:
                    self.proposals.fit(rest, np.concatenate([model.values_of(c) for c in rest])[None])


def free_run_of(rows: StageRows, no_discrepancy: Discrepancy, candidates: Sequence[Candidate]) -> LeastSquares:
    """Fits of ``candidates`` to the free run of a stage: the likelihood of independent errors of one noise floor."""
    none = NO_DISTURBANCE
    white = tuple(Disturbance(float(f), none * float(f), none * float(f), 1.0, none * float(f), 1.0) for f in rows.floor)
    variances = Variances(white, np.zeros(0), np.ones(rows.count))
    calm = [np.zeros(len(s.step)) for s in rows.series]
    likelihood = StageLikelihood(rows, no_discrepancy, variances, calm, _clusters(rows), False, CONVERGED)
    return LeastSquares(Proposals(likelihood, candidates))


def _clusters(rows: StageRows) -> npt.NDArray[np.int64]:
    """Cluster of blocks with dependent errors, (blocks,): neighbouring blocks of a recording over the correlation length."""
    first = np.searchsorted(rows.recording_of_block, np.arange(len(rows.recordings)))
    within = np.arange(rows.blocks) - first[rows.recording_of_block]
    return np.asarray(rows.recording_of_block * rows.blocks + within // (LAGS + 1), dtype=np.int64)
