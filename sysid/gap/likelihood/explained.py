"""Share of the remaining error of a stage that the discrepancy explains beside a model, group by group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.likelihood.discrepancy import Discrepancy
from sysid.gap.likelihood.rows import Series
from sysid.gap.likelihood.stage import ModelFit, StageLikelihood, prior_of, residual_and_slopes, share_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Explained:
    """RMS errors of a stage's output in noise floors, the mean of each run subtracted.

    Args:
        before: beside the effects alone; ``after``: with the discrepancy as well.
        groups: RMS contribution of each group of the discrepancy, the largest first.
    """

    before: float
    after: float
    groups: Mapping[str, float]


def explained(likelihood: StageLikelihood, fit: ModelFit) -> Explained:
    """Posterior mean of the discrepancy beside ``fit``, against the remaining error of the fit."""
    rows, found = likelihood.rows, likelihood.discrepancy
    scale = likelihood.variances.groups[found.group]
    table = residual_and_slopes(rows, fit.unknowns, fit.values, prior_of(fit.candidates).width)
    effects = table[:, 1:]
    scaled = rows.scaled(effects)
    share = share_of(scaled, rows.products_in_floors(scaled, found.columns) * scale)
    count = len(scale) + 1 + effects.shape[1]
    products = np.zeros((count + 1, count + 1))
    for k, s in enumerate(rows.series):  # without a table of all rows
        beside = np.hstack(
            [_beside(found, scale, effects, share, s), found.timing[s.rows, None], effects[s.rows], table[s.rows, :1]]
        )
        whitened = likelihood.whitened_series(k, beside)
        products += whitened.T @ whitened
    weights = np.linalg.solve(products[:-1, :-1] + np.eye(count), products[:-1, -1])[: len(scale)]
    by_group = weights[:, None] * (found.group[:, None] == np.arange(len(found.groups)))
    parts = np.concatenate([_beside(found, scale, effects, share, s) @ by_group for s in rows.series])
    centred = _centred(rows.series, np.column_stack([table[:, 0], table[:, 0] - parts.sum(axis=1), parts]))
    sizes = rows.in_floors(centred)
    groups = dict(sorted(zip(found.groups, map(float, sizes[2:]), strict=True), key=lambda item: -item[1]))
    return Explained(float(sizes[0]), float(sizes[1]), groups)


def _beside(found: Discrepancy, scale: Array, effects: Array, share: Array, s: Series) -> Array:
    """Columns of the discrepancy in the rows of a series, in unit prior, less what the effects explain, (n, m)."""
    return np.asarray(found.columns[s.rows] * scale - effects[s.rows] @ share)


def _centred(series: Sequence[Series], columns: Array) -> Array:
    """Columns without the mean of each series, which depends on the initial state."""
    out = columns.copy()
    for s in series:
        part = out[s.rows]
        if s.present.any():
            part -= part[s.present].mean(axis=0)
    return out
