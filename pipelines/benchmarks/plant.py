"""Rows of the plant: an hour in one run, candidates over cores, an environment, and the first use of a process.

Each is measured in a process of its own (:mod:`benchmarks.measure`) that is held on the cores it may use.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.measure import BULLET_PART, BULLET_STEPS, ENVIRONMENTS, HOUR, LANE_SECONDS, LANES, MUJOCO_PART, RATE, STEPS
from benchmarks.rows import against_limit, in_process, row, seconds

MEASURE = Path(__file__).with_name("measure.py")
AXES = 4
REPEATS = 5
#: Goals: time of one step of one axis on one core [ns], environment steps a second, first and later use in a process [s].
AXIS_STEP_LIMIT, ENVIRONMENT_GOAL, FIRST_LIMIT, LATER_LIMIT = 50.0, 1e6, 10.0, 1.0
AXIS_STEP = "ns/axis-step"
ENVIRONMENT_STEPS = "environment-steps/s"


def measured(work: str, cores: int, repeats: int = 1, cache: Path | None = None) -> dict[str, Any]:
    """The result of one measurement on the first ``cores`` cores, with compiled code kept in ``cache`` instead of at home."""
    held = sorted(os.sched_getaffinity(0))[:cores]
    surroundings = dict(os.environ) if cache is None else {**os.environ, "XDG_CACHE_HOME": str(cache)}
    return in_process(MEASURE, work, str(repeats), env=surroundings, preexec_fn=lambda: os.sched_setaffinity(0, held))


def plant_rows() -> list[dict[str, Any]]:
    """Every row of the plant."""
    return [*rollout_rows(), *lane_rows(), *environment_rows(), *cache_rows()]


def rollout_rows() -> list[dict[str, Any]]:
    taken = measured("rollout", 1, REPEATS)
    per_step = 1e9 / (HOUR * RATE * AXES)
    ours, mujoco, bullet = ([per_step * t for t in taken[name]] for name in ("ours", "mujoco", "pybullet"))
    about = (
        f"one hour at {RATE:g} Hz, commands to tool, {taken['effects']} effects at once, free_run on one core, table included; "
        f"at most {taken['resting']:.0%} of the time at an end stop"
    )
    same = "the same URDF, six joints, four of them driven at commanded speeds, one thread"
    part = f"{BULLET_PART:g} s of it, scaled to the hour"
    return [
        row("plant_rollout", "mujoco.rollout", ours, mujoco, AXIS_STEP, f"{about}; MuJoCo: {same}"),
        row("plant_rollout", "pybullet", ours, bullet, AXIS_STEP, f"{about}; PyBullet: {same}, stepped from Python, {part}"),
        against_limit("plant_rollout", ours, AXIS_STEP_LIMIT, AXIS_STEP, about),
    ]


def lane_rows(rounds: int = 3) -> list[dict[str, Any]]:
    """Both numbers of cores in turns, in new processes: a process keeps the threads it began with."""
    counts = tuple(dict.fromkeys((1, min(2, len(os.sched_getaffinity(0))))))
    taken: dict[int, dict[str, list[float]]] = {cores: {"ours": [], "mujoco": []} for cores in counts}
    per_step = 1e9 / (LANES * LANE_SECONDS * RATE * AXES)
    for _ in range(rounds):
        for cores in counts:
            found = measured("lanes", cores)
            for name, times in taken[cores].items():
                times.append(per_step * found[name][0])
    about = (
        f"{LANES} candidates, {LANE_SECONDS:g} s at {RATE:g} Hz each, every stage from its measured input; "
        f"MuJoCo: as many lanes and threads, {MUJOCO_PART:g} s, scaled"
    )
    rows = []
    for cores in counts:
        ours, mujoco = taken[cores]["ours"], taken[cores]["mujoco"]
        rows.append(row("plant_lanes", "mujoco.rollout", ours, mujoco, AXIS_STEP, f"{about}; {cores} thread(s)"))
    if len(counts) == 2:
        one, two = taken[1], taken[2]
        also = row("", "", two["mujoco"], one["mujoco"])["ratio"]["median"]
        note = f"{about}; linear would be 2; MuJoCo gains {also:.2f} from its second thread here"
        rows.append(row("plant_lanes_two_cores", "one core", two["ours"], one["ours"], AXIS_STEP, note))
    return rows


def environment_rows() -> list[dict[str, Any]]:
    cores = len(os.sched_getaffinity(0))
    taken = measured("environment", cores, REPEATS)
    ours, mujoco, bullet = ([ENVIRONMENTS * STEPS / t for t in taken[name]] for name in ("ours", "mujoco", "pybullet"))
    about = (
        f"{ENVIRONMENTS} environments, {STEPS} steps of {1e3 / RATE:g} ms under random commands, every effect, "
        f"swing of the gripper included, {cores} core(s)"
    )
    one = f"one environment for {BULLET_STEPS} steps in one process, counted as if spread without loss over all cores"
    step = "one rollout call a step, a thread a core"
    return [
        row("vector_env", "mujoco.rollout", ours, mujoco, ENVIRONMENT_STEPS, f"{about}; MuJoCo: {step}", more_is_better=True),
        row("vector_env", "pybullet", ours, bullet, ENVIRONMENT_STEPS, f"{about}; PyBullet: {one}", more_is_better=True),
        against_limit("vector_env", ours, ENVIRONMENT_GOAL, ENVIRONMENT_STEPS, about, more_is_better=True),
    ]


def cache_rows(repeats: int = 3) -> list[dict[str, Any]]:
    """A process from its start to its end, with an empty folder for compiled code and then with the one it has filled."""
    empty: list[tuple[float, float]] = []
    filled: list[tuple[float, float]] = []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory(prefix="sysid-bench-") as folder:
            for taken in (empty, filled):
                calls: list[float] = []
                whole = seconds(lambda: calls.append(measured("first_run", 1, cache=Path(folder))["first"]))  # noqa: B023
                taken.append((whole, calls[0]))
    rows = []
    for work, taken, limit in (("compile_cache_first", empty, FIRST_LIMIT), ("compile_cache_later", filled, LATER_LIMIT)):
        call = sorted(inside for _, inside in taken)[len(taken) // 2]
        note = f"a process from start to end on one core: imports, first free run of a minute; that run alone {call:.2f} s"
        rows.append(against_limit(work, [whole for whole, _ in taken], limit, "s", note))
    return rows
