"""Assignment of recordings to roles by the motion in them, never by what a fit gives.

Each recording is given to one role as a whole, or cut into contiguous blocks. The assignment is the lexicographic minimum of

1. the number of roles without enough recorded time for the gap workflow,
2. the shortages of motion over axes and roles, the worst first (leximin): the number of pairs (axis, role) that lack
   everything, then of those that lack most of it; the duration of a role counts as one (needed is half of its share),
3. the number of recordings that are cut, since whole recordings are more independent than parts of one,
4. the sum of the shortages; those of the fit count three times and those of the selection twice, since an effect that the fit
   recordings do not show is not found, while one that the test recordings do not show is found without a test,
5. the largest deviation of a role from its share of the duration, in steps of 5 %,
6. the number of recordings that change their role.

All assignments are compared where these are at most :data:`EXHAUSTIVE`; otherwise single changes and exchanges of two
recordings are made until none lowers the objective, from the present assignment and from one that spreads the motion. The
result depends on the recordings and their order only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.checks.roles import ENOUGH, LACKING, LEVELS, RoleNeeds, levels
from sysid.datasets.chunked import Array, Mask
from sysid.datasets.recording import Role

Choice = npt.NDArray[np.int64]

#: Largest number of assignments that are all compared.
EXHAUSTIVE = 8_000
#: Largest number of recordings of which pairs are exchanged; with more, single changes are fine enough.
PAIRS = 48
#: Largest number of steps of a local search.
STEPS = 400
#: Weights of the roles in the sum of the shortages.
ORDER: dict[Role, float] = {"fit": 3.0, "select": 2.0, "held_out": 1.0}
#: Step in which deviations from the shares of duration are compared.
DEVIATION = 0.05


@dataclass(frozen=True)
class Assignment:
    """Options of n recordings.

    Args:
        needs: of the R open roles.
        amounts: what a recording gives to each role with each option, (n, options, R, axes, features).
        seconds: the same for its duration, (n, options, R).
        allowed: options of each recording, (n, options).
        cuts: options that cut a recording, (options,).
        least_s: recorded time that a role needs at least.
    """

    needs: RoleNeeds
    amounts: Array
    seconds: Array
    allowed: Mask
    cuts: Mask
    least_s: float

    def keys(self, amounts: Array, seconds: Array, cuts: Choice, changes: Choice) -> Array:
        """The objective of m assignments, (m, 6), to be compared lexicographically.

        Args:
            amounts, seconds: sums over the recordings, (m, R, axes, features) and (m, R).
            cuts, changes: (m,).
        """
        single = self.needs.shortages(amounts).max(axis=-1, initial=0.0).reshape(len(amounts), -1)
        total = seconds.sum(axis=1, keepdims=True)
        shares = np.divide(seconds, total, out=np.zeros_like(seconds), where=total > 0.0)
        short = np.clip(1.0 - shares / (ENOUGH * self.needs.shares), 0.0, 1.0)
        every = np.concatenate([single, short], axis=1)
        steps = levels(every)
        worst = np.zeros(len(amounts))
        for level in range(LEVELS, LACKING - 1, -1):
            worst = worst * (every.shape[1] + 1) + np.sum(steps == level, axis=1)
        away = np.ceil(np.abs(shares - self.needs.shares).max(axis=1) / DEVIATION - 1e-9)
        unusable = np.sum(seconds < self.least_s, axis=1)
        order = np.array([ORDER[role] for role in self.needs.roles])
        weights = np.concatenate([np.repeat(order, self.amounts.shape[3]), order])
        return np.stack([unusable, worst, cuts, np.round(every @ weights, 6), away, changes], axis=1)

    def key(self, choice: Choice, present: Choice) -> tuple[float, ...]:
        """The objective of one assignment: an option for each recording."""
        rows = np.arange(len(choice))
        amounts, seconds = self.amounts[rows, choice].sum(axis=0), self.seconds[rows, choice].sum(axis=0)
        cuts, changes = np.array([self.cuts[choice].sum()]), np.array([np.sum(choice != present)])
        return tuple(map(float, self.keys(amounts[None], seconds[None], cuts, changes)[0]))

    def lacks(self, choice: Choice) -> bool:
        """Whether some role lacks time or motion that counts."""
        unusable, worst, *_ = self.key(choice, choice)
        return unusable > 0.0 or worst > 0.0

    def best(self, present: Choice) -> Choice:
        """The best assignment; ``present`` where no other has fewer or smaller shortages, by a step at least."""
        if not self.lacks(present):
            return present
        found = self._search(present, self.allowed & ~self.cuts)
        if self.cuts.any() and (found is None or self.lacks(found)):
            found = self._search(present if found is None else found, self.allowed, present)
        if found is None:
            return present
        (*worst, cuts, total), (*before, uncut, sums) = self.key(found, present)[:4], self.key(present, present)[:4]
        return found if worst < before or (worst == before and cuts <= uncut and total < sums - 1.0 / LEVELS) else present

    def _search(self, start: Choice, allowed: Mask, present: Choice | None = None) -> Choice | None:
        """The best assignment with the ``allowed`` options; None where a recording has none."""
        if not allowed.any(axis=1).all():
            return None
        present = start if present is None else present
        if float(np.log(allowed.sum(axis=1)).sum()) <= np.log(EXHAUSTIVE):
            return self._exhaustive(allowed, present)
        begin = np.where(allowed[np.arange(len(start)), start], start, np.argmax(allowed, axis=1))
        found = [self._descent(choice, allowed, present) for choice in (begin, self._spread(allowed))]
        return min(found, key=lambda choice: self.key(choice, present))

    def _exhaustive(self, allowed: Mask, present: Choice) -> Choice:
        choices: Choice = np.zeros((1, 0), dtype=np.int64)
        amounts, seconds = np.zeros((1, *self.amounts.shape[2:])), np.zeros((1, self.seconds.shape[2]))
        for row, options in enumerate(map(np.flatnonzero, allowed)):
            choices = np.concatenate([np.column_stack([choices, np.full(len(choices), option)]) for option in options])
            amounts = np.concatenate([amounts + self.amounts[row, option] for option in options])
            seconds = np.concatenate([seconds + self.seconds[row, option] for option in options])
        keys = self.keys(amounts, seconds, self.cuts[choices].sum(axis=1), np.sum(choices != present, axis=1))
        return np.asarray(choices[_smallest(keys)])

    def _spread(self, allowed: Mask) -> Choice:
        """Recordings one by one, those with most motion first, each where it lowers the objective most."""
        size = self.amounts.max(axis=1).sum(axis=(1, 2, 3))
        choice: Choice = np.argmax(allowed, axis=1)
        amounts, seconds = np.zeros(self.amounts.shape[2:]), np.zeros(self.seconds.shape[2])
        for row in np.lexsort((self.seconds.max(axis=(1, 2)), size))[::-1]:
            options = np.flatnonzero(allowed[row])
            more, longer = amounts + self.amounts[row, options], seconds + self.seconds[row, options]
            keys = self.keys(more, longer, self.cuts[options].astype(np.int64), np.zeros(len(options), dtype=np.int64))
            at = _smallest(keys)
            choice[row], amounts, seconds = options[at], more[at], longer[at]
        return choice

    def _descent(self, choice: Choice, allowed: Mask, present: Choice) -> Choice:
        """Single changes, then exchanges of two recordings, as long as one lowers the objective."""
        key = self.key(choice, present)
        for _ in range(STEPS):
            moves = (self._step(choice, rows, options, present, key) for rows, options in self._moves(choice, allowed))
            better = next((move for move in moves if move is not None), None)
            if better is None:
                break
            choice, key = better
        return choice

    def _moves(self, choice: Choice, allowed: Mask) -> Iterator[tuple[Choice, Choice]]:
        """Recordings that change their options, and these, (m, k) each: single ones, then pairs that exchange theirs."""
        rows, options = np.nonzero(allowed)
        other = options != choice[rows]
        yield rows[other, None], options[other, None]
        if len(choice) <= PAIRS:
            first, second = np.triu_indices(len(choice), 1)
            fine = (choice[first] != choice[second]) & allowed[first, choice[second]] & allowed[second, choice[first]]
            pairs = np.column_stack([first[fine], second[fine]])
            yield pairs, choice[pairs[:, ::-1]]

    def _step(
        self, choice: Choice, rows: Choice, options: Choice, present: Choice, key: tuple[float, ...]
    ) -> tuple[Choice, tuple[float, ...]] | None:
        """The best of m steps that give each of ``rows`` (m, k) the option in ``options``; None where none is better."""
        if not len(rows):
            return None
        every = np.arange(len(choice))
        amounts, seconds = self.amounts[every, choice].sum(axis=0), self.seconds[every, choice].sum(axis=0)
        cuts, changes = int(self.cuts[choice].sum()), int(np.sum(choice != present))
        before = choice[rows]
        keys = self.keys(
            amounts + (self.amounts[rows, options] - self.amounts[rows, before]).sum(axis=1),
            seconds + (self.seconds[rows, options] - self.seconds[rows, before]).sum(axis=1),
            cuts + (self.cuts[options].astype(np.int64) - self.cuts[before]).sum(axis=1),
            changes + np.sum(options != present[rows], axis=1) - np.sum(before != present[rows], axis=1),
        )
        at = _smallest(keys)
        found = tuple(map(float, keys[at]))
        if found >= key:
            return None
        choice = choice.copy()
        choice[rows[at]] = options[at]
        return choice, found


def _smallest(keys: Array) -> int:
    """The first row that is lexicographically smallest."""
    return int(np.lexsort(keys.T[::-1])[0])
