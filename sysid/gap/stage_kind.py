"""Kinds of stage: what one part of the chain has that others have not, so that the workflow asks no stage what it is.

A speed drive, a servo and a stage of static poses are kinds of their own: they share the name of their stage with others, and
neither candidates nor thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.effects.effect import Stage
from sysid.gap.arm.pose_folds import shown_by_poses
from sysid.gap.candidates import Candidate, without_aliases, without_servo_aliases
from sysid.gap.statement import AGREES
from sysid.gap.thresholds import SHARE, at_floor
from sysid.plant import Model

#: Any share of the gap.
ANY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class StageKind:
    """One kind of stage.

    Args:
        stages: stages of the chain whose effects it shows: its own first, then those between its input and its output.
        distinct: (candidates, model, whether a mass acts on its axis alone, like an armature) → the candidates, those that no
            recording of it distinguishes as one.
        commanded: its input is what was sent, without noise; the input of other kinds is measured.
        integrates: the output is an integral of the input, so that it accumulates every disturbance.
        static: from measured positions to measured positions: without dynamics between two samples, and without a start state.
        is_force: the output is a force: of an axis, or of the links of an arm.
        sags: its actuator may give way to a gravity load.
        whole_arm: its outputs are those of the stages of all axes, compared at once; these are searched with what it finds.
        regression: smooth in all its values: one regression on these compares the sets of effects, and its posterior is exact.
        agrees: whether an error [noise floors] cannot pay the price of an effect, so that nothing is searched.
        least_share: whether formulas are right → least share of the closable gap of a name.
    """

    stages: tuple[Stage, ...]
    distinct: Callable[[Sequence[Candidate], Model, bool], list[Candidate]] = lambda candidates, *_: list(candidates)
    commanded: bool = False
    integrates: bool = False
    static: bool = False
    is_force: bool = False
    sags: bool = False
    whole_arm: bool = False
    regression: bool = False
    agrees: Callable[[float], bool] = lambda left: left <= AGREES
    least_share: Callable[[bool], float] = lambda exact: SHARE


def _any_where_exact(exact: bool) -> float:
    return ANY if exact else SHARE


SPEED = StageKind(("command",), commanded=True, integrates=True)
POSITION = StageKind(("command",), commanded=True, sags=True)
#: A wrong armature moves a servo little beside a wrong damping.
SERVO = StageKind(
    ("command", "force"),
    lambda found, model, spins: without_servo_aliases(found, model.machine, spins),
    commanded=True,
    least_share=_any_where_exact,
)
FORCE = StageKind(("force",), is_force=True)
#: Masses have many rows, and friction, which is left out, is a large part of the forces.
LINKS = StageKind(("links",), is_force=True, whole_arm=True, regression=True, agrees=lambda _: False, least_share=lambda _: ANY)
JOINT = StageKind(("joint",), static=True)
TIP = StageKind(("end_effector",), lambda found, model, _: without_aliases(found, model), static=True)
#: Errors of static poses are independent noise, so that the region of practical equivalence alone decides on the size of an
#: effect: hundreds of poses determine what moves the tip by half a noise floor, beside offsets that move it by a hundred.
POSES = StageKind(
    ("end_effector",),
    lambda found, model, _: without_aliases([c for c in found if shown_by_poses(c)], model),
    static=True,
    regression=True,
    agrees=at_floor,
    least_share=_any_where_exact,
)
TOOL = StageKind(("tool",))
#: Of the driven signal by the actuation of its axis; the force of a force axis is a stage of its own.
DRIVES = {"velocity": SPEED, "position": POSITION, "servo": SERVO}
