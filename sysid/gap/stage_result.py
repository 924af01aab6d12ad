"""Result of one stage: accepted effects, adjusted values, and the models that were compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.fit import Fit
from sysid.gap.problem import Problem
from sysid.gap.reasons import Reason
from sysid.gap.result import ComparedModel, EffectEvidence
from sysid.gap.stage_model import StageFit


@dataclass(frozen=True)
class AcceptedEffect:
    """An effect of the chosen model: the evidence for it, rejected alternatives, and the effects that it ties with."""

    candidate: Candidate
    evidence: EffectEvidence
    rejected: tuple[tuple[Candidate, str], ...] = ()
    ties: tuple[Candidate, ...] = ()


@dataclass(frozen=True)
class StageResult:
    """Result of one stage.

    Args:
        named: effects that the decision names, or that tie with others.
        adjusted: the other effects of the chosen model; the plant gets their values without a name.
        fit: values of the chosen model.
        nominal_rmse, final_rmse: of the fitted recordings, as multiples of the noise floor.
        compared: rows of the evidence table.
        stage_fit: the models that were compared and the decision; None where the nominal model explains the stage.
        names_alone: the result with the named effects alone, used where the adjusted ones fail on held-out recordings.
        limits: 95 % intervals of the unknowns of ``fit``, (k, 2), once computed.
    """

    problem: Problem
    named: tuple[AcceptedEffect, ...]
    adjusted: tuple[Candidate, ...]
    fit: Fit
    nominal_rmse: float
    final_rmse: float
    compared: tuple[ComparedModel, ...] = ()
    stage_fit: StageFit | None = None
    names_alone: StageResult | None = None
    limits: npt.NDArray[np.float64] | None = None

    @property
    def accumulates(self) -> bool:
        """Whether the formulas of the stage are wrong and their errors accumulate."""
        return self.stage_fit is not None and self.stage_fit.decision.accumulates

    def without_names(self, lacks: Mapping[str, Reason]) -> StageResult:
        """The result without some of its names; their values stay in the plant. ``lacks``: label → the failed condition."""
        named = tuple(kept for kept in self.named if kept.candidate.label not in lacks)
        adjusted = (*self.adjusted, *(kept.candidate for kept in self.named if kept.candidate.label in lacks))
        fitted = self.stage_fit
        unsure = replace(fitted, decision=fitted.decision.without_names(lacks)) if fitted is not None else None
        return replace(self, named=named, adjusted=adjusted, stage_fit=unsure)
