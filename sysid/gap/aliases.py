"""Effects of the kinematics that no pose can tell apart: they are tried and reported once, under one name.

A stick that is longer and a telescope whose zero is off move the end effector in the same way in every pose, and so does a
sensor of the telescope that reads too much. Whether two are such aliases is asked of the kinematics themselves, at poses all
over the joints' ranges; that recordings happen not to tell two apart is another matter (a tie). So is whether one is a special
case of another: a first joint whose zero is off turns everything behind it as a base does that stands askew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects import joint_offset, link_length_error, sensor_bias
from sysid.gap.candidates import Candidate, Unknown
from sysid.machine import Axis
from sysid.plant import Model
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Poses at which effects are compared.
POSES = 24
#: Sine of the angle between what two aliases do, at most; they are asked for steps of this share of what is negligible.
SAME, SHORT = 1e-5, 0.01
#: The name that stays: a length before a telescope is that of the revolute axis that carries it (contract).
ORDER = tuple(each.EFFECT.name for each in (link_length_error, joint_offset, sensor_bias))
#: Range of an axis without limits [rad or m].
UNLIMITED = (-1.0, 1.0)


def without_aliases(candidates: Sequence[Candidate], model: Model) -> list[Candidate]:
    """The candidates of the end-effector stage, those that are the same as another in every pose folded into it.

    One of several numbers knows which of them are special cases of it.
    """
    single = [c for c in candidates if c.effect.name in ORDER and len(c.unknowns) == 1]
    if len(single) < 2 or not model.posed:
        return list(candidates)
    poses = _poses(model.machine.axes)
    directions = np.array([_direction(model, poses, candidate) for candidate in single])
    order = sorted(range(len(single)), key=lambda k: (ORDER.index(single[k].effect.name), k))
    folded: dict[int, list[int]] = {}
    for k in order:
        for first in folded:
            cosine = float(directions[k] @ directions[first])
            if 1.0 - cosine**2 < SAME**2:
                folded[first].append(k)
                break
        else:
            folded[k] = []
    found = []
    for candidate in candidates:
        at = next((k for k, c in enumerate(single) if c is candidate), None)
        if at is None:
            found.append(candidate)
        elif at in folded:
            aliases = tuple((single[k].effect.name, single[k].target) for k in folded[at])
            found.append(replace(candidate, aliases=aliases) if aliases else candidate)
    ways = {(c.effect.name, c.target): way for c, way in zip(single, directions, strict=True)}
    return [_with_special(candidate, ways, model, poses) for candidate in found]


def _with_special(candidate: Candidate, ways: Mapping[tuple[str, str], Array], model: Model, poses: Recording) -> Candidate:
    """The candidate with those of one number that its several can do as well."""
    if len(candidate.unknowns) < 2:
        return candidate
    room = np.linalg.qr(np.stack([_way(model, poses, unknown) for unknown in candidate.unknowns], axis=1))[0]
    special = tuple(key for key, way in ways.items() if float(way @ way) > 0.0 and _beside(way, room) < SAME)
    return replace(candidate, special=special) if special else candidate


def _beside(way: Array, room: Array) -> float:
    """Length of what of a unit vector lies outside of a space."""
    return float(np.linalg.norm(way - room @ (room.T @ way)))


def _poses(axes: Sequence[Axis]) -> Recording:
    draw = np.random.default_rng(0)
    table = {"time": np.arange(POSES, dtype=np.float64)}
    for axis in axes:
        table[axis_signal(axis.name, "joint")] = draw.uniform(*(axis.limits or UNLIMITED), POSES)
    return Recording("poses", pd.DataFrame(table), 1.0, kind="poses")


def _direction(model: Model, poses: Recording, candidate: Candidate) -> Array:
    """How the end effector moves with the candidate's parameter, as a unit vector; zero where it does not."""
    (unknown,) = candidate.unknowns
    return _way(model, poses, unknown)


def _way(model: Model, poses: Recording, unknown: Unknown) -> Array:
    thetas = np.repeat(model.theta[None], 2, axis=0)
    thetas[1, list(unknown.places)] += SHORT * unknown.negligible
    ends = model.tip(thetas, poses)
    moved: Array = (ends[1] - ends[0]).ravel()
    length = float(np.linalg.norm(moved))
    return moved / length if length > 0.0 else moved
