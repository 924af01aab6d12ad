"""RMSE of every stage driven by its measured input, on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.case import Case, Stage
from sysid.gap.floor import problem_floor
from sysid.gap.localise import stage_rmse
from sysid.gap.problem import Problem, speed_problem
from sysid.gap.result import Gap
from sysid.plant import compile_plant

Array = npt.NDArray[np.float64]


def stage_gap(case: Case, stages: Sequence[Stage], repaired: Array) -> Gap:
    """RMSE of every stage driven by its measured input, on held-out recordings; of the speeds of command stages too."""
    before: dict[str, float] = {}
    after: dict[str, float] = {}
    floor: dict[str, float] = {}
    # The forces of the links stage are outputs of the axes' stages too.
    own = ((s.problem, s.split.held_out) for s in stages if s.problem.stage != "links")
    for problem, held_out in (*own, *_speeds(case, stages)):
        for values, scores in (
            (before, stage_rmse(problem, case.theta, held_out)),
            (after, stage_rmse(problem, repaired, held_out)),
            (floor, problem_floor(problem, repaired, held_out, case.noise, case.seed)),
        ):
            values.update(zip(problem.signals, map(float, scores), strict=True))
    return Gap(before, after, floor)


def _speeds(case: Case, stages: Sequence[Stage]) -> list[tuple[Problem, Sequence[Recording]]]:
    """The speed of every command stage of a plant that held-out recordings contain, and these recordings."""
    if case.adapter is not None:
        return []
    model, found = compile_plant(case.plant), list[tuple[Problem, Sequence[Recording]]]()
    for stage in stages:
        if stage.problem.stage == "command":
            problem = speed_problem(model, case.plant.machine.axis(stage.problem.target))
            measured = [r for r in stage.split.held_out if not np.isnan(problem.measured(r)).all()]
            if measured:
                found.append((problem, measured))
    return found
