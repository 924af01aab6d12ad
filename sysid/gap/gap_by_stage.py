"""Errors on held-out recordings: of every stage driven by its measured input, and of every signal where it is the largest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.excitation import axis_of, identifiable_targets
from sysid.gap.localise import stage_rmse
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.prepare.noise import problem_floors
from sysid.gap.problem import Problem, speed_problem
from sysid.gap.result import Gap
from sysid.gap.statement import Agreement
from sysid.plant import compile_plant
from sysid.signals import POINTS, split_signal

Array = npt.NDArray[np.float64]
#: By signal.
Errors = Mapping[str, float]


def stage_gap(case: Case, stages: Sequence[Stage], repaired: Array) -> Gap:
    """RMSE of every stage driven by its measured input, on held-out recordings; of the speeds of command stages too."""
    # The forces of the links stage are outputs of the axes' stages too.
    own = [(s.problem, s.split.held_out) for s in stages if s.problem.stage != "links"]
    parts = [*own, *_speeds(case, stages)]
    floors = problem_floors([(problem, repaired, held_out) for problem, held_out in parts], case.noise, case.seed)
    found: tuple[dict[str, float], dict[str, float], dict[str, float]] = {}, {}, {}
    for (problem, held_out), floor in zip(parts, floors, strict=True):
        scores = stage_rmse(problem, case.theta, held_out), stage_rmse(problem, repaired, held_out), floor
        for values, own_scores in zip(found, scores, strict=True):
            values.update(zip(problem.signals, map(float, own_scores), strict=True))
    return Gap(*found)


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


def agreement(
    case: Case, gap: Gap, held_out: Sequence[Recording], runs: Sequence[tuple[str, Errors, Errors, Errors]]
) -> tuple[Agreement, ...]:
    """How every signal of ``gap`` agrees with the machine, in that held-out recording in which it agrees least.

    Args:
        runs: of each free run its recording, RMSE before and after, and noise floor by signal; none for static poses.
    """
    machine, found = case.plant.machine, []
    moving = identifiable_targets(list(gap.before), case.dataset.recordings, machine)
    for signal in gap.before:
        together = "", gap.before[signal], gap.after[signal], gap.noise_floor[signal]
        own = [
            (recording, before[signal], after[signal], floor[signal])
            for recording, before, after, floor in runs
            if signal in before and signal in after
        ]
        worst = max(own, key=_floors, default=together)
        unit = case.dataset.units.get(signal) or machine.expected_unit(signal) or "1"
        axis = axis_of(signal, machine)
        of_motion = case.sources.get(machine.axis(axis).driven) if axis is not None else None  # a force follows from it
        source = case.sources.get(signal) or of_motion or "unknown"
        found.append(Agreement(signal, *worst, source, _motion(signal, gap, held_out), signal in moving, unit))
    return tuple(found)


def _floors(run: tuple[str, float, float, float]) -> float:
    """The larger error of a run, in noise floors."""
    _, before, after, floor = run
    return max(before, after) / floor if floor > 0.0 else np.inf


def _motion(signal: str, gap: Gap, recordings: Sequence[Recording]) -> float:
    """Standard deviation of a signal over the recordings; of a point, of its coordinates together."""
    owner = split_signal(signal)[0]
    together = [other for other in gap.before if split_signal(other)[0] == owner] if owner in POINTS else [signal]
    total = 0.0
    for each in together:
        values = [r.values(each) for r in recordings if each in r.signals]
        known = np.concatenate([*values, np.empty(0)])
        known = known[np.isfinite(known)]
        total += float(np.var(known)) if len(known) else 0.0
    return float(np.sqrt(total))
