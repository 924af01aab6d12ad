"""Disagreement of a simulation with recordings: errors of stages and free runs, where they arise, and how a repair closes them.

In the PyBullet world, the held-out commands move rigid bodies, before and after the repair. Driven joints follow the compiled
chain; tip and tool come from the bodies, as in training. The gripper is a point mass, as in the equation of ``gripper_sway``
(difference to a rigid one: ``reports/bench_agreement/README.md``), and the ground lies deep, since a compiled plant has none.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.gap.excitation import axis_of, identifiable_targets
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.prepare.noise import problem_floors
from sysid.gap.problem import Problem, speed_problem
from sysid.gap.result import Gap, StageGap, WorldGap
from sysid.gap.statement import Agreement
from sysid.gap.unnamed.periodic import resonance_frequencies
from sysid.plant import Plant, compile_plant, free_run
from sysid.progress import Progress, silent
from sysid.signals import POINTS, split_signal

Array = npt.NDArray[np.float64]
#: By signal.
Errors = Mapping[str, float]

#: Total duration of the recordings that are run [s]; a minute takes one and a half seconds.
MAX_SECONDS = 600.0
#: Height of the ground, out of reach [m].
GROUND = -100.0


# -- errors ---------------------------------------------------------------------------------------------------------------


def stage_rmse(problem: Problem, theta: Array, recordings: Sequence[Recording]) -> Array:
    """RMSE of each output of a stage over some recordings, (d,); NaN where nothing is measured."""
    joined = np.concatenate([problem.residual(theta, r) for r in recordings])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.nansum(joined**2, axis=0) / np.sum(~np.isnan(joined), axis=0)))


def run_rmse(runs: Sequence[tuple[Recording, pd.DataFrame]]) -> dict[str, float]:
    """RMSE by signal, pooled over recordings, of predictions against the measurement."""
    totals: dict[str, float] = {}
    counts: dict[str, int] = {}
    for recording, predicted in runs:
        for signal in predicted.columns:
            if signal == "time":
                continue
            difference = recording.values(str(signal)) - predicted[signal].to_numpy(dtype=np.float64)
            difference = difference[~np.isnan(difference)]
            if len(difference):
                totals[str(signal)] = totals.get(str(signal), 0.0) + float(np.sum(difference**2))
                counts[str(signal)] = counts.get(str(signal), 0) + len(difference)
    return {signal: float(np.sqrt(totals[signal] / counts[signal])) for signal in totals}


def worst_row(simulated: npt.ArrayLike, measured: npt.ArrayLike) -> tuple[int, float] | None:
    """Row and error (simulated − measured) of the largest magnitude; None where no row has both.

    Args:
        simulated, measured: of one signal in the same rows, (n,) [SI]; NaN where it is unknown.
    """
    error = np.asarray(simulated, dtype=np.float64) - np.asarray(measured, dtype=np.float64)
    if not np.isfinite(error).any():
        return None
    row = int(np.nanargmax(np.abs(error)))
    return row, float(error[row])


# -- localisation ---------------------------------------------------------------------------------------------------------


def localise(
    problems: Sequence[Problem],
    theta: Array,
    recordings: Mapping[int, Sequence[Recording]],
    floors: Mapping[int, Array],
    free: Mapping[str, float],
) -> tuple[StageGap, ...]:
    """One row for each output of each stage.

    Args:
        recordings, floors: by the problem's place in ``problems``.
        free: RMSE of the free run by signal.

    ``share`` is the excess of the output's error over its floor, in floors, relative to the sum over all outputs.
    """
    rows = []
    for k, problem in enumerate(problems):
        if problem.kind.whole_arm:  # the same forces are outputs of the axes' own stages
            continue
        scores = stage_rmse(problem, theta, recordings[k])
        frequencies = resonance_frequencies(problem, theta, recordings[k], floors[k])
        outputs = zip(problem.signals, *(map(float, values) for values in (scores, floors[k], frequencies)), strict=True)
        for signal, score, floor, frequency in outputs:
            excess = max(score / floor - 1.0, 0.0) if floor > 0 else 0.0
            run = free.get(signal, float("nan"))
            rows.append(StageGap(problem.stage, problem.target, signal, score, run, floor, excess, frequency))
    total = sum(row.share for row in rows)
    return tuple(replace(row, share=row.share / total if total > 0 else 0.0) for row in rows)


# -- held-out recordings --------------------------------------------------------------------------------------------------


def stage_gap(case: Case, stages: Sequence[Stage], repaired: Array) -> Gap:
    """RMSE of every stage driven by its measured input, on held-out recordings; of the speeds of command stages too."""
    # The forces of the links stage are outputs of the axes' stages too.
    own = [(s.problem, s.split.held_out) for s in stages if not s.problem.kind.whole_arm]
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
        if stage.problem.kind.commanded:
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


# -- PyBullet world -------------------------------------------------------------------------------------------------------


def world_gap(
    before: Plant, after: Plant, recordings: Sequence[Recording], floor: Mapping[str, float], progress: Progress = silent
) -> WorldGap:
    """RMSE of every measured signal in the world and of the compiled plant, on the same rows.

    Recordings that cannot be run are left out; ``skipped`` gives the reason.

    Args:
        recordings: held out; with the measured signals.
        floor: noise floor by signal.
    """
    begin = time.perf_counter()
    chosen, runs, reasons = _within(recordings), list[tuple[Recording, list[pd.DataFrame]]](), list[str]()
    for k, recording in enumerate(chosen):
        progress(k / len(chosen), f"PyBullet world: {recording.name}")
        try:
            there = [_in_world(before, recording)]
            there += there if after is before else [_in_world(after, recording)]
        except SettingsError as error:
            reasons.append(str(error).removeprefix("PyBullet world: "))
            continue
        compiled = [free_run(compile_plant(plant), recording) for plant in (before, after)]
        runs.append((recording, _on_same_rows([*there, *compiled])))
    if len(chosen) < len(recordings):
        reasons.append(f"{len(recordings) - len(chosen)} more recordings than {MAX_SECONDS:.0f} s")
    scores = [run_rmse([(recording, tables[k]) for recording, tables in runs]) for k in range(4)]
    shared = [signal for signal in scores[0] if all(signal in score for score in (*scores, floor))]
    world_before, world_after, plain_before, plain_after = ({s: score[s] for s in shared} for score in scores)
    floors = {s: floor[s] for s in shared}
    return WorldGap(
        Gap(world_before, world_after, floors),
        Gap(plain_before, plain_after, floors),
        tuple(recording.name for recording, _ in runs),
        time.perf_counter() - begin,
        "; ".join(dict.fromkeys(reasons)),
    )


def _within(recordings: Sequence[Recording]) -> list[Recording]:
    """The first recordings up to :data:`MAX_SECONDS`, at least one."""
    seconds = np.cumsum([len(r) / r.rate_hz for r in recordings])
    return [r for k, r in enumerate(recordings) if k == 0 or seconds[k] <= MAX_SECONDS]


def _in_world(plant: Plant, recording: Recording) -> pd.DataFrame:
    from sysid.world import World

    with World(plant, recording.rate_hz, gripper="point", ground=GROUND) as world:
        return world.rollout(recording)


def _on_same_rows(tables: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """The signals that all tables contain, NaN wherever one of them has no value."""
    shared = [name for name in tables[0].columns if all(name in table for table in tables)]
    values = np.array([table[shared].to_numpy(dtype=np.float64) for table in tables])
    there = np.isfinite(values).all(axis=0)
    return [pd.DataFrame(np.where(there, of_table, np.nan), columns=shared) for of_table in values]
