"""Whether the force of an axis depends on the posture of the machine: the weight of links whose masses are not given.

Without masses nothing can be said about gravity but that it is there. The force is fitted by any friction and inertia of the
axis, and by the terms of a serial arm beside them: weight, and coupling with the motion of the other joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.arm.forces import ROWS_PER_COLUMN, fitted, friction_columns
from sysid.gap.problem import Problem
from sysid.gap.thresholds import at_floor
from sysid.machine import Machine
from sysid.plant.force import force_inputs
from sysid.plant.smooth_motion import smooth_motion
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PostureShare:
    """What fits leave of a force, in noise floors: ``friction`` and inertia of the axis alone, and with the ``posture``."""

    friction: float
    posture: float

    @property
    def dominates(self) -> bool:
        """Whether the posture explains more of what friction and inertia leave than anything else can."""
        return not at_floor(self.friction) and 2.0 * self.posture**2 < self.friction**2


def posture_share(
    problem: Problem, machine: Machine, recordings: Sequence[Recording], sigma: float, units: Mapping[str, str]
) -> PostureShare | None:
    """The comparison for a force axis of a machine without masses; None where no joint turns, or rows are too few.

    Args:
        sigma: noise floor of the force; ``units``: signal → SI unit that the logs state.
    """
    axis = machine.axis(problem.target)
    joints = {name: axis_signal(name, "joint") for name in machine.axis_names}
    turning = [
        name
        for name, joint in joints.items()
        if (machine.expected_unit(joint) or units.get(joint)) != "m"  # it is not known to slide
        and all(np.isfinite(recording.values(joint)).sum() > 1 for recording in recordings)
    ]
    if not turning:
        return None
    friction, posture, force = list[Array](), list[Array](), list[Array]()
    for recording in recordings:
        inputs = force_inputs(recording, axis, problem.force_filter, problem.rows(recording))
        of_motion = friction_columns(inputs.speed, inputs.acceleration, np.zeros_like(inputs.speed))
        table = inputs.compared(np.column_stack([inputs.raw, of_motion, _posture_columns(recording, axis.name, turning)]))
        split = 1 + of_motion.shape[1]
        force.append(table[:, 0])
        friction.append(table[:, 1:split])
        posture.append(table[:, split:])
    f, p, y = np.concatenate(friction), np.concatenate(posture), np.concatenate(force)
    if len(y) < ROWS_PER_COLUMN * (f.shape[1] + p.shape[1]):
        return None
    return PostureShare(fitted(f, y)[1] / sigma, fitted(np.hstack([f, p]), y)[1] / sigma)


def _posture_columns(recording: Recording, axis: str, turning: Sequence[str]) -> Array:
    """Terms of a serial arm beside inertia and friction of the axis, (n, k).

    Sine and cosine of the axis' angle and of its sum and difference with every other one (weight); accelerations of the others,
    also times the cosine of their angle or of the axis', and their squared speeds times its sine (coupling).
    """
    motion = {name: smooth_motion(recording.values(axis_signal(name, "joint")), recording.rate_hz) for name in turning}
    own = motion[axis][0] if axis in turning else None
    angles = [own] if own is not None else []
    parts = list[Array]()
    for name, (q, v, a) in motion.items():
        if name == axis:
            continue
        angles += [own + q, own - q] if own is not None else [q]
        lever = q if own is None else own
        parts += [a, a * np.cos(lever), a * np.cos(q), v**2 * np.sin(lever), v**2 * np.sin(q)]
    parts += [part for angle in angles for part in (np.sin(angle), np.cos(angle))]
    return np.column_stack(parts)
