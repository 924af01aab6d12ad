"""Columns of two axes that are exchanged: each axis follows the command of the other and not its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.plausibility.figures import AxisFigures, cost_of
from sysid.datasets.plausibility.finding import Cause, Evidence, Finding
from sysid.datasets.plausibility.response import Motion, changes, correlation, motion_of, strengths
from sysid.datasets.recording import Recording
from sysid.machine import Axis
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
#: Correlation with the own command, at most, and with that of another axis, at least, for an exchange. On honest data the own
#: correlation is 0.8 and more for valves, 0.9 and more for servos.
OWN, OTHER = 0.4, 0.65
#: Difference of the costs of ranges that decides which of commands and measurements are exchanged [nats].
DECIDED = 4.0
#: Axes without a response of their own, up to which each is compared with every other.
MOST = 500


@dataclass(frozen=True)
class Exchange:
    """Axes whose columns are exchanged: axis → the axis whose command it follows; and how many were too many to compare."""

    follows: Mapping[str, str]
    too_many: int = 0


def swap_findings(
    recordings: Sequence[Recording], figures: Mapping[str, AxisFigures], time_scale: float = 1.0
) -> tuple[list[Finding], set[str]]:
    """Findings, and the axes concerned, whose other figures then say nothing."""
    motion = [recording for recording in recordings if recording.kind == "motion"]
    axes_of = [f.axis for f in figures.values()]
    driven = _exchange(motion, axes_of, "driven", time_scale)
    with_joints = [f.axis for f in figures.values() if f.joint is not None or f.axis.drives == "joint"]
    cylinders_too = any(f.joint is not None for f in figures.values())
    joints = _exchange(motion, with_joints, "joint", time_scale) if cylinders_too else Exchange({})
    found: list[Finding] = []
    concerned: set[str] = set()
    if driven.follows:
        axes = tuple(driven.follows)
        concerned |= set(axes)
        with_joint = [axis for axis in axes if figures[axis].joint is not None]
        if with_joint and len(with_joint) == len(axes):
            causes = [
                "command" if all(joints.follows.get(axis) == other for axis, other in driven.follows.items()) else "driven"
            ]
        else:
            causes = _by_ranges(driven, figures)
        found.append(_finding(driven, figures, causes))
    if joints.follows and not concerned & set(joints.follows):
        found.append(_finding(joints, figures, ["joint"], measured="joint"))
        concerned |= set(joints.follows)
    if too_many := max(driven.too_many, joints.too_many):
        evidence = Evidence(
            f"{too_many} axes do not follow their own command", f"at most {MOST} to search for exchanged columns"
        )
        found.append(Finding(("machine:exchanged",), "notice", (evidence,)))
    return found, concerned


def _exchange(recordings: Sequence[Recording], axes: Sequence[Axis], quantity: str, time_scale: float) -> Exchange:
    from scipy.optimize import linear_sum_assignment

    follows: dict[str, str] = {}
    for actuation in ("velocity", "position", "servo"):
        suspects: list[tuple[str, Motion, Array]] = []
        for axis in axes:
            if axis.actuation != actuation:
                continue
            motion = motion_of(
                recordings, axis, axis.driven if quantity == "driven" else axis_signal(axis.name, "joint"), time_scale
            )
            moved = motion.speed if actuation == "velocity" else motion.place
            if changes(motion.command) and changes(moved) and abs(correlation(motion.command, moved, motion.delays)) < OWN:
                suspects.append((axis.name, motion, moved))
        if len(suspects) > MOST:
            return Exchange({}, len(suspects))
        if len(suspects) < 2:
            continue
        strength = strengths(
            np.column_stack([motion.command for _, motion, _ in suspects]),
            np.column_stack([moved for _, _, moved in suspects]),
            suspects[0][1].delays,
        )
        for command, answer in zip(*map(np.ndarray.tolist, linear_sum_assignment(-strength)), strict=True):
            if command != answer and strength[command, answer] > OTHER:
                follows[suspects[answer][0]] = suspects[command][0]
    # An exchange is complete: each column that is missed by one axis is found at another.
    return Exchange(follows if set(follows) == set(follows.values()) else {})


def _by_ranges(exchange: Exchange, figures: Mapping[str, AxisFigures]) -> list[str]:
    """Commands or measurements: with the right one corrected, positions lie within the ends of their axes."""
    as_it_is = sum(cost_of(replace(figures[axis], response=None)) for axis in exchange.follows)
    exchanged = sum(
        cost_of(replace(figures[other], response=None, driven=figures[axis].driven, pairs=None))
        for axis, other in exchange.follows.items()
    )
    if exchanged < as_it_is - DECIDED:
        return ["driven"]
    return ["command"] if as_it_is < exchanged - DECIDED else ["command", "driven"]


def _finding(
    exchange: Exchange, figures: Mapping[str, AxisFigures], causes: Sequence[str], measured: str = "driven"
) -> Finding:
    def signal(axis: str, quantity: str) -> str:
        return figures[axis].axis.driven if quantity == "driven" else axis_signal(axis, quantity)

    axes = list(exchange.follows)
    evidence = tuple(
        Evidence(f"{signal(axis, measured)} follows {other}.command, not {axis}.command", "each axis to follow its own command")
        for axis, other in exchange.follows.items()
    )
    named = tuple(
        Cause("the columns", tuple(signal(axis, cause) for axis in axes), "exchanged", 1.0, "Correct the recipe")
        for cause in causes
    )
    keys = tuple(f"{signal(axis, measured)}:exchanged" for axis in axes)
    return Finding(keys, "severe", evidence, named)
