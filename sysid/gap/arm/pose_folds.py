"""Static poses in a dataset without motion: the effects that they show, and their roles.

The roles are those of the dataset, else those of five folds, each predicted by the others.

Poses are independent measurements, but neighbours may share a drift of the calibration (temperature, a target that slipped). A
test on poses drawn at random would share that drift with the fit; one contiguous block at the end tests a part of the work
space that the fit may not contain, since poses are often recorded along a grid. Short blocks dealt to the folds in turn lie all
over the session and the work space, and touch the fit at their edges only (blocked cross-validation: Roberts et al., Ecography
40 (2017), 913–929).

A set of 40 poses is too small to give a fifth of it away. With folds every pose is used in the fit, and every pose is tested:
by a search and a fit that have not seen its fold, so that the choice of effects is tested too (nested cross-validation: Varma
and Simon, BMC Bioinformatics 7 (2006), 91).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.checks.roles import ROLES
from sysid.datasets.recording import Dataset, Recording, Role
from sysid.gap.candidates import Candidate

Array = npt.NDArray[np.float64]

#: Number of folds, blocks of a set in each fold, and least number of poses of a block.
FOLDS, ROUNDS, LEAST = 5, 3, 2
#: Largest relative difference of parameter vectors that are the same.
SAME = 1e-9


def shown_by_poses(candidate: Candidate) -> bool:
    """Whether static poses can show an effect: it has no memory of the motion and is not one of a clock."""
    effect = candidate.effect
    return effect.target != "stream" and not effect.memory(1.0) and effect.stage in ("joint", "end_effector", "sensor")


def pose_roles(dataset: Dataset) -> dict[Role, tuple[Recording, ...]]:
    """The poses of each role: as in the dataset if it has poses to fit and to test, else all folds in both roles."""
    given = {role: dataset.with_role(role, kind="poses") for role in ROLES}
    if given["fit"] and given["held_out"]:
        return given
    folds = tuple(fold for recording in dataset.of_kind("poses") for fold in dealt(recording))
    return {"fit": folds, "select": (), "held_out": folds}


def dealt(recording: Recording) -> list[Recording]:
    """The folds ``name#1`` … ``name#5`` of a pose set: blocks of consecutive poses, dealt in turn."""
    count = len(recording)
    blocks = max(1, min(ROUNDS * FOLDS, count // LEAST))
    fold = np.arange(count) * blocks // max(count, 1) % FOLDS
    parts = (recording.table.loc[fold == k].reset_index(drop=True) for k in range(FOLDS))
    return [replace(recording, name=f"{recording.name}#{k}", table=part) for k, part in enumerate(parts, 1) if len(part)]


def fold_of(recording: Recording) -> str:
    """The number of its fold: folds of one number of several sets are left out together."""
    return recording.name.rpartition("#")[2]


def are_folds(fit: Sequence[Recording], held_out: Sequence[Recording]) -> bool:
    """Whether the poses to fit are those to test."""
    return tuple(r.name for r in fit) == tuple(r.name for r in held_out)


@dataclass(frozen=True)
class FoldValues:
    """Predictions of each fold with the values that were found without it.

    Args:
        known: a parameter vector found on all poses, and by fold the one that stands for it.
        plain: the prediction of the problem.
    """

    known: Sequence[tuple[Array, Mapping[str, Array]]]
    plain: Callable[[Array, Recording], Array]

    def predict(self, thetas: Array, recording: Recording) -> Array:
        """As :attr:`sysid.gap.problem.Problem.predict`; a vector that no fit found (the plant under test) stays."""
        fold = fold_of(recording)
        used = [self._without(theta, fold) for theta in thetas]
        return self.plain(np.array(used), recording)

    def _without(self, theta: Array, fold: str) -> Array:
        for found, by_fold in self.known:
            if fold in by_fold and np.allclose(theta, found, rtol=SAME, atol=1e-12):
                return by_fold[fold]
        return theta
