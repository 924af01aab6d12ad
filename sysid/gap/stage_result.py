"""The outcome at one stage: effects that are accepted, values that are adjusted, and the models that were compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.evidence import Comparison
from sysid.gap.fit import Fit
from sysid.gap.problem import Problem
from sysid.gap.stage_model import StageFit


@dataclass(frozen=True)
class TestedModel:
    """One fitted set of effects and how it did, for the evidence table; errors in whitened standard deviations."""

    effects: tuple[str, ...]
    parameters: dict[str, float]
    fit_rmse: float
    selection_rmse: float
    delta_bic: float
    verdict: str


@dataclass(frozen=True)
class AcceptedEffect:
    """An effect of the chosen model: the comparison with the best model without it, rejected alternatives, and ties."""

    candidate: Candidate
    comparison: Comparison
    rejected: tuple[tuple[Candidate, str], ...] = ()
    ties: tuple[Candidate, ...] = ()


@dataclass(frozen=True)
class StageResult:
    """The outcome at one stage.

    Args:
        named: effects that the decision names, or that tie with others.
        adjusted: the other effects of the chosen model: their values go into the plant without a name.
        fit: values of the chosen model.
        nominal_rmse, final_rmse: of the fitted recordings, as multiples of the noise floor.
        stage_fit: the models that were compared and the decision; None where the stage was explained before.
        names_alone: the outcome without what is only adjusted, for where that does not hold on held-out recordings.
        limits: 95 % intervals of the unknowns of ``fit``, (k, 2), once they are known.
    """

    problem: Problem
    named: tuple[AcceptedEffect, ...]
    adjusted: tuple[Candidate, ...]
    fit: Fit
    nominal_rmse: float
    final_rmse: float
    trials: tuple[TestedModel, ...] = ()
    stage_fit: StageFit | None = None
    names_alone: StageResult | None = None
    limits: npt.NDArray[np.float64] | None = None
