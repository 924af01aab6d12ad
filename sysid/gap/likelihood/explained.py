"""Share of the remaining error of a stage that the discrepancy explains beside a model, group by group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
    discrepancy = found.columns * scale
    discrepancy = discrepancy - effects @ share_of(rows.scaled(effects), rows.scaled(discrepancy))
    whitened = likelihood.whitened(np.hstack([discrepancy, found.timing[:, None], effects, table[:, :1]]))
    columns, target = whitened[:, :-1], whitened[:, -1]
    weights = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T @ target)[: len(scale)]
    parts = np.column_stack([discrepancy @ (weights * (found.group == g)) for g in range(len(found.groups))])
    centred = _centred(rows.series, np.column_stack([table[:, 0], table[:, 0] - parts.sum(axis=1), parts]))
    sizes = rows.in_floors(centred)
    groups = dict(sorted(zip(found.groups, map(float, sizes[2:]), strict=True), key=lambda item: -item[1]))
    return Explained(float(sizes[0]), float(sizes[1]), groups)


def _centred(series: Sequence[Series], columns: Array) -> Array:
    """Columns without the mean of each series, which depends on the initial state."""
    out = columns.copy()
    for s in series:
        part = out[s.rows]
        if s.present.any():
            part -= part[s.present].mean(axis=0)
    return out
