"""Recordings with insufficient excitation: the boom alone, slowly to and fro."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from plant_data import _ARM, ROLES, URDF, arm_inputs, measured, slide_inputs

from sysid.datasets.recording import Dataset, Recording
from sysid.gap.data import Data
from sysid.gap.experiment import Experiment, OpenHypothesis, dry_run
from sysid.gap.experiment.open_hypothesis import non_identifiable_set
from sysid.gap.fit import fit_candidates, starting_values
from sysid.gap.prepare.case import Case, Stage, open_case, stage_candidates
from sysid.gap.result import EffectEvidence
from sysid.gap.stage_result import AcceptedEffect, StageResult
from sysid.machine import Machine, machine_from_files
from sysid.plant import Plant


def coarse_arm(noise: float) -> Machine:
    """The arm with a draw wire of this noise [m]."""
    return machine_from_files(
        {"machine.toml": _ARM.replace('cylinder" = 2e-5', f'cylinder" = {noise}'), "arm.urdf": URDF}, "arm"
    )


def slow_inputs(name: str, seconds: float, seed: int) -> Recording:
    """The boom's lever slowly to and fro; nothing else moves."""
    rng = np.random.default_rng(seed)
    made = arm_inputs(name, seconds, seed)
    time = made.values("time")
    wave = np.sin(2 * np.pi * 0.12 * rng.uniform(0.8, 1.2) * time + rng.uniform(0, 6))
    boom = 0.5 * np.clip(time - 0.5, 0.0, 1.0) * wave
    return replace(made, table=made.table.assign(**{"slew.command": 0.0, "boom.command": boom, "wrist.command": 0.0}))


def slow_dataset(truth: Plant, seconds: float) -> Dataset:
    """Two recordings to fit, one to select, one held out; a slide is pushed to and fro, and never creeps."""
    inputs = slide_inputs if truth.machine.name == "slide" else slow_inputs
    recordings = tuple(measured(truth, inputs(f"run-{k + 1}", seconds, k), k) for k in range(len(ROLES)))
    splits = {r.name: role for r, role in zip(recordings, ROLES, strict=True)}
    return Dataset.of(truth.machine, recordings, splits)


def with_experiments(dataset: Dataset, truth: Plant, experiments: Sequence[Experiment]) -> Dataset:
    """The dataset with every experiment made on ``truth``, to fit."""
    made = []
    for k, experiment in enumerate(experiments):
        run = dry_run(truth, experiment)
        rng = np.random.default_rng([9, k])
        noisy = {
            signal: run.values(signal) + rng.normal(0.0, truth.machine.noise.get(signal, 0.0), len(run))
            for signal in run.signals
            if not signal.endswith(".command")
        }
        made.append(replace(run, table=run.table.assign(**noisy)))
    splits = {**dataset.splits, **{r.name: "fit" for r in made}}
    return replace(dataset, recordings=(*dataset.recordings, *made), splits=splits)  # type: ignore[arg-type]


def tie(
    dataset: Dataset, plant: Plant, stage_name: str, target: str, kept: str, alternative: str
) -> tuple[Case, Plant, OpenHypothesis]:
    """The open hypothesis of two effects that are not identifiable, and the plant with the kept one."""
    case, stages = open_case(dataset, plant, 0)
    stage = next(s for s in stages if (s.problem.stage, s.problem.target) == (stage_name, target))
    offered = {c.effect.name: c for c in reversed(stage_candidates(case, stage)) if c.form is c.effect.forms[0]}
    one, other = offered[kept], offered[alternative]
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit = fit_candidates(seen, case.theta, (one,), starting_values((one,), (), 0))
    repaired = plant.with_effect(one.instance(fit.values))
    result = StageResult(
        stage.problem, (AcceptedEffect(one, EffectEvidence(0.0, 0.0, 1.0, 1.0), (), (other,)),), (), fit, 2.0, 1.0
    )
    searched = Stage(stage.problem, stage.split, stage.sigma, stage.theta, result)
    return case, repaired, non_identifiable_set(case, searched, repaired.vector(), one, (other,), seen)
