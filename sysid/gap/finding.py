"""What a search leaves: the effects that stay at a stage, why, and every set that was tried."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.gap.candidates import Candidate
from sysid.gap.evidence import Comparison
from sysid.gap.fit import Fit
from sysid.gap.problem import Problem
from sysid.gap.stage_model import StageFit


@dataclass(frozen=True)
class Trial:
    """One fitted set of effects and how it did, for the evidence table."""

    effects: tuple[str, ...]
    parameters: dict[str, float]
    fit_rmse: float
    selection_rmse: float
    delta_bic: float
    verdict: str


@dataclass(frozen=True)
class Kept:
    """An effect that stays: its part of the fit, why it was kept, and the rivals that lost or tied."""

    candidate: Candidate
    comparison: Comparison
    rejected: tuple[tuple[Candidate, str], ...] = ()
    ties: tuple[Candidate, ...] = ()


@dataclass(frozen=True)
class Finding:
    """The outcome at one stage.

    Args:
        named: effects that a name is given to.
        adjusted: what moved in the fit, but too little for a name, or is too poorly shown, or makes up for another's formula.
        fit: the final fit, on all recordings that may be seen.
        nominal_rmse, final_rmse: of unseen recordings, as multiples of the noise floor.
        stage_fit: the models that were compared and the decision; None where the stage was explained before.
    """

    problem: Problem
    named: tuple[Kept, ...]
    adjusted: tuple[Candidate, ...]
    fit: Fit
    nominal_rmse: float
    final_rmse: float
    trials: tuple[Trial, ...] = ()
    stage_fit: StageFit | None = None
