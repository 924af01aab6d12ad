"""Comparison of sets of effects in the regression of static poses: additions, drops and exchanges, until none is likelier.

A set costs a small Cholesky factorisation, so that all exchanges of the catalogue are tested instead of a few promising ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.gaussian_regression import GaussianRegression, Posterior

Array = npt.NDArray[np.float64]
Set = frozenset[int]

#: Largest number of effects: as many as the poses determine, at least so many rows for each unknown.
ROWS_PER_UNKNOWN = 3
#: Exchanges, additions and drops at most; each raises the evidence.
MOST_STEPS = 200
#: Least gain in evidence of a step [nats].
GAIN = 1e-6


@dataclass
class SetSearch:
    """Sets of ``candidates`` in a regression; each evaluated once.

    Args:
        places: indices of the unknowns of each candidate among all unknowns.
    """

    regression: GaussianRegression
    candidates: Sequence[Candidate]
    places: Sequence[npt.NDArray[np.intp]]
    known: dict[Set, Posterior] = field(default_factory=dict)

    def unknowns(self, members: Set) -> npt.NDArray[np.intp]:
        """Indices of the unknowns of a set, candidate by candidate in ascending order."""
        return np.concatenate([np.empty(0, dtype=np.intp), *(self.places[k] for k in sorted(members))])

    def posterior(self, members: Set) -> Posterior:
        if members not in self.known:
            self.known[members] = self.regression.posterior(self.unknowns(members))
        return self.known[members]

    def evidence(self, members: Set) -> float:
        """Of a set; minus infinity where a value leaves its bounds, or where it has too many unknowns for the rows."""
        if ROWS_PER_UNKNOWN * len(self.unknowns(members)) > self.regression.rows:
            return -np.inf
        found = self.posterior(members)
        return found.evidence if found.inside else -np.inf

    def likeliest(self, start: Set) -> Set:
        """The set from which no addition, drop or exchange raises the evidence."""
        best = start if np.isfinite(self.evidence(start)) else frozenset()
        for _ in range(MOST_STEPS):
            for neighbours in (self.larger, self.smaller, self.exchanged):
                found = max(neighbours(best), key=self.evidence, default=best)
                if self.evidence(found) > self.evidence(best) + GAIN:
                    best = found
                    break
            else:
                return best
        return best

    def larger(self, members: Set) -> list[Set]:
        return [frozenset(self._joined(members, k)) for k in range(len(self.candidates)) if k not in members]

    def smaller(self, members: Set) -> list[Set]:
        return [members - {k} for k in sorted(members)]

    def exchanged(self, members: Set) -> list[Set]:
        """One effect in place of one or two others."""
        less = [members - {k} for k in sorted(members)]
        return [new for rest in less for new in self.larger(rest) if new != members]

    def _joined(self, members: Set, new: int) -> set[int]:
        """The set with a candidate, without its special cases and other forms of it."""
        one = self.candidates[new]
        rest = {k for k in members if self.candidates[k].key != one.key and not one.contains(self.candidates[k])}
        return {*rest, new}
