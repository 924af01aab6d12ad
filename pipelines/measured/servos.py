"""Command → motion of measured servos: trained on one-step errors, evaluated by free runs over whole recordings.

With feedback, a network predicts the displacement of the joint in the next 20 ms from the last 0.2 s of commands and 0.1 s of
positions, in a free run from its own positions. From commands alone, it predicts the position from the last second of commands,
for servos that settle sooner. They are compared with linear models of the same inputs (least squares), and with the command
itself as the position, without and with its best delay.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from committed import markdown
from sysid.datasets import Dataset, Recording, ingest
from sysid.networks.estimator import NetworkRegressor, fit_together
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
#: (n, d) histories → (n,) steps.
Step = Callable[[Array], Array]
DATASETS = Path(__file__).resolve().parents[2] / "datasets"
RATE_HZ = 50.0
#: Steps of history: commands, positions.
COMMANDS, POSITIONS = 10, 5
#: Commands as inputs of a map without feedback: their number, and their distance in steps.
WINDOW, APART = 25, 2
#: Measured rows at the start of a free run, which are not evaluated.
START = APART * WINDOW
MOST_ROWS = 6000
SO101 = ("friction_gravity", "multisine", "step_response", "single_joint_elbow")
#: Recordings that are left out in turn.
SO101_HELD = ("multisine", "friction_gravity")
XL330_HELD = ("sin_sin", "up_and_down")
XL330_GAINS = (100, 200, 400, 800)


@dataclass(frozen=True)
class Run:
    """One recording of one joint at 50 Hz: command and position (n,) [rad], and the commands of the other joints (n, m)."""

    name: str
    command: Array
    position: Array
    others: Array


@dataclass(frozen=True)
class Task:
    """A joint with its training and held-out recordings."""

    servo: str
    joint: str
    fit: tuple[Run, ...]
    held: Run


def evaluated(data: Path, quick: bool = False) -> list[dict[str, Any]]:
    """Free-run errors [mrad] of every joint and recording that was left out."""
    with tempfile.TemporaryDirectory() as folder:
        tasks = [*xl330(data / "bam_xl330", Path(folder), quick), *so101(data / "sage_so101", Path(folder), quick)]
    jobs: list[Job] = []
    for task in tasks:
        jobs += [training_job(task, histories), training_job(task, command_features)]
    fit_together([(job.network, job.x, job.y, job.groups) for job in jobs])
    found = []
    for task, fed, alone in zip(tasks, jobs[::2], jobs[1::2], strict=True):
        ends = ends_of(task.fit)
        errors = {}
        for name, steps in (("network", mean_of(fed.network)), ("linear", linear(fed))):
            errors[f"{name}, fed back"] = rmse(free_run(steps, task.held, ends), task.held)
        for name, steps in (("network", mean_of(alone.network)), ("linear", linear(alone))):
            x, _ = command_features(task.held)
            position = np.r_[task.held.position[:START], task.held.command[START:] + steps(x)]
            errors[f"{name}, commands alone"] = rmse(np.clip(position, *ends), task.held)
        errors["as told"] = rmse(task.held.command, task.held)
        errors["as told, late"] = rmse(late(task.held.command, delay_of(task.fit)), task.held)
        moved = 1e3 * float(np.std(task.held.position[START:]))
        found.append({"servo": task.servo, "joint": task.joint, "held": task.held.name, "moves": moved, "rmse": errors})
    return found


def ends_of(runs: Sequence[Run]) -> tuple[float, float]:
    """Limits of free runs: the range of the training positions, extended by half of it at either end."""
    low, high = min(float(run.position.min()) for run in runs), max(float(run.position.max()) for run in runs)
    return low - 0.5 * (high - low), high + 0.5 * (high - low)


@dataclass(frozen=True)
class Job:
    """A network and its training rows."""

    network: NetworkRegressor
    x: Array
    y: Array
    groups: npt.NDArray[np.int64]


def training_job(task: Task, rows_of: Callable[[Run], tuple[Array, Array]]) -> Job:
    rows = [rows_of(run) for run in task.fit]
    x, y = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    groups = np.concatenate([np.full(len(part), number) for number, (_, part) in enumerate(rows)])
    kept = np.linspace(0, len(x) - 1, min(len(x), MOST_ROWS)).round().astype(int)
    network = NetworkRegressor((64, 64), members=3, batch=64, epochs=100, patience=30, validation_fraction=0.15)
    return Job(network, x[kept], y[kept], blocks(groups[kept]))


def linear(job: Job) -> Step:
    """Least squares on the rows of a network."""
    model = make_pipeline(StandardScaler(), LinearRegression()).fit(job.x, job.y)
    return lambda x: np.asarray(model.predict(x))


def xl330(raw: Path, folder: Path, quick: bool) -> list[Task]:
    """The pendulum servo: of every gain one log is left out."""
    dataset = ingest(raw, folder, recipe=DATASETS / "xl330" / "recipe.toml")
    tasks = []
    for gain in XL330_GAINS[: 1 if quick else None]:
        runs = {r.name: run_of(dataset, r, "arm") for r in dataset.recordings if r.name.endswith(f"-{gain}")}
        for trajectory in XL330_HELD[: 1 if quick else None]:
            held = runs[f"{trajectory}-{gain}"]
            tasks.append(Task(f"XL330, gain {gain}", "arm", tuple(run for run in runs.values() if run is not held), held))
    return tasks


def so101(raw: Path, folder: Path, quick: bool) -> list[Task]:
    """Six servos of an arm: whole recordings are left out."""
    datasets = {
        name: ingest(raw / name, folder, recipe=DATASETS / "so101" / "recipe.toml", name=f"so101-{name}")
        for name in (SO101[1:3] if quick else SO101)
    }
    tasks = []
    for axis in next(iter(datasets.values())).machine.axis_names[: 1 if quick else None]:
        runs = {name: run_of(dataset, dataset.recordings[0], axis, name) for name, dataset in datasets.items()}
        for held in SO101_HELD[: 1 if quick else None]:
            fit = tuple(run for name, run in runs.items() if name != held)
            tasks.append(Task("SO-101", axis, fit, runs[held]))
    return tasks


def run_of(dataset: Dataset, recording: Recording, axis: str, name: str = "") -> Run:
    """The longest stretch of a recording without a gap, every 20 ms."""
    axes = [axis, *(other for other in dataset.machine.axis_names if other != axis)]
    columns = np.column_stack(
        [recording.values(axis_signal(axis, "joint")), *(recording.values(axis_signal(a, "command")) for a in axes)]
    )
    known = np.r_[False, np.isfinite(columns).all(axis=1), False]
    edges = np.flatnonzero(np.diff(known.astype(np.int8))).reshape(-1, 2)
    first, last = max(edges.tolist(), key=lambda pair: pair[1] - pair[0])
    times = recording.values("time")[first:last]
    grid = np.arange(times[0], times[-1], 1.0 / RATE_HZ)
    resampled = np.column_stack([np.interp(grid, times, column) for column in columns[first:last].T])
    return Run(name or recording.name, resampled[:, 1], resampled[:, 0], resampled[:, 2:])


def histories(run: Run) -> tuple[Array, Array]:
    """Inputs before each step (n, d), and the displacement of the joint (n,) [rad]."""
    at = np.arange(COMMANDS, len(run.position) - 1)
    x = np.array([history(run, run.position, k) for k in at])
    return x, run.position[at + 1] - run.position[at]


def history(run: Run, position: Array, k: int) -> Array:
    """Commands relative to the position, the last steps of the joint, its position, and the commands of the others, (d,)."""
    now = position[k]
    return np.r_[run.command[k - COMMANDS + 1 : k + 1] - now, np.diff(position[k - POSITIONS : k + 1]), now, run.others[k]]


def command_features(run: Run) -> tuple[Array, Array]:
    """The last second of commands relative to the newest, the newest, and those of the other joints, (n, d); and the position
    relative to the command, (n,) [rad]."""
    at = np.arange(START, len(run.position))
    before = run.command[at[:, None] - APART * np.arange(1, WINDOW)] - run.command[at, None]
    return np.column_stack([before, run.command[at], run.others[at]]), run.position[at] - run.command[at]


def free_run(step: Step, run: Run, ends: tuple[float, float]) -> Array:
    """Positions (n,) of a free run after a measured start of one second, within the limits ``ends``."""
    position = run.position.copy()
    for k in range(START - 1, len(position) - 1):
        moved = float(step(history(run, position, k)[None])[0])
        position[k + 1] = min(max(position[k] + moved, ends[0]), ends[1])
    return position


def mean_of(network: NetworkRegressor) -> Step:
    """The fitted members without the input checks of every call, for one row at a time."""
    return lambda x: np.asarray(np.mean([one.predict(x)[:, 0] for one in network.networks_], axis=0))


def blocks(groups: npt.NDArray[np.int64], count: int = 20) -> npt.NDArray[np.int64]:
    """Blocks of the recordings, so that training and stopping rows are not neighbours."""
    return count * groups + np.arange(len(groups)) * count // len(groups)


def delay_of(runs: Sequence[Run]) -> int:
    """The delay with which the commands fit the positions best [steps]."""
    sizes = [sum(float(np.sum((late(run.command, n) - run.position) ** 2)) for run in runs) for n in range(16)]
    return int(np.argmin(sizes))


def late(command: Array, steps: int) -> Array:
    return np.r_[np.full(steps, command[0]), command[: len(command) - steps]]


def rmse(position: Array, run: Run) -> float:
    """Of a free run [mrad], without its start."""
    return 1e3 * float(np.sqrt(np.mean((position - run.position)[START:] ** 2)))


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """Free-run errors by servo, joint and recording, in Markdown."""
    titles = {"as told": "setpoint", "as told, late": "delayed setpoint"}
    names = [titles.get(name, name.replace("fed back", "autoregressive")) for name in found[0]["rmse"]]
    rows = []
    for item in found:
        best = min(item["rmse"].values())
        cells = (f"**{value:.1f}**" if value == best else f"{value:.1f}" for value in item["rmse"].values())
        rows.append([f"{item['servo']}, {item['joint']}", item["held"], f"{item['moves']:.0f}", *cells])
    return markdown(["free-run RMSE [mrad]", "left-out recording", "SD of the motion", *names], rows)
