"""Policies 1 and 2 of the paper: training, and the helix in simulation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from paper.rows import NUMBER, POLICY_RMSE, SIMULATION_MAX, PaperRow
from sysid.pictures import PictureCurve, svg
from sysid.workspace import Workspace
from sysid_rl.train.observers import JsonLines
from sysid_rl.train.tracking import TrackingResult
from sysid_rl.train.tracking_task import TruncatedObservationPolicy, plan_tracking
from sysid_rl.train.training import train_policy
from sysid_rl.train.versions import load_versions
from trained.runs import Run, runs

Array = npt.NDArray[np.float64]

COLOURS = {"feedback": "#0f766e", "plain": "#c2410c"}
#: Moving average of the reward curves [episodes].
WINDOW = 50


@dataclass(frozen=True)
class TrainedRun:
    """A policy (``name@version``), the returns of its episodes (n,), and its run along the helix in simulation."""

    policy: str
    returns: Array
    helix: TrackingResult


def recipes(share: float, seed: int) -> dict[str, Run]:
    """Arm (``feedback``: policy 1, ``plain``: policy 2) → the paper's recipe, cut as in pipelines/training.py.

    Args:
        share: of its 1500 episodes.
    """
    listed = runs(share, dict.fromkeys(("policies", "whole", "driven", "choices", "candidates"), seed + 1))
    return {run.arm: run for run in listed if run.part == "paper" and run.seed == seed and run.arm in NUMBER}


def train(place: Workspace, plant: str, forward: str, run: Run, folder: Path) -> TrainedRun:
    """Train and evaluate one policy where joints follow at once, as in the paper; it is not trained twice."""
    recipe = replace(run.recipe(), name=f"paper-{run.arm}", plant=plant, forward=forward)
    lines = folder / f"{run.arm}-episodes.jsonl"
    trained = train_policy(place.models, recipe, folder / "training", observers=[JsonLines(lines)])
    helix = track_helix(place, plant, forward, trained.version.reference, run.arm)
    entries = [json.loads(line) for line in lines.read_text("utf-8").splitlines()] if lines.exists() else []
    returns = np.array([entry["return"] for entry in entries if entry["kind"] == "episode"])
    return TrainedRun(trained.version.reference, returns, helix)


def track_helix(place: Workspace, plant: str, forward: str, policy: str, name: str) -> TrackingResult:
    """The run of a policy along the helix where joints follow at once."""
    task = plan_tracking(*load_versions(place.models, plant, forward), "helix")
    return task.run(name, TruncatedObservationPolicy(place.policy(policy)))


def rows(trained: Mapping[str, TrainedRun], episodes: int, seed: int) -> list[PaperRow]:
    """Rewards and errors on the helix in simulation."""
    condition = f"joints follow at once; {episodes} episodes of 40 steps"
    found = []
    last = max(1, round(0.2 * min(len(each.returns) for each in trained.values())))
    means = tuple(float(np.mean(trained[arm].returns[-last:])) for arm in NUMBER)
    what = "mean return of the last fifth of the episodes, policy 1 / policy 2"
    found.append(PaperRow("episode rewards", what, condition, None, means, "1", seed))
    for arm, number in NUMBER.items():
        rmse = tuple(float(1e3 * value) for value in trained[arm].helix.rmse)
        what = f"policy {number} on the helix, RMSE x / y / z"
        found.append(PaperRow("tracking in simulation", what, condition, POLICY_RMSE[arm], rmse, "mm", seed))
    worst = tuple(float(1e3 * value) for value in trained["feedback"].helix.worst)
    what = "policy 1 on the helix, max x / y / z"
    found.append(PaperRow("table of tracking errors, simulation", what, condition, SIMULATION_MAX, worst, "mm", seed))
    return found


def reward_picture(trained: Mapping[str, TrainedRun]) -> str:
    """Moving average of the returns of both policies, SVG."""
    curves = []
    for arm, number in NUMBER.items():
        returns = trained[arm].returns
        width = min(WINDOW, max(1, len(returns) // 4))
        smooth = np.convolve(returns, np.full(width, 1.0 / width), "valid")
        label = f"policy {number} ({arm})"
        curves.append(PictureCurve(label, np.arange(len(smooth)) + width, smooth, COLOURS[arm]))
    return svg("return of an episode, moving average", "episode", "return", curves)
