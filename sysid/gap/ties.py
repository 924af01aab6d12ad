"""Which other effects could stand in the place of one that was found, so that the recordings do not tell the two apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.gap.candidates import Candidate
from sysid.gap.evidence import confidence_set
from sysid.gap.fit import Fit
from sysid.gap.scores import Scores
from sysid.gap.strictness import Strictness
from sysid.gap.worth import Worth

#: A rival beside which an effect tells this share of what it tells without it explains something else.
ELSEWHERE = 0.5


@dataclass(frozen=True)
class Ties:
    """The judgement of rivals at one stage."""

    scores: Scores
    strict: Strictness
    worth: Worth
    seed: int = 0

    def judged(
        self, model: Fit, candidate: Candidate, rivals: Sequence[Candidate], fits: Sequence[Fit]
    ) -> tuple[tuple[tuple[Candidate, str], ...], tuple[Candidate, ...]]:
        """(Those that lost and why, those that do as well).

        Args:
            fits: of ``model`` with each of ``rivals`` in the place of ``candidate``.
        """
        # A rival ties only if neither the fitted nor the unseen recordings tell the two apart.
        near = [
            k
            for k, fit in enumerate(fits)
            if self.scores.delta_bic(fit, model) < self.strict.delta_bic
            and not self._needlessly_rich(fit, model)
            and not self._hardly_better(rivals[k], fit, candidate, model)
            and not self._falls_short(fit, model)
        ]
        surviving = confidence_set(
            [-series for series in self.scores.log_densities(model, *(fits[k] for k in near))], self.seed
        )
        tied = {near[k - 1] for k in surviving if k > 0}
        if self.worth.strange(model):
            # What is left is no noise. Where it speaks for one name here and for another there, it is neither.
            tied |= {k for k in near if self._contradicts(fits[k], model)}
        # What contains the effect as a special case leaves as much by itself. What tells less than nothing is none.
        nothing = self.scores.without(candidate, model)
        tied |= {
            k
            for k, fit in enumerate(fits)
            if not rivals[k].contains(candidate) and self._as_far(fit, model) and self.scores.delta_bic(nothing, fit) > 0.0
        }
        ties = tuple(rivals[k] for k in sorted(tied) if not self.explains_else(fits[k], candidate, model))
        rejected = tuple((r, self._why(fit, model)) for r, fit in zip(rivals, fits, strict=True) if r not in ties)
        return rejected, ties

    def explains_else(self, rival: Fit, candidate: Candidate, model: Fit) -> bool:
        """Whether an effect tells beside a rival most of what it tells without it: the rival explains something else.

        Oil that rings after every stop does not make a boom sink at rest, though the one may be as clear as the other.
        """
        if any(candidate.contains(c) or c.contains(candidate) for c in rival.candidates):
            return False
        both = self.scores.fit((*rival.candidates, candidate), (rival, model))
        alone = self.scores.told(model) - self.scores.told(self.scores.without(candidate, model))
        beside = self.scores.told(both) - self.scores.told(rival)
        return bool(np.all(beside > np.maximum(ELSEWHERE * alone, self.strict.delta_bic)))

    def _why(self, rival: Fit, model: Fit) -> str:
        behind = self.scores.density(model) - self.scores.density(rival)
        return (
            f"evidence: ΔBIC {self.scores.delta_bic(rival, model):.0f} on fitted recordings, {behind:.0f} nats on unseen ones"
        )

    def _needlessly_rich(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival needs more numbers than ``model`` and tells no more with them, neither of fitted nor of unseen runs.

        A load and a friction that differs by direction are one thing while a carriage moves: the simpler of two such names.
        """
        if len(rival.unknowns) <= len(model.unknowns):
            return False
        return bool(np.all(self.scores.told(rival) - self.scores.told(model) < self.strict.forward))

    def _hardly_better(self, rival: Candidate, fit: Fit, candidate: Candidate, model: Fit) -> bool:
        """Whether a rival contains the effect as a special case and predicts hardly better: it is what it is there."""
        return rival.contains(candidate) and self.scores.rmse(model) <= self.strict.richer * self.scores.rmse(fit)

    def _falls_short(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival leaves a multiple of what ``model`` leaves, however well it predicts from one moment to the next."""
        pairs = zip(self.scores.least(rival), self.scores.least(model), strict=True)
        return all(left > self.strict.short * best for left, best in pairs)

    def _contradicts(self, rival: Fit, model: Fit) -> bool:
        """Whether fitted recordings prefer a rival clearly, and it leaves hardly more of them."""
        clear = self.scores.delta_bic(rival, model) < -self.strict.delta_bic
        return clear and self.scores.fitted_rmse(rival) < self.strict.clearer * self.scores.fitted_rmse(model)

    def _as_far(self, rival: Fit, model: Fit) -> bool:
        """Whether a rival leaves about as much as ``model`` of a stage that stays far from explained.

        What is left is then much larger than noise and of unknown kind, so that it may decide between the two by chance,
        however clear the evidence looks. Both the likeliest values have to say so and those that leave least: the former are
        off by little that adds up, the latter follow what wanders. Of short logs one of them is enough.
        """
        if not self.worth.strange(model) or any(rival.at_bound(c) for c in rival.candidates):
            return False
        said = (
            all(left < self.strict.clearer * best for left, best in zip(view(rival), view(model), strict=True))
            for view in (self.scores.left, self.scores.least)
        )
        return any(said) if self.scores.short else all(said)
