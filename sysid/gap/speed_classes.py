"""Share of an effect that each class of speed shows: whether it acts on slow motion as on fast motion.

A gain error changes every speed by one ratio. A clutch that slips at high flow changes the fast ones only, and a single ratio
still explains most of its error. The change of the output by the effect is therefore cut into classes of the predicted speed,
and its share in each class is estimated by least squares over the free run: 1 where the effect is as large as estimated, 0
where it is absent. This is a test of the constancy of a parameter over parts of the data (Chow, Econometrica 28 (1960),
591–605), with the covariance of dependent errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from sysid.gap.candidates import Candidate
from sysid.gap.fit import place
from sysid.gap.likelihood.block_products import block_products
from sysid.gap.likelihood.rows import StageRows
from sysid.gap.likelihood.stage import ModelFit, StageLikelihood
from sysid.gap.likelihood.uncertainty import cluster_covariance

Array = npt.NDArray[np.float64]

#: Number of classes; each contains an equal part of the effect.
CLASSES = 8
#: An effect is absent from a class where its share is certainly nearer to 0 than to 1.
NEARER_TO_ABSENT = 0.5
#: Probability that a class of a present effect is taken for one without it, all classes together.
ERROR = 0.05
#: Share of the squares of all classes that keeps the estimate finite where a class moves nothing.
RIDGE = 1e-9


@dataclass(frozen=True)
class SpeedClasses:
    """Shares of an effect by class, slowest first, (CLASSES,), their standard deviations, and the number of clusters."""

    shares: Array
    deviations: Array
    clusters: int

    @property
    def absent(self) -> bool:
        """Whether the effect is certainly absent from a class (Student's t, Bonferroni's bound for all classes)."""
        if self.clusters < 2:
            return False
        quantile = float(student.ppf(1.0 - ERROR / CLASSES, self.clusters - 1))
        return bool((self.shares + quantile * self.deviations < NEARER_TO_ABSENT).any())


def speed_classes(likelihood: StageLikelihood, model: ModelFit, candidate: Candidate) -> SpeedClasses:
    """Shares of one effect of a model of a stage that integrates.

    Args:
        likelihood: of independent errors over the free run, with clusters of dependent rows.
        model: fitted by least squares over the free run.
    """
    rows = likelihood.rows
    nominal = np.array([[u.nominal for u in candidate.unknowns]])
    without = place(model.theta, candidate.unknowns, nominal)
    left, more = rows.residuals(np.vstack([model.theta[None], without]))
    changes, speeds = _increments(rows, more - left, left)
    columns = _accumulated(rows, changes, _classes(changes, speeds))
    X, y = likelihood.whitened(columns), likelihood.whitened(left[:, None])[:, 0]
    squares = X.T @ X
    ridge = RIDGE * max(float(np.trace(squares)), 1e-300) * np.eye(CLASSES)
    inverse = np.asarray(np.linalg.inv(squares + ridge), dtype=np.float64)
    off = inverse @ (X.T @ y)
    products = block_products(X, y, rows.block, rows.blocks).over(likelihood.clusters)
    covariance, clusters = cluster_covariance(products, off, inverse)
    return SpeedClasses(1.0 + off, np.sqrt(np.diag(covariance)), clusters)


def _increments(rows: StageRows, change: Array, left: Array) -> tuple[Array, Array]:
    """From row to row: change of the output by the effect, and predicted speed, (rows,) each; zero without a row before."""
    changes, speeds = np.zeros(rows.count), np.zeros(rows.count)
    for s in rows.series:
        there = np.flatnonzero(s.present)
        here, run = s.rows.start + there, np.cumsum(s.restart)[there]
        follows = np.diff(run) == 0
        predicted = s.measured[there] - left[here]
        changes[here[1:]] = np.where(follows, np.diff(change[here]), 0.0)
        speeds[here[1:]] = np.where(follows, np.abs(np.diff(predicted)) / np.diff(s.time[there]), 0.0)
    return changes, speeds


def _classes(changes: Array, speeds: Array) -> npt.NDArray[np.int64]:
    """Class of each row by its speed, (rows,), so that each contains an equal part of the changes."""
    order = np.argsort(speeds, kind="stable")
    part = np.cumsum(np.abs(changes[order]))
    found = np.zeros(len(speeds), dtype=np.int64)
    found[order] = np.minimum(CLASSES * part / max(float(part[-1]), 1e-300), CLASSES - 1).astype(np.int64)
    return found


def _accumulated(rows: StageRows, changes: Array, classes: npt.NDArray[np.int64]) -> Array:
    """Output changed by each class alone, (rows, CLASSES)."""
    out: Array = changes[:, None] * (classes[:, None] == np.arange(CLASSES))
    for s in rows.series:
        out[s.rows] = np.cumsum(out[s.rows], axis=0)
    return out
