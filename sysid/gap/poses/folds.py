"""Roles of static poses in a dataset without motion: those of the dataset, else short blocks of poses dealt in turn.

Poses are independent measurements, but neighbours may share a drift of the calibration (temperature, a target that slipped). A
test on poses drawn at random would share that drift with the fit; one contiguous block at the end tests a part of the work
space that the fit may not contain, since poses are often recorded along a grid. Short blocks dealt in turn lie all over the
session and the work space, and touch the fit at their edges only (blocked cross-validation: Roberts et al., Ecography 40
(2017), 913–929).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.datasets.recording import Dataset, Recording, Role

#: Roles of consecutive blocks: three fifths for the fit, a fifth each for selection and test.
PATTERN: tuple[Role, ...] = ("fit", "select", "fit", "held_out", "fit")
#: Rounds of the pattern in a set, and least number of poses of a block.
ROUNDS, LEAST = 3, 2


def pose_roles(dataset: Dataset) -> dict[Role, tuple[Recording, ...]]:
    """The poses of each role, in the order of the dataset.

    The dataset's roles count if it has poses to fit and to test; those for selection may be absent, since the search uses them
    like those of the fit.
    """
    roles: tuple[Role, ...] = ("fit", "select", "held_out")
    given = {role: dataset.with_role(role, kind="poses") for role in roles}
    if given["fit"] and given["held_out"]:
        return given
    found: dict[Role, list[Recording]] = {role: [] for role in roles}
    for recording in dataset.of_kind("poses"):
        for role, part in dealt(recording).items():
            found[role].append(part)
    return {role: tuple(parts) for role, parts in found.items()}


def dealt(recording: Recording) -> dict[Role, Recording]:
    """A pose set cut into blocks of consecutive poses, which get the roles of :data:`PATTERN` in turn."""
    count = len(recording)
    blocks = max(1, min(ROUNDS * len(PATTERN), count // LEAST))
    block = np.arange(count) * blocks // max(count, 1)
    found = {}
    for number, role in enumerate(("fit", "select", "held_out"), 1):
        rows = np.array([PATTERN[b % len(PATTERN)] == role for b in block], dtype=bool)
        if rows.any():
            table = recording.table.loc[rows].reset_index(drop=True)
            found[role] = replace(recording, name=f"{recording.name}#{number}", table=table)
    return found  # type: ignore[return-value]
