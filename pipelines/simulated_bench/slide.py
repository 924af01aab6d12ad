"""A slide moved by the force of a position controller, with Stribeck friction, rigid or on elastic bristles.

Source of the procedure: Janot, Gautier, Brunot, Data Set and Reference Models of EMPS (2019).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.excursions import draw_path
from simulated_bench.joint_recipe import STEP, Slide, Take
from simulated_bench.seal import seal_step

Array = npt.NDArray[np.float64]


def run_slide(slide: Slide, take: Take) -> tuple[Array, Array, Array]:
    """Time (n,) [s], force of the controller [N] and position [m] (n,) at the log's rate, without noise."""
    rng = np.random.default_rng([slide.seed, take.seed])
    steps = round(take.seconds / STEP)
    path = slide.stroke * draw_path((-1.0, 1.0), steps, STEP, rng)
    force, position = np.empty(steps), np.empty(steps)
    numbers = (
        slide.mass,
        slide.coulomb,
        max(slide.static, slide.coulomb),
        slide.stribeck,
        slide.viscous,
        slide.offset,
        slide.bristle,
        slide.cogging,
        2.0 * math.pi / slide.pitch,
    )
    _slide(path, numbers, (slide.stiffness, slide.damping, slide.force_limit), force, position)
    every = round(1.0 / (STEP * slide.rate))
    return np.arange(0, steps, every, dtype=np.float64) * STEP, force[::every], position[::every]


@compiled
def _slide(
    path: Array,
    numbers: tuple[float, float, float, float, float, float, float, float, float],
    drive: tuple[float, float, float],
    force: Array,
    position: Array,
) -> None:
    """Closed loop in sub-steps; dry friction is applied as an impulse that may stop the carriage but not reverse it.

    The carriage moves by the mean of the speeds of a sub-step: with the last one it would be half a sub-step early, which looks
    like 0.2 % of viscous friction.
    """
    mass, coulomb, static, stribeck, viscous, constant, bristle, cogging, waves = numbers
    stiffness, damping, most = drive
    x, v, deflection = path[0], 0.0, 0.0
    substeps = 10
    h = STEP / substeps
    for k in range(len(path)):
        speed = (path[min(k + 1, len(path) - 1)] - path[k]) / STEP
        u = min(max(stiffness * (path[k] - x) + damping * (speed - v), -most), most)
        force[k] = u
        position[k] = x
        for _ in range(substeps):
            offset = constant + (cogging * math.sin(waves * x) if cogging != 0.0 else 0.0)
            if bristle > 0.0 and coulomb > 0.0:
                deflection, friction = seal_step(deflection, v, coulomb, static, stribeck, viscous, coulomb / bristle, h)
                after = v + h / mass * (u - offset - friction)
                x += 0.5 * h * (v + after)
                v = after
                continue
            free = v + h / mass * (u - offset - viscous * v)
            grip = h / mass * (coulomb + (static - coulomb) * math.exp(-((v / stribeck) ** 2)))
            after = free - grip if free > grip else free + grip if free < -grip else 0.0
            x += 0.5 * h * (v + after)
            v = after
