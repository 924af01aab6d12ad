"""Shortage of motion in the roles: what fit, selection and test recordings each need of every axis, and how much is missing.

A role needs what the catalogue of effects needs (:class:`sysid.effects.Need`): the fit the whole amount, selection and test
half of it, as they are half as long. Where the recordings contain less, a role needs half of its share of what there is: no
assignment gives more to all roles. A quantity that the recordings hardly contain is not a shortage of a role, but one of the
recordings (``sysid datasets NAME --quality``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Role
from sysid.datasets.roles.motion import FEATURES

Array = npt.NDArray[np.float64]

ROLES: tuple[Role, ...] = ("fit", "select", "held_out")
#: Share of the whole duration for each role.
SHARES: dict[Role, float] = {"fit": 0.5, "select": 0.25, "held_out": 0.25}
#: Amounts of :data:`FEATURES` that the fit needs: 3 s in each direction (unequal speeds), 8 reversals (backlash), 2 s of small
#: commands on each side (dead-band), as in the catalogue of effects; half of its 5 s of motion at large commands on each side.
NEEDED: tuple[float, ...] = (3.0, 3.0, 8.0, 2.0, 2.0, 2.5, 2.5)
#: Weight of a shortage: without motion in a direction no effect is observable; without reversals backlash, hysteresis and
#: friction are not; without small or large commands dead-band or saturation.
WEIGHTS: tuple[float, ...] = (1.0, 1.0, 0.8, 0.7, 0.7, 0.7, 0.7)
#: Share of a role's part of a scarce quantity that is enough.
ENOUGH = 0.5
#: Totals from which a quantity counts: what moves for less is not moved, sizes have to be enough for one role at least.
COUNTS: tuple[float, ...] = (0.5, 0.5, 2.0, 2.0, 2.0, 2.5, 2.5)
#: Steps in which weighted shortages are compared, rounded down. From the second step on a role lacks a quantity: it has less
#: than a third of what it needs of motion in a direction, less than a sixth of the reversals, no small or no large commands.
#: Smaller shortages are no reason to change roles, or to cut recordings.
LEVELS, LACKING = 3, 2


@dataclass(frozen=True)
class RoleNeeds:
    """Needs of some roles.

    Args:
        roles: R roles; ``shares``: of the duration, (R,), sum 1.
        amounts: (R, axes, features), zero where a quantity does not count.
    """

    roles: tuple[Role, ...]
    shares: Array
    amounts: Array

    @classmethod
    def of(cls, roles: Sequence[Role], totals: Array) -> RoleNeeds:
        """Needs of ``roles`` for recordings with these amounts, (axes, features)."""
        shares = np.array([SHARES[role] for role in roles])
        part = shares / shares.sum()
        whole = np.array(NEEDED) * (shares / SHARES["fit"])[:, None, None]
        amounts = np.minimum(whole, ENOUGH * part[:, None, None] * totals)
        return cls(tuple(roles), part, np.where(totals >= np.array(COUNTS), amounts, 0.0))

    def shortages(self, amounts: Array) -> Array:
        """Relative shortage of every quantity, weighted: 0 none to 1 all of it, (…, R, axes, features)."""
        needed = np.where(self.amounts > 0.0, self.amounts, 1.0)
        missing = np.clip(1.0 - amounts / needed, 0.0, 1.0)
        return np.asarray(np.where(self.amounts > 0.0, missing * np.array(WEIGHTS), 0.0))


def levels(shortages: Array) -> npt.NDArray[np.int64]:
    """Shortages in whole steps of :data:`LEVELS`, rounded down."""
    return np.floor(LEVELS * shortages + 1e-9).astype(np.int64)


assert len(NEEDED) == len(WEIGHTS) == len(COUNTS) == len(FEATURES)
