"""The constants of a calibrated chain whose joints deflect under load, for programs that evaluate it without Python."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ElasticJoint:
    """One moving joint of a chain.

    Args:
        turn, shift: of its origin in the frame that the joint before it moves, (3, 3) and (3,) [m].
        axis: unit vector in the frame of the origin, (3,).
        column: of the joint values that move it; its motion is ``ratio``·((1 + ``scale``)·value − ``compliance``·load) +
            ``offset``.
        master: number of the joint whose load includes its own, or None.
        compliance: of its axis under the load of ``master`` [rad/(N·m) or m/N].
        across: directions of lateral deflection in the frame of the origin, (2, 3); ``lateral`` [rad/(N·m)], (2,).
        mass, centre: of all that it moves and no further joint, in the frame that it moves [kg], (3,) [m].
    """

    turn: Array
    shift: Array
    axis: Array
    prismatic: bool
    column: int
    ratio: float
    scale: float
    offset: float
    master: int | None
    compliance: float
    across: Array
    lateral: Array
    mass: float
    centre: Array


@dataclass(frozen=True)
class ElasticChain:
    """Joints from base to tip.

    Args:
        frame: pose of the base in the frame of the measurement, (4, 4).
        after: number of the joint that moves the tip; ``point``: the tip in the frame that it moves, (3,) [m].
        settling: steps from the unloaded pose to the deflected one.
    """

    joints: tuple[ElasticJoint, ...]
    frame: Array
    after: int
    point: Array
    settling: int
