"""Models made by hand, as the decision rule compares them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.gap.candidates import Candidate
from sysid.gap.decision import Decision, FreeRun, decide
from sysid.gap.likelihood.stage import ModelFit
from sysid.machine import EffectKey


@dataclass(frozen=True)
class Models:
    """Models with given answers; those without an effect are looked up, and by default formulas are wrong."""

    models: Sequence[ModelFit]
    nameable: Sequence[str]
    own_evidence: Callable[[ModelFit], float] = lambda model: model.evidence
    discrepancy_gain: Callable[[ModelFit], float] = lambda model: np.inf
    integrates: bool = True
    free: FreeRun = field(default_factory=FreeRun)
    smaller: Callable[[ModelFit, Candidate], ModelFit] | None = None
    fewest: Callable[[ModelFit], Sequence[ModelFit] | None] = lambda model: None
    independent: bool = False
    frame: frozenset[str] = frozenset()

    def without(self, model: ModelFit, candidate: Candidate) -> ModelFit:
        if self.smaller is not None:
            return self.smaller(model, candidate)
        return {f.labels: f for f in self.models}[model.labels - {candidate.label}]


def decided(
    models: Sequence[ModelFit],
    nameable: Sequence[str],
    equivalence: Mapping[EffectKey, float] | None = None,
    **answers: object,
) -> Decision:
    """The decision on ``models``; ``answers``: the further fields of :class:`Models`."""
    return decide(Models(models, nameable, **answers), equivalence)  # type: ignore[arg-type]
