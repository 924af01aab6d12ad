"""The slew of the small arm alone, its speed any function of its command, and the search at its command stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from plant_data import ROLES, arm, arm_inputs, measured

from sysid.datasets.recording import Dataset, Recording
from sysid.gap.case import open_case, stage_candidates
from sysid.gap.search import Search
from sysid.gap.stage_search import search_stages
from sysid.gap.strictness import Strictness
from sysid.machine import Machine, machine_from_files
from sysid.plant import Plant, nominal_plant

Array = npt.NDArray[np.float64]
SLEW = "command stage of slew"
#: Speed at full command [rad/s], and the noise of its sensor [rad].
GAIN, NOISE = 0.436, 2e-4


def slewing(
    shape: Callable[[Array], Array], wander: Sequence[float] = (0.1,) * len(ROLES), part: float = 1.0, noise: float = NOISE
) -> Dataset:
    """A minute of the slew for every role.

    Args:
        shape: command (n,) → share of the full speed (n,).
        wander: of each recording, relative disturbance of the speed from sample to sample.
        part: of the full command that is used.
        noise: of the slew's sensor [rad].
    """
    files = arm().files()
    files["machine.toml"] = files["machine.toml"].replace('"slew.joint" = 2e-4', f'"slew.joint" = {noise}')
    machine = machine_from_files(files, "arm")
    plant, runs = nominal_plant(machine), []
    for k, relative in enumerate(wander):
        made = arm_inputs(f"run-{k + 1}", 60.0, k)
        slew = part * made.table["slew.command"].to_numpy()
        still = made.table.assign(**{"boom.command": 0.0, "wrist.command": 0.0})
        inputs = replace(made, table=still.assign(**{"slew.command": slew}))
        run = measured(plant, inputs, k)
        random = np.random.default_rng([k, 3])
        speed = GAIN * shape(run.values("slew.command")) * (1.0 + random.normal(0.0, relative, len(run)))
        joint = np.concatenate([[0.0], np.cumsum(speed[:-1]) / run.rate_hz])
        said = joint + random.normal(0.0, noise, len(run))
        runs.append(replace(run, table=run.table.assign(**{"slew.joint": said})))
    return gathered(machine, runs)


def gathered(machine: Machine, runs: Sequence[Recording]) -> Dataset:
    """A dataset of recordings, one for every role."""
    splits = dict(zip((r.name for r in runs), ROLES, strict=True))
    return Dataset.of(machine, runs, splits)


def named_at_slew(dataset: Dataset, plant: Plant, strict: Strictness) -> set[str]:
    """Names of the effects that are found between the slew's command and its joint."""
    return named_at(SLEW, dataset, plant, strict)


def named_at(label: str, dataset: Dataset, plant: Plant, strict: Strictness) -> set[str]:
    """Names of the effects that are found at one stage."""
    case, stages = open_case(dataset, plant, 0)
    asked = [stage for stage in stages if stage.label == label]
    (stage,) = search_stages(case, asked, strict, "all", lambda share, text: None)
    return {kept.candidate.effect.name for kept in stage.found.named}


def search_at_slew(dataset: Dataset, plant: Plant) -> Search:
    """The search there, not begun, with every effect among its candidates."""
    case, stages = open_case(dataset, plant, 0)
    stage = next(stage for stage in stages if stage.label == SLEW)
    return Search(stage.problem, stage.theta, stage.split, stage.sigma, stage_candidates(case, stage), ())
