"""Effects that no recording distinguishes: they are tested and reported once, under one name.

Kinematic effects are compared in every pose, effects of a servo by its equation.

A longer stick, a zero offset of the telescope and a bias of its sensor move the end effector in the same way in every pose.
Such aliases are determined from the kinematics, at poses over the whole ranges of the joints; effects that only the recordings
do not distinguish are ambiguous instead. Special cases are determined likewise: a zero offset of the first joint turns
everything behind it, as a misaligned base does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects import (
    armature_error,
    damping_error,
    joint_offset,
    link_length_error,
    link_mass_error,
    sensor_bias,
    viscous_friction,
)
from sysid.gap.candidates import Candidate, Unknown
from sysid.machine import Axis, Machine
from sysid.plant import Model
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Poses at which effects are compared.
POSES = 24
#: Largest sine of the angle between the responses to two aliases, and step of the responses in the negligible change.
MAX_SINE, STEP = 1e-5, 0.01
#: Preferred names, in this order: a length before a telescope is that of the revolute axis that carries it (contract).
ORDER = tuple(each.EFFECT.name for each in (link_length_error, joint_offset, sensor_bias))
#: Range of an axis without limits [rad or m].
UNLIMITED = (-1.0, 1.0)


def without_aliases(candidates: Sequence[Candidate], model: Model) -> list[Candidate]:
    """The candidates of the end-effector stage, with aliases merged into one candidate and special cases noted."""
    single = [c for c in candidates if c.effect.name in ORDER and len(c.unknowns) == 1]
    if len(single) < 2 or not model.posed:
        return list(candidates)
    poses = _poses(model.machine.axes)
    responses = {id(candidate): _response(model, poses, candidate.unknowns[0]) for candidate in single}
    aliases: dict[int, list[tuple[str, str]]] = {}  # of the preferred candidates
    for candidate in sorted(single, key=lambda c: ORDER.index(c.effect.name)):
        response = responses[id(candidate)]
        same = [first for first in aliases if 1.0 - float(response @ responses[first]) ** 2 < MAX_SINE**2]
        if same:
            aliases[same[0]].append((candidate.effect.name, candidate.target))
        else:
            aliases[id(candidate)] = []
    by_place = {(c.effect.name, c.target): responses[id(c)] for c in single}
    found = []
    for candidate in candidates:
        if id(candidate) in responses and id(candidate) not in aliases:
            continue
        own = tuple(aliases.get(id(candidate), ()))
        found.append(_with_special_cases(replace(candidate, aliases=own) if own else candidate, by_place, model, poses))
    return found


def without_servo_aliases(candidates: Sequence[Candidate], machine: Machine, spins: bool) -> list[Candidate]:
    """The candidates of the command stage of a servo axis, where friction and the controller may be the same.

    Viscous friction of one value acts like damping of the controller: only damping counts towards a force limit. Without a
    limit, the two are one candidate, ``damping_error``, which can be less than described as well.

    Args:
        spins: whether the mass of the axis' own link acts like an armature on it, and on no other axis.
    """
    found = []
    dampings = {c.target for c in candidates if c.effect is damping_error.EFFECT}
    unlimited = {axis.name for axis in machine.axes if axis.servo is not None and axis.servo.force_limit is None}
    for candidate in candidates:
        same = candidate.target in dampings & unlimited
        if same and candidate.effect is damping_error.EFFECT:
            found.append(replace(candidate, aliases=((viscous_friction.EFFECT.name, candidate.target),)))
        elif spins and candidate.effect is armature_error.EFFECT:
            found.append(replace(candidate, aliases=((link_mass_error.EFFECT.name, candidate.target),)))
        elif not (same and candidate.effect is viscous_friction.EFFECT and len(candidate.unknowns) == 1):
            found.append(candidate)
    return found


def _with_special_cases(
    candidate: Candidate, responses: Mapping[tuple[str, str], Array], model: Model, poses: Recording
) -> Candidate:
    """The candidate of several parameters with the effects whose responses they span."""
    if len(candidate.unknowns) < 2:
        return candidate
    basis = np.linalg.qr(np.stack([_response(model, poses, unknown) for unknown in candidate.unknowns], axis=1))[0]
    special = tuple(
        key
        for key, response in responses.items()
        if float(response @ response) > 0.0 and float(np.linalg.norm(response - basis @ (basis.T @ response))) < MAX_SINE
    )
    return replace(candidate, special=special) if special else candidate


def _poses(axes: Sequence[Axis]) -> Recording:
    draw = np.random.default_rng(0)
    table = {"time": np.arange(POSES, dtype=np.float64)}
    for axis in axes:
        table[axis_signal(axis.name, "joint")] = draw.uniform(*(axis.limits or UNLIMITED), POSES)
    return Recording("poses", pd.DataFrame(table), 1.0, kind="poses")


def _response(model: Model, poses: Recording, unknown: Unknown) -> Array:
    """Motion of the end effector at all poses with a parameter, as a unit vector; zero where it does not move."""
    thetas = np.repeat(model.theta[None], 2, axis=0)
    thetas[1, list(unknown.places)] += STEP * unknown.negligible
    ends = model.tip(thetas, poses)
    moved: Array = (ends[1] - ends[0]).ravel()
    length = float(np.linalg.norm(moved))
    return moved / length if length > 0.0 else moved
